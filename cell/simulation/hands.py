"""Both hands of the simulated cell at the cloth: touch, grasp, and the bodies that push the cloth."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from foldcell.cell.simulation.faults.board import FaultBoard
from foldcell.cell.simulation.faults.kinds import FaultKind
from foldcell.cell.simulation.faults.world_faults import HANDS, WorldFaults
from foldcell.cell.simulation.garment.garment import WorldGarment
from foldcell.cell.simulation.noise import NoiseTable
from foldcell.cell.simulation.robot import contact
from foldcell.cell.simulation.robot.gripper import SimulatedGripper
from foldcell.cell.simulation.robot.tactile import SimulatedTactile
from foldcell.robots.gripper_geometry import GripperGeometry
from foldcell.robots.ports import Array, Side
from foldcell.robots.robot import SimulatedBody
from foldcell.skills.vocabulary import Table

RAISED = 0.040
"""While a hand holds cloth, this length of each finger, from the tip upwards, does not push cloth [m]. The held
cloth is in this part. The same applies after a release, until the fingers are clear of the cloth."""
NEAR = 0.08
"""A hand that is higher than this above the garment cannot touch it [m]."""
THICKEST = 0.025
"""Fingertips above this height can touch neither the table nor a stack of cloth [m]."""
SQUEEZE = 2e-4
"""Depth to which a fingertip compresses the flat stack of cloth under it [m]. With a larger depth, table and
finger would push the cloth in opposite directions."""
LIFTED = 0.05
"""A fold has begun when a hand holds the garment above this height [m]."""


class Hand:
    """One hand: its pose at the last cloth frame (table frame), its gripper and its tactile sensors."""

    def __init__(self, gripper: SimulatedGripper, tactile: SimulatedTactile) -> None:
        self.gripper, self.tactile = gripper, tactile
        self.position, self.rotation = np.zeros(3), np.eye(3)
        self.tip_force = np.zeros(2)
        """Force on each fingertip [N]."""
        self.free = True
        """Whether the tips push cloth. False from a grasp until the cloth no longer touches the tips."""
        self.capsules: tuple[Array, Array] | None = None
        self.grasps = 0


class Hands:
    """Both hands. `frame` moves the cloth along the way of the hands since the last cloth frame."""

    def __init__(
        self,
        body: SimulatedBody,
        shape: GripperGeometry,
        table: Table,
        garment: WorldGarment,
        board: FaultBoard,
        faults: WorldFaults,
        noise: NoiseTable,
        rng: np.random.Generator,
        ideal: bool,
    ) -> None:
        self._body, self._shape, self._table, self._garment = body, shape, table, garment
        self._board, self._faults, self._noise = board, faults, noise
        self._stiffness = contact.Stiffness(
            noise.robot.arm_stiffness, noise.tactile.tip_stiffness, noise.tactile.cloth_stiffness
        )
        self._lifted = False
        self._hands = {side: self._build(side, rng, ideal) for side in Side}
        for side in Side:
            self._place(side)

    def __getitem__(self, side: Side) -> Hand:
        return self._hands[side]

    @property
    def openings(self) -> dict[Side, float]:
        """Distance between the pads of each hand [m]."""
        return {side: hand.gripper.opening for side, hand in self._hands.items()}

    @property
    def grippers(self) -> dict[Side, SimulatedGripper]:
        return {side: hand.gripper for side, hand in self._hands.items()}

    def _build(self, side: Side, rng: np.random.Generator, ideal: bool) -> Hand:
        gripper = SimulatedGripper(
            side, self._shape.max_opening, self._noise.gripper, int(rng.integers(2**31)), ideal,
            caught=lambda stroke, force: self._caught(side, stroke, force),
            opened=lambda: self._opened(side),
        )  # fmt: skip
        tactile = SimulatedTactile(
            side, self._noise.tactile, int(rng.integers(2**31)), ideal,
            pressing=lambda: gripper.pressing,
            tips=lambda: self.touch(side)[2].force,
            clinging=lambda: self._clinging(side),
        )  # fmt: skip
        return Hand(gripper, tactile)

    # touch

    def touch(self, side: Side) -> tuple[Array, Array, contact.Touch]:
        """Return the tool position (3,) after the table has lifted the hand, the rotation (3, 3), both in the
        table frame, and the contact of the tips."""
        position, rotation = self._body.tool_pose(side)
        position[2] -= self._table.height
        tips = contact.fingertips(self._shape, position, rotation, self[side].gripper.opening)
        if tips[:, 2].min() > THICKEST or not self._over_table(position):
            return position, rotation, contact.Touch(np.zeros(2), 0.0)
        stack = np.array([self._garment.stack(tip) for tip in tips])
        contacts = contact.touch(tips, stack, self._stiffness)
        position[2] += contacts.lift
        return position, rotation, contacts

    def _over_table(self, p: Array) -> bool:
        x, y = self._table.x, self._table.y
        return bool(x[0] <= p[0] <= x[1] and y[0] <= p[1] <= y[1])

    def _clinging(self, side: Side) -> float:
        """Return the pull of cloth that is caught on a finger of this side [N]."""
        return float(np.linalg.norm(self._garment.pull(HANDS[side]))) if self._faults.caught(side) else 0.0

    def _place(self, side: Side) -> None:
        hand = self[side]
        hand.position, hand.rotation, touch = self.touch(side)
        hand.tip_force = touch.force

    # grasp

    def _caught(self, side: Side, stroke: float, force: float) -> float:
        """Hold the cloth between the closing pads from now on. Returns its thickness [m], 0 for nothing."""
        hand, garment = self[side], self._garment
        if not garment.laid:
            return 0.0
        hand.position, hand.rotation, _ = self.touch(side)
        self._faults.freed(side)
        report = garment.grip(HANDS[side], hand.position, hand.rotation, stroke, force)
        if report.held_points == 0:
            return 0.0
        hand.grasps += 1
        hand.free = False
        if self._board.take(FaultKind.MISSED_GRASP, side, grasp=hand.grasps):
            garment.release(HANDS[side])
            return 0.0
        return report.layers * garment.material.thickness

    def _opened(self, side: Side) -> None:
        """Release the cloth, unless it is caught on a finger."""
        if not self._faults.catches(side):
            self._garment.release(HANDS[side])

    def holds(self, side: Side) -> bool:
        return self._garment.holds(HANDS[side])

    # moving the cloth

    def frame(self) -> None:
        """Advance the cloth by one frame, in which the hands move from their last poses to the present ones."""
        hands, garment, shape = self._hands.values(), self._garment, self._shape
        before = [hand.capsules for hand in hands]
        p, r = [hand.position for hand in hands], [hand.rotation for hand in hands]
        for side, hand in self._hands.items():
            self._place(side)
            hand.capsules = self._capsules(side)
            if self.holds(side):
                garment.squeeze(HANDS[side], self._faults.grip_force(side, hand.gripper.force))
        tips = [contact.fingertips(shape, hand.position, hand.rotation, hand.gripper.opening) for hand in hands]
        garment.press(np.vstack(tips), np.hstack([hand.tip_force for hand in hands]), self._noise.tactile.tip_area)
        position = np.array([p, [hand.position for hand in hands]])
        rotation = np.array([r, [hand.rotation for hand in hands]])
        garment.frame(position, rotation, self._capsule_path(before))
        self._note_folds()

    def _capsules(self, side: Side) -> tuple[Array, Array] | None:
        """Return both ends (3, 3) of the capsules of fingers and gripper body; None if far above the garment."""
        hand, garment, shape = self[side], self._garment, self._shape
        if hand.position[2] > garment.highest() + NEAR:
            hand.free = True
            return None
        opening, holds = hand.gripper.opening, self.holds(side)
        if not hand.free and not holds:
            low, high = contact.finger_axes(shape, hand.position, hand.rotation, opening, np.zeros(2), 0.0)
            reach = shape.finger_radius + garment.material.thickness
            hand.free = all(garment.clear_of(a, b, reach) for a, b in zip(low, high, strict=True))
        tips = contact.fingertips(shape, hand.position, hand.rotation, opening)
        floor = np.zeros(2)
        if tips[:, 2].min() < THICKEST:
            floor = np.array([garment.stack(tip) for tip in tips]) - SQUEEZE
        raised = 0.0 if hand.free and not holds else RAISED
        low, high = contact.finger_axes(shape, hand.position, hand.rotation, opening, floor, raised)
        body_low, body_high = contact.hand_axis(shape, hand.position, hand.rotation)
        return np.vstack((low, body_low)), np.vstack((high, body_high))

    def _capsule_path(self, before: list[tuple[Array, Array] | None]) -> tuple[Array, Array, Array] | None:
        """Return both ends (2, k, 3) [m], at the start and the end of the frame, and radius (k,) [m] of the
        capsules near the garment."""
        moved = [
            (old or hand.capsules, hand.capsules)
            for old, hand in zip(before, self._hands.values(), strict=True)
            if hand.capsules is not None
        ]
        if not moved:
            return None
        low = np.array([np.vstack([pair[when][0] for pair in moved]) for when in (0, 1)])
        high = np.array([np.vstack([pair[when][1] for pair in moved]) for when in (0, 1)])
        radius = [self._shape.finger_radius, self._shape.finger_radius, self._shape.hand_radius] * len(moved)
        return low, high, np.array(radius)

    def _note_folds(self) -> None:
        """Release cloth that slipped out, by force or by fault, and count the folds."""
        held = False
        for side, hand in self._hands.items():
            if not hand.gripper.holding:
                continue
            lifted = float(hand.position[2])
            if self._board.take(FaultKind.DROPPED_CORNER, side, hand.grasps, lifted):
                self._garment.release(HANDS[side])
            if not self.holds(side):
                hand.gripper.lost()
                continue
            held = True
            self._lifted |= lifted > LIFTED
        if self._lifted and not held:
            self._lifted = False
            self._board.fold += 1

    # checkpoints

    def snapshot(self) -> dict[str, Any]:
        """Return the state for a later `resume`, as plain values."""
        hands = {side.value: [hand.grasps, hand.free] for side, hand in self._hands.items()}
        grippers = {side.value: hand.gripper.snapshot() for side, hand in self._hands.items()}
        return {"hands": hands, "grippers": grippers, "lifted": self._lifted}

    def resume(self, saved: Mapping[str, Any]) -> None:
        """Restore a snapshot. Call `place` when the arms are at their places."""
        self._lifted = saved["lifted"]
        for side, hand in self._hands.items():
            hand.gripper.resume(saved["grippers"][side.value])
            hand.tactile.forget()
            hand.grasps, hand.free = saved["hands"][side.value]
            hand.capsules = None

    def place(self) -> None:
        """Take the present poses of the arms as the poses from which the next frame starts."""
        for side in Side:
            self._place(side)
