"""Faults in the world: of arms, stop circuit, grippers and cloth, and objects before the camera."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from foldcell.cell.simulation.camera.slabs import Slab, hand_over, square_cloth
from foldcell.cell.simulation.faults.board import FaultBoard
from foldcell.cell.simulation.faults.fault import Fault
from foldcell.cell.simulation.faults.kinds import FaultKind
from foldcell.cell.simulation.garment.garment import WorldGarment
from foldcell.cell.simulation.robot.arms import SimulatedRobot
from foldcell.cell.simulation.robot.gripper import SimulatedGripper
from foldcell.robots.ports import Array, Side
from foldcell.skills.vocabulary import Table

K = FaultKind
HANDS = {Side.LEFT: 0, Side.RIGHT: 1}
"""Number of each hand in the cloth."""
DIRECTIONS = 24
"""Number of directions that are tried for a shove, and of places for a second garment."""
SNAG = 5.0
"""Force with which a finger holds cloth that is caught on it [N], as if between two pads."""
CLOTH_HEIGHT = 0.004
"""Height of a second garment on the table [m]."""
SEEN_X, SEEN_Y = (0.30, 0.95), (-0.45, 0.45)
"""Part of the table in which a second garment is put, base frame [m]."""


class WorldFaults:
    """The faults in one world. `before_step` is called before each physics step, `before_frame` before each cloth
    frame; both do nothing while no fault was injected."""

    def __init__(self, board: FaultBoard, robot: SimulatedRobot, garment: WorldGarment) -> None:
        self._board, self._robot, self._garment = board, robot, garment
        self._flapping: tuple[Fault, float] | None = None
        """Fault by which the stop circuit opens and closes, and its start [s]."""
        self._taken: tuple[Fault, float] | None = None
        """Fault that took the garment away, and the time of its return [s]."""
        self._caught: dict[Side, float] = {}
        """Hands on which cloth is caught, and the time at which it comes off [s]."""

    # robot

    def before_step(self, grippers: Mapping[Side, SimulatedGripper]) -> None:
        """Let faults of arms, stop circuit and grippers begin or end."""
        board, robot = self._board, self._robot
        if board.empty:
            return
        for side, gripper in grippers.items():
            gripper.stuck = board.active(K.GRIPPER_STUCK, side) is not None
            weak = board.active(K.GRIPPER_WEAK, side)
            gripper.strength = weak.extent if weak else 1.0
            gripper.broken = board.active(K.GRIPPER_ERROR, side) is not None
            if board.take(K.GRIPPER_UNCALIBRATED, side):
                gripper.lose_calibration()
            robot.hang(side, board.active(K.ARM_HANGS, side) is not None)
            drop = board.take(K.SUDDEN_DROP, side)
            if drop is not None:
                robot.drop(side, drop.extent, drop.lasts)
        both = board.take(K.SUDDEN_DROP_BOTH)
        if both is not None:
            for side in Side:
                robot.drop(side, both.extent, both.lasts)
        self._flap()

    def _flap(self) -> None:
        fault = self._board.take(K.STOP_FLAPPING)
        if fault is not None:
            self._flapping = fault, self._board.now
        if self._flapping is not None:
            (flaps, start), t = self._flapping, self._board.now
            self._robot.open_circuit(t < start + flaps.lasts and int((t - start) / flaps.extent) % 2 == 0)

    # cloth

    def before_frame(self) -> None:
        """Let faults of the cloth begin or end."""
        garment, t = self._garment, self._board.now
        for side, end in list(self._caught.items()):
            if t >= end:
                self.freed(side)
                garment.release(HANDS[side])
        if self._taken is not None and t >= self._taken[1]:
            fault, self._taken = self._taken[0], None
            garment.away = False
            self._shove(fault)
        if not garment.laid or any(garment.holds(hand) for hand in HANDS.values()):
            return
        shoved = self._board.take(K.GARMENT_SHOVED)
        if shoved is not None:
            self._shove(shoved)
        taken = self._board.take(K.GARMENT_TAKEN)
        if taken is not None:
            self._taken, garment.away = (taken, t + taken.lasts), True

    def _shove(self, fault: Fault) -> None:
        """Move and turn the garment in a random direction. A direction in which it stays within its permitted
        poses is preferred, else the direction that leads least far out of them."""
        garment = self._garment
        rng = np.random.default_rng((fault.seed, 1))
        angles = rng.uniform(0.0, 2 * np.pi, DIRECTIONS)
        turns = fault.turn * rng.choice((-1.0, 1.0), DIRECTIONS)
        shifts = fault.extent * np.column_stack((np.cos(angles), np.sin(angles)))
        out = [garment.outside_poses(shift, turn) for shift, turn in zip(shifts, turns, strict=True)]
        best = int(np.argmin(out))
        garment.shove(shifts[best], float(turns[best]))

    def catches(self, side: Side) -> bool:
        """Whether the cloth stays on a finger while the hand opens."""
        fault = self._board.take(K.CAUGHT_ON_FINGER, side)
        if fault is not None:
            self._caught[side] = self._board.now + fault.lasts
        return fault is not None

    def caught(self, side: Side) -> bool:
        """Whether cloth is caught on a finger of this side."""
        return side in self._caught

    def freed(self, side: Side) -> None:
        """The cloth is no longer caught on a finger of this side."""
        self._caught.pop(side, None)

    def grip_force(self, side: Side, force: float) -> float:
        """Return the force that holds the cloth in this hand [N], for pads that press with `force` [N]."""
        if side in self._caught:
            return SNAG
        slip = self._board.active(K.SLIP, side)
        return force * slip.extent if slip else force

    # objects before the camera

    def slabs(self, table: Table, fabric: tuple[int, int, int]) -> tuple[Slab, ...]:
        """Return the objects that lie or are held before the camera. fabric: colour of the garment, RGB."""
        found = []
        laid = self._garment.positions[:, :2] if self._garment.laid else np.array([[sum(table.x) / 2, 0.0]])
        hand = self._board.active(K.HAND_IN_VIEW)
        if hand is not None:
            rng = np.random.default_rng((hand.seed, 2))
            point = laid[int(rng.integers(len(laid)))] if len(laid) > 1 else laid[0]
            found.append(hand_over(point, table.height + hand.extent, float(rng.uniform(-np.pi / 2, np.pi / 2))))
        second = self._board.active(K.SECOND_GARMENT)
        if second is not None:
            rng = np.random.default_rng((second.seed, 3))
            point = _free_place(laid, rng)
            angle, height = float(rng.uniform(0.0, np.pi / 2)), table.height + CLOTH_HEIGHT
            found.append(square_cloth(point, second.extent, angle, height, fabric))
        return tuple(found)


def _free_place(occupied: Array, rng: np.random.Generator) -> Array:
    """Return the one of several random places on the table (2,) [m] that is farthest from the vertices `occupied`
    (n, 2)."""
    places = np.column_stack((rng.uniform(*SEEN_X, DIRECTIONS), rng.uniform(*SEEN_Y, DIRECTIONS)))
    distance = np.linalg.norm(places[:, None] - occupied[None], axis=2).min(axis=1)
    return np.asarray(places[int(np.argmax(distance))])
