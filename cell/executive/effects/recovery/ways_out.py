"""The ways on which the arms are led out after a failure, with how often each of them is tried.

Laying down, freeing a finger and parking each have an ordered list of ways. A way is planned from where the arms
stand, checked, and performed. If its motion fails, the arms come to rest, and the next try or way follows. A way
that cannot be planned is not tried again.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from foldcell.cell.control.checks import come_to_rest, fresh_state
from foldcell.cell.control.motion import Watch
from foldcell.cell.control.path_clock import PathControl
from foldcell.cell.control.rest import await_rest, stand_by
from foldcell.cell.executive.effects.checked_motion import move
from foldcell.cell.hardware.workcell import Workcell
from foldcell.robots.errors import Failure, FailureKind
from foldcell.robots.ports import ArmTrajectory, Array, Side
from foldcell.skills.motion.moves.free_motion import plan_free_motion
from foldcell.skills.motion.moves.retrace import plan_along, without_loops
from foldcell.skills.motion.moves.retreat import Retreat, plan_retreat
from foldcell.skills.vocabulary import Outcome

RETRACE_SPEED = 0.25
"""Maximum speed of the tools on the way back along an earlier path, which may lead over the garment [m/s]."""
_FINAL = frozenset({FailureKind.STOPPED, FailureKind.ABORTED})
"""Failures after which nothing else is tried."""

Legs = tuple[tuple[ArmTrajectory, bool], ...]
"""Trajectories one after the other. The flag of each tells whether the fingertips may touch the table on it."""


@dataclass(frozen=True, eq=False)
class Course:
    """A checked path that the arms are led along: joints (n, joints) [rad], from its point nearest to the arms to
    its end. speed: largest speed of the tools [m/s]. fingertips: whether they may touch the table. watch: is
    called on every tick."""

    path: Array
    speed: float
    fingertips: bool = True
    watch: Watch | None = None


def along(cell: Workcell, course: Course) -> Outcome[Legs]:
    """Plan the way along the course."""
    state = fresh_state(cell.ports, cell.execution)
    if state.failure:
        return Outcome(failure=state.failure)
    planned = plan_along(
        cell.robot, cell.execution_checker, state.unwrap().q, course.path,
        limits=cell.limits, tool_speed=course.speed,
    )  # fmt: skip
    return (
        Outcome(failure=planned.failure) if planned.failure else Outcome(((planned.unwrap(), course.fingertips),))
    )


def straight_home(cell: Workcell, _: Course) -> Outcome[Legs] | None:
    """Plan a free motion to the parked posture. Returns None if the arms touch something where they are."""
    q = cell.ports.arms.state().q
    if cell.checker.contact(q) is not None:
        return None
    home = plan_free_motion(cell.robot, cell.checker, q, cell.robot.q_park, limits=cell.limits, rng=cell.rng())
    return Outcome(failure=home.failure) if home.failure else Outcome(((home.unwrap(), False),))


def up_and_home(cell: Workcell, _: Course) -> Outcome[Legs]:
    """Plan the way straight up, and from there to the parked posture."""
    up = plan_rise(cell, tuple(Side))
    if up.failure:
        return Outcome(failure=up.failure)
    return Outcome(((up.unwrap().retreat, True), (up.unwrap().park, False)))


def back_as_they_came(cell: Workcell, _: Course) -> Outcome[Legs] | None:
    """Plan the way back along the set-points that were sent, without its loops. Returns None if they do not begin
    at the parked posture."""
    path = cell.path.back()
    if len(path) < 2 or np.abs(path[-1] - cell.robot.q_park).max() > cell.execution.start:
        return None
    return along(cell, Course(without_loops(path), RETRACE_SPEED))


@dataclass(frozen=True)
class Way:
    """A way out. tries: how often its motion is tried; dwell_s: pause before each further try [s]."""

    plan: Callable[[Workcell, Course], Outcome[Legs] | None]
    tries: int = 1
    dwell_s: float = 0.0


LAYING = (Way(along, tries=3, dwell_s=0.8),)
"""Lay down cloth: along the path on which it was carried, back or on to its target."""
FREEING = (Way(along),)
"""Free a finger of cloth: back down the way that the hands have left, and away again."""
FREEING_TRIES = 2
"""Number of times that the hands go back down: once for each hand."""
PARKING = (Way(straight_home), Way(up_and_home), Way(back_as_they_came))
"""Lead the arms to the parked posture, after a failure near the garment and otherwise."""
CLEARING_DWELL_S = 2.0
"""After a failure of CLEARING, the cell waits for this time before CLEARING_AGAIN [s]. It is longer than most
transients, such as an arm that hangs for a moment."""
PREPARING_DWELLS_S = (1.0, 3.0)
"""PREPARING and RESUMING are tried again after each of these times [s], if the kind of failure is transient."""

NOWHERE = Course(np.zeros((0, 0)), 0.0)


def lead_out(
    cell: Workcell, ways: Sequence[Way], control: PathControl, course: Course = NOWHERE
) -> Failure | None:
    """Try the ways in turn. Returns None after the first that succeeds, else the last failure. No other way is
    tried after a stop or an abort."""
    failure, stand_still_s = None, None
    for way in ways:
        for _ in range(way.tries):
            if stand_still_s is not None:
                stand_by(cell.ports, stand_still_s)
                moving = await_rest(cell.ports, cell.execution, note=cell.hands.note)
                if moving and moving.kind in _FINAL:
                    return moving
                failure = moving or failure
            planned, stand_still_s = way.plan(cell, course), None
            if planned is None:
                break
            failure = planned.failure or _perform(cell, planned.unwrap(), control, course.watch)
            if failure is None or failure.kind in _FINAL:
                return failure
            if planned.failure:
                break
            stand_still_s = way.dwell_s
    return failure


def _perform(cell: Workcell, legs: Legs, control: PathControl, watch: Watch | None) -> Failure | None:
    for trajectory, fingertips in legs:
        failure = move(cell, trajectory, fingertips=fingertips, control=control, watch=watch)
        if failure:
            return failure
    return None


def plan_rise(cell: Workcell, sides: tuple[Side, ...]) -> Outcome[Retreat]:
    """Plan the hands' way straight up from where they rest, and from there to the parked posture."""
    failure = come_to_rest(cell.ports, cell.execution, cell.last_command)
    state = fresh_state(cell.ports, cell.execution)
    if failure or state.failure:
        return Outcome(failure=failure or state.failure)
    # the planning margins first, then the smaller margins of execution, and then one hand alone
    choices = [(cell.checker, sides), (cell.execution_checker, sides)]
    if sides == tuple(Side):
        choices += [(cell.execution_checker, (side,)) for side in Side]
    rng, both = cell.rng(), None
    for checker, hands in choices:
        planned = plan_retreat(cell.robot, checker, state.unwrap().q, hands, limits=cell.limits, rng=rng)
        if planned.ok:
            return planned
        both = planned if hands == sides else both
    assert both is not None
    if sides != tuple(Side):
        return both
    what = f"no retreat to the parked posture was found: {both.failure}"
    return Outcome(failure=Failure(FailureKind.UNREACHABLE, what, "move the arms by hand"))
