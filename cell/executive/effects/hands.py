"""Both hands in one loop: read, let each hand's controller decide, command, one tick on.

The controllers of skills.grasping are pure; this is where they meet the ports. A loop ends when every hand
has ended, or with the first failure; the arms are commanded on every tick, so that they never time out.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import TypeVar

import numpy as np

from cell.control.sent import faded
from cell.control.streaming import Watch, followed, fresh_state, start_mismatch
from cell.control.ticks import TICK_S, Ticks
from cell.hardware.workcell import Workcell
from robots.errors import Failure, FailureKind
from robots.ports import Array, JointState, Side, arm_slice
from skills.grasping.hand_reading import GripCommand, HandReading
from skills.motion.kinematics.ik import tool_pose
from skills.motion.timing.jerk_limiter import Follower, follow
from skills.vocabulary import Outcome

__all__ = ["comes_to_rest", "command_grip", "each_hand", "lowered", "read_hand", "telemetry", "tool_height"]

S = TypeVar("S")
V = TypeVar("V")

LONGEST_LOOP_S = 30.0
HAND_SPEED, HAND_ACCELERATION, HAND_JERK = 0.4, 0.6, 12.0
"""Of a descending hand's set-point [m/s], [m/s2], [m/s3]: what the controller asks for may jump."""


def tool_height(cell: Workcell, side: Side, q: Array) -> float:
    """Height of a tool centre point over the table [m] at joints q (14,)."""
    return float(tool_pose(cell.robot.chains[side], q[arm_slice(side)])[2, 3] - cell.table.height)


def lowered(hand: Follower, depth: float, speed: float) -> Follower:
    """A hand's set-point a tick later, on its way to a depth [m] that grows at `speed` [m/s]."""
    return follow(hand, depth, speed, TICK_S, speed=HAND_SPEED, acceleration=HAND_ACCELERATION, jerk=HAND_JERK)


def comes_to_rest(hand: Follower) -> float:
    """About where a set-point that is on its way ends when it brakes from now on [m]."""
    v = hand.velocity
    return hand.position + 0.5 * v * (abs(v) / HAND_ACCELERATION + HAND_ACCELERATION / HAND_JERK)


def read_hand(cell: Workcell, side: Side, state: JointState) -> HandReading:
    """One hand's sensors, recorded."""
    tactile, gripper = cell.ports.tactile[side].reading(), cell.ports.grippers[side].state()
    cell.recorder.tactile(tactile)
    cell.recorder.gripper(gripper)
    cut = arm_slice(side)
    return HandReading(
        cell.ports.clock.now(), tactile, gripper, tool_height(cell, side, state.q), state.effort[cut]
    )


def command_grip(cell: Workcell, side: Side, command: GripCommand) -> None:
    gripper = cell.ports.grippers[side]
    gripper.command(min(command.opening, gripper.max_opening), command.force)


def telemetry(cell: Workcell, watch: Watch | None = None) -> Watch:
    """A watch that records the arms and both hands, and then watches as `watch` does."""

    def look(tick):  # type: ignore[no-untyped-def]
        cell.recorder.joints(tick.state)
        for side in Side:
            cell.recorder.tactile(cell.ports.tactile[side].reading())
            cell.recorder.gripper(cell.ports.grippers[side].state())
        return watch(tick) if watch else None

    return look


def each_hand(
    cell: Workcell,
    states: Mapping[Side, S],
    tick: Callable[[Side, HandReading, S], S | Outcome[V]],
    arms: Callable[[Mapping[Side, S]], Array] | None = None,
) -> Outcome[dict[Side, V]]:
    """Run one controller a hand until all have ended.

    tick: (side, reading, state) -> next state or outcome. arms: the set-point (14,) to command given the
    states of the hands that still run, asked once a tick; None: the arms stand still. Failures: the first hand's
    that fails, STOPPED, STALE_STATE, START_MISMATCH, LIMIT_EXCEEDED, TRACKING_ERROR.
    """
    ports = cell.ports
    running, values = dict(states), dict[Side, V]()
    start = fresh_state(ports, cell.execution)
    if start.failure:
        return Outcome(failure=start.failure)
    still = start.unwrap().q
    first = arms(running) if arms else still
    near = replace(start.unwrap(), q=still + cell.sent.offset(still))  # arms that sag are where they were sent
    elsewhere = start_mismatch(near, first, cell.execution)
    if elsewhere:
        return Outcome(failure=elsewhere)
    offset = cell.sent.offset(first)
    q = first + offset
    ticks = Ticks(ports)
    for k in range(1, round(LONGEST_LOOP_S / TICK_S)):
        goal = (still if not arms else first if k == 1 else arms(running)) + faded(k - 1) * offset
        sent = ports.arms.command(goal, (goal - q) / TICK_S if arms else np.zeros_like(q))
        cell.sent.q = q = goal
        ticks.wait()
        read = followed(ports, goal, sent, cell.execution)
        if read.failure:
            return Outcome(failure=read.failure)
        state = read.unwrap()
        cell.recorder.joints(state)
        for side in tuple(running):
            after = tick(side, read_hand(cell, side, state), running[side])
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
