"""Run hand controllers as a motion: on every tick, the sensors of each hand are read and its controller gets the
reading.

The motion connects the pure controllers of skills.grasping with the ports. It ends when every hand has ended, or
with the first failure. It cannot be paused.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Protocol, TypeVar

import numpy as np

from foldcell.cell.control.hand_record import HandRecord
from foldcell.cell.control.loop import ControlLoop
from foldcell.cell.control.motion import Motion, SetPoint, Tick, Watch
from foldcell.cell.control.set_points import LastCommand, blend
from foldcell.cell.control.ticks import TICK_S
from foldcell.robots.errors import Failure, FailureKind
from foldcell.robots.model import RobotModel
from foldcell.robots.ports import Array, GripperState, JointState, Ports, Side, TactileReading, arm_slice
from foldcell.skills.grasping.hand_reading import GripCommand, HandReading
from foldcell.skills.motion.kinematics.ik import tool_pose
from foldcell.skills.motion.moves.grasp import Descent
from foldcell.skills.vocabulary import Outcome, Table

S = TypeVar("S")
V = TypeVar("V")

LONGEST_LOOP_S = 30.0


class Telemetry(Protocol):
    """Receives sensor readings, which are written to the recording of the run."""

    def joints(self, state: JointState) -> None: ...

    def tactile(self, reading: TactileReading) -> None: ...

    def gripper(self, state: GripperState) -> None: ...


@dataclass(frozen=True, eq=False)
class Hands:
    """Both hands: their sensors, pads and heights."""

    ports: Ports
    robot: RobotModel
    table: Table
    telemetry: Telemetry
    record: HandRecord = field(default_factory=HandRecord)

    def height(self, side: Side, q: Array) -> float:
        """Height of a tool centre point above the table [m] at joints q (joints,)."""
        return float(tool_pose(self.robot.chains[side], q[arm_slice(side, len(q))])[2, 3] - self.table.height)

    def depth(self, side: Side, descent: Descent, q: Array) -> float:
        """Depth of a hand below the top of its descent [m] at joints q (joints,)."""
        top = np.zeros_like(q)
        top[arm_slice(side, len(q))] = descent.q[0]
        return self.height(side, top) - self.height(side, q)

    def read(self, side: Side, state: JointState) -> HandReading:
        """Read and record one hand's sensors. state: state of the arms at the same moment."""
        tactile, gripper = self.ports.tactile[side].reading(), self.ports.grippers[side].state()
        self.telemetry.tactile(tactile)
        self.telemetry.gripper(gripper)
        height, effort = self.height(side, state.q), state.effort[arm_slice(side, len(state.q))]
        return HandReading(self.ports.clock.now(), tactile, gripper, height, effort)

    def command(self, side: Side, command: GripCommand) -> None:
        gripper = self.ports.grippers[side]
        gripper.command(min(command.opening, gripper.max_opening), command.force)

    def note(self, state: JointState) -> None:
        """Record the grippers, and the course of the hands. state: of the arms at the same moment."""
        grippers = {side: self.ports.grippers[side].state() for side in Side}
        for gripper in grippers.values():
            self.telemetry.gripper(gripper)
        self.record.add(state, {side: gripper.opening for side, gripper in grippers.items()})

    def recording(self, watch: Watch | None = None) -> Watch:
        """Return a watch that records the arms and both hands, then calls `watch`."""

        def look(tick: Tick) -> Failure | None:
            self.telemetry.joints(tick.state)
            for side in Side:
                self.telemetry.tactile(self.ports.tactile[side].reading())
            self.note(tick.state)
            return watch(tick) if watch else None

        return look


Control = Callable[[Side, HandReading, S], S | Outcome[V]]
"""One tick of a hand: (side, reading, state) -> its next state, or its outcome."""


def commanding(
    hands: Hands, controller: Callable[[HandReading, S], tuple[GripCommand, S | Outcome[V]]]
) -> Control[S, V]:
    """Make the `Control` of a hand from a controller that also commands the gripper."""

    def control(side: Side, reading: HandReading, state: S) -> S | Outcome[V]:
        command, after = controller(reading, state)
        hands.command(side, command)
        return after

    return control


def each_hand(
    loop: ControlLoop, hands: Hands, states: Mapping[Side, S], control: Control[S, V]
) -> Outcome[dict[Side, V]]:
    """Run one controller per hand until all have ended, while the arms hold their position. states: initial state
    of each hand's controller.

    Failures: those of the loop; the first failure of a hand; GRIPPER_FAULT if a hand does not end.
    """
    return loop.run(lambda start: control_hands(hands, loop.last_command, start, states, control))


def control_hands(
    hands: Hands,
    last_command: LastCommand,
    start: JointState,
    states: Mapping[Side, S],
    control: Control[S, V],
    arms: Callable[[], Array] | None = None,
) -> Motion[dict[Side, V]]:
    """Run the controllers as a motion. arms: called once per tick for the set-point (joints,); None: the arms hold
    their position.

    The motion starts only if the arms are near `SetPoint.begins`: the joints at which the arms would settle under
    the motion's first set-point. They are computed as the first set-point minus the present tracking error.
    """
    running, values = dict(states), dict[Side, V]()
    still = start.q
    first = arms() if arms else still
    offset, begins = last_command.offset(first), first - last_command.offset(still)
    q = first + offset
    for k in range(round(LONGEST_LOOP_S / TICK_S) - 1):
        goal = (still if not arms else first if k == 0 else arms()) + blend(k) * offset
        feedback = yield SetPoint(goal, (goal - q) / TICK_S if arms else np.zeros_like(q), begins)
        q = goal
        hands.telemetry.joints(feedback.state)
        for side in tuple(running):
            after = control(side, hands.read(side, feedback.state), running[side])
            if not isinstance(after, Outcome):
                running[side] = after
                continue
            if after.failure:
                return Outcome(failure=after.failure)
            values[side] = after.unwrap()
            del running[side]
        if not running:
            return Outcome(values)
    return Outcome(failure=Failure(FailureKind.GRIPPER_FAULT, f"a hand has not ended in {LONGEST_LOOP_S:.0f} s"))
