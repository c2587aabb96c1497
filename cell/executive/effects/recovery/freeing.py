"""Leave the garment after the release. If cloth clings to a finger: back down, close and open the hand, leave
again."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from cell.control.checks import come_to_rest, fresh_state
from cell.control.motion import Tick, Watch
from cell.control.motions.hands import each_hand
from cell.control.motions.hold_position import wait
from cell.control.path_clock import PathControl
from cell.executive.effects.checked_motion import move
from cell.executive.effects.recovery.parking import OPENING_S, RELEASE_OPENING, still_closed
from cell.hardware.workcell import Workcell
from robots.errors import Failure, FailureKind
from robots.ports import ArmTrajectory, Array, Side
from skills.grasping.hand_reading import GripCommand
from skills.grasping.stuck_on_finger import DragWatch, check_stuck, start_stuck_check, watch_drag
from skills.grasping.tare import TactileBias
from skills.motion.moves.retrace import plan_along
from skills.motion.moves.retreat import Retreat
from skills.vocabulary import Outcome

__all__ = ["FREEING_TRIES", "leave_freely"]

FREEING_TRIES = 2
"""Number of times that the hands go back down: once for each hand."""
FREEING_SPEED = 0.25
"""Maximum speed of the tools while cloth may hang on a finger [m/s]."""


def leave_freely(
    cell: Workcell, way: Retreat, biases: Mapping[Side, TactileBias], control: PathControl
) -> Failure | None:
    """Lead the hands up and to the parked posture, and check that no cloth clings to a finger: above the garment,
    and while they move away, because light cloth is felt only when it drags the garment along.

    If it does, the hands go back along the same way, so that the cloth lies about as it was released. The caught
    hand closes and opens there, and both leave again. STUCK_ON_FINGER is returned after FREEING_TRIES.
    """
    up, home = way.retreat, way.park
    failure = (
        move(cell, up, fingertips=True, control=control)
        or _clinging(cell, biases)
        or move(cell, home, control=control, watch=_dragging(cell, biases))
    )
    for _ in range(FREEING_TRIES):
        if failure is None or failure.kind is not FailureKind.STUCK_ON_FINGER:
            return failure
        caught = tuple(side for side in biases if side == failure.values.get("side"))
        cell.tell(f"{failure.what}: the hand goes back down, closes and opens")
        failure = (
            _follow(cell, np.vstack([up.q, home.q])[::-1], control)
            or _close_and_open(cell, caught)
            or _follow(cell, up.q, control)
            or _clinging(cell, biases)
            or _follow(cell, home.q, control, fingertips=False, watch=_dragging(cell, biases))
        )
    return failure


def _dragging(cell: Workcell, biases: Mapping[Side, TactileBias]) -> Watch:
    """Return a watch that ends the motion of a hand that drags cloth along."""
    watches = {side: DragWatch(start_stuck_check(cell.grasp, bias)) for side, bias in biases.items()}

    def look(tick: Tick) -> Failure | None:
        for side, watch in watches.items():
            after = watch_drag(cell.hands.read(side, tick.state), watch)
            if isinstance(after, Failure):
                return after
            watches[side] = after
        return None

    return look


def _clinging(cell: Workcell, biases: Mapping[Side, TactileBias]) -> Failure | None:
    checks = {side: start_stuck_check(cell.grasp, bias) for side, bias in biases.items()}
    return each_hand(cell.loop, cell.hands, checks, lambda side, r, state: check_stuck(r, state)).failure


def _close_and_open(cell: Workcell, sides: tuple[Side, ...]) -> Failure | None:
    """Close the hands and open them as far as at the release, with the force of a release."""
    for opening in (0.0, RELEASE_OPENING):
        for side in sides:
            cell.hands.command(side, GripCommand(opening, cell.grasp.release_force))
        failure = wait(cell.loop, OPENING_S, cell.hands.recording())
        if failure:
            return failure
    for side in sides:
        cell.hand_record.freed(side)
    return still_closed(cell)


def _follow(
    cell: Workcell, path: Array, control: PathControl, fingertips: bool = True, watch: Watch | None = None
) -> Failure | None:
    planned = _plan(cell, path)
    return planned.failure or move(cell, planned.unwrap(), fingertips=fingertips, control=control, watch=watch)


def _plan(cell: Workcell, path: Array) -> Outcome[ArmTrajectory]:
    unsettled = come_to_rest(cell.ports, cell.execution, cell.last_command)
    state = fresh_state(cell.ports, cell.execution)
    if unsettled or state.failure:
        return Outcome(failure=unsettled or state.failure)
    return plan_along(
        cell.robot, cell.execution_checker, state.unwrap().q, path, limits=cell.limits, tool_speed=FREEING_SPEED
    )
