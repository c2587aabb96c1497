"""Free cloth that clings to a finger after the release: back down, close and open the hand, rise again."""

from __future__ import annotations

from collections.abc import Mapping

from cell.control.checks import come_to_rest, fresh_state
from cell.control.motions.hands import each_hand
from cell.control.motions.hold_position import wait
from cell.control.path_clock import PathControl
from cell.executive.effects.checked_motion import move
from cell.executive.effects.parking import OPENING_S, RELEASE_OPENING, still_closed
from cell.hardware.workcell import Workcell
from robots.errors import Failure, FailureKind
from robots.ports import ArmTrajectory, Array, Side
from skills.grasping.hand_reading import GripCommand
from skills.grasping.stuck_on_finger import check_stuck, start_stuck_check
from skills.grasping.tare import TactileBias
from skills.motion.moves.retrace import plan_along
from skills.vocabulary import Outcome

__all__ = ["FREEING_TRIES", "rise_free"]

FREEING_TRIES = 2
"""Number of times that the hands go back down: once for each hand."""
FREEING_SPEED = 0.25
"""Maximum speed of the tools while cloth may hang on a finger [m/s]."""


def rise_free(
    cell: Workcell, up: ArmTrajectory, biases: Mapping[Side, TactileBias], control: PathControl
) -> Failure | None:
    """Lead the hands along `up`, and check that no cloth clings to a finger.

    If it does, the hands go back along `up`, so that the cloth lies as it was released. The caught hand closes and
    opens there, and both rise again. STUCK_ON_FINGER is returned after FREEING_TRIES.
    """
    failure = move(cell, up, fingertips=True, control=control) or _clinging(cell, biases)
    for _ in range(FREEING_TRIES):
        if failure is None or failure.kind is not FailureKind.STUCK_ON_FINGER:
            return failure
        caught = tuple(side for side in biases if side == failure.values.get("side"))
        cell.tell(f"{failure.what}: the hand goes back down, closes and opens")
        failure = (
            _follow(cell, up.q[::-1], control)
            or _close_and_open(cell, caught)
            or _follow(cell, up.q, control)
            or _clinging(cell, biases)
        )
    return failure


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
    return still_closed(cell)


def _follow(cell: Workcell, path: Array, control: PathControl) -> Failure | None:
    planned = _plan(cell, path)
    return planned.failure or move(cell, planned.unwrap(), fingertips=True, control=control)


def _plan(cell: Workcell, path: Array) -> Outcome[ArmTrajectory]:
    unsettled = come_to_rest(cell.ports, cell.execution, cell.last_command)
    state = fresh_state(cell.ports, cell.execution)
    if unsettled or state.failure:
        return Outcome(failure=unsettled or state.failure)
    return plan_along(
        cell.robot, cell.execution_checker, state.unwrap().q, path, limits=cell.limits, tool_speed=FREEING_SPEED
    )
