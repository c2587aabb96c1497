"""The arm motion of one fold: approach, descent, arc, retreat and return to the parked pose.

`plan_hands_motion` plans the whole motion before anything moves. The height at which the guarded descent ends is
known only when it has ended. `arc.plan_arc` is therefore called again from the configuration that was reached. If
a grasp is tried again at another place, `grasp.plan_grasp` is called again.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from foldcell.robots.errors import Failure
from foldcell.robots.model import JointLimits, RobotModel
from foldcell.robots.ports import Array, Side, frozen
from foldcell.skills.motion.kinematics.posture import Posture
from foldcell.skills.motion.moves.arc import ArcMotion, intended_duration, plan_arc
from foldcell.skills.motion.moves.grasp import APPROACH_HEIGHT, GraspMotion, plan_grasp
from foldcell.skills.motion.moves.lift import plan_lift
from foldcell.skills.motion.moves.posture_search import PostureChoice, rank_postures
from foldcell.skills.motion.moves.retreat import RETREAT_HEIGHT
from foldcell.skills.motion.validation.collision import CollisionChecker
from foldcell.skills.motion.validation.failures import (
    validate_height,
    validate_paths,
    validate_state,
    validate_tool_speed,
)
from foldcell.skills.vocabulary import GraspId, Outcome, Table, ToolPath, refuse, skill

MAX_STRETCH = 1.3
"""If the arms' limits lengthen the fold's duration by more than this factor, the next postures are tried too."""
SEARCHES = 2
"""Maximum number of posture searches. A search is coarse, so the detailed planning can reject all its choices.
Then a second search looks for others."""
SHIFTS = (0.06, 0.15)
"""Lengths of the shifts that are tried in turn, each along x and along y, towards the table's middle [m]."""


@dataclass(frozen=True, eq=False, kw_only=True)
class FoldMotion(GraspMotion, ArcMotion):
    """The motion of a whole fold. postures: by arm; each names the grasp of the step that the arm takes."""

    postures: Mapping[Side, Posture]

    @property
    def duration(self) -> float:
        """Total time of all parts except the guarded descent, whose duration is not known beforehand [s]."""
        return sum(part.duration for part in (self.approach, self.fold, self.retreat, self.park))


@skill
def plan_hands_motion(
    model: RobotModel,
    checker: CollisionChecker,
    table: Table,
    paths: Mapping[GraspId, ToolPath],
    q_now: Array,
    *,
    limits: JointLimits | None = None,
    tool_speed: float | None = None,
    approach_height: float = APPROACH_HEIGHT,
    reach_height: float | None = None,
    lift: float = 0.0,
    avoid: Sequence[Mapping[Side, Posture]] = (),
    upright_grasps: bool = False,
    rng: np.random.Generator | None = None,
) -> Outcome[FoldMotion]:
    """Plan the hands' motion from q_now (joints,), at rest: to points above the starts of their paths, down, along
    the paths, up and to the parked pose.

    reach_height: height above the starts that the postures have to reach, so that they are not at the edge of
    their reach there [m]; None: approach_height.
    The function chooses the lean of the hands, and the arm for each path. limits: the model's planning limits when
    None. tool_speed: maximum speed while the cloth is held [m/s]. lift: height of a straight lift between grasp
    and fold [m]; the paths then begin higher by this height. avoid: postures of earlier motions, which are not
    chosen again. upright_grasps: prefer hands that are upright at the grasp. rng: for RRT-Connect. Failures:
    UNREACHABLE, IN_COLLISION (with the binding constraint, and a shift of the garment if one helps),
    LIMIT_EXCEEDED, STALE_STATE (q_now is not a valid state).
    """
    refuse(
        validate_state(model, q_now)
        or validate_paths(paths)
        or validate_tool_speed(tool_speed)
        or validate_height(approach_height)
        or validate_height(lift)
    )
    plan = partial(
        _plan_with, model, checker, table, paths, q_now, limits=limits, tool_speed=tool_speed,
        approach_height=approach_height, lift=lift, rng=rng,
    )  # fmt: skip
    intended = intended_duration(paths, tool_speed)
    tried: list[Mapping[Side, Posture]] = list(avoid)
    above = approach_height if reach_height is None else reach_height
    first_failure: Failure | None = None
    for _ in range(SEARCHES):
        ranked = rank_postures(
            model, checker, table, paths, q_now, above=above, below=RETREAT_HEIGHT, avoid=tried,
            upright_grasps=upright_grasps,
        )  # fmt: skip
        if ranked.failure:
            break
        choices = ranked.unwrap()
        best, failure = _best_motion(plan, choices, intended)
        if best is not None:
            return Outcome(best, notes={**ranked.notes, "duration_s": round(best.duration, 3)})
        first_failure = first_failure or failure
        tried += [choice.postures for choice in choices]
    failure = first_failure or ranked.failure
    assert failure is not None
    if first_failure or avoid:  # With `avoid`, a recovery wants other postures, not a shift of the garment.
        return Outcome(failure=failure)
    with_suggestion = _with_shift_suggestion(
        model, checker, table, paths, q_now, failure, above=above, below=RETREAT_HEIGHT
    )
    return Outcome(failure=with_suggestion)


def _best_motion(
    plan: Callable[[PostureChoice], Outcome[FoldMotion]], choices: Sequence[PostureChoice], intended: float
) -> tuple[FoldMotion | None, Failure | None]:
    """Plan the choices in detail, in order. Return the first motion whose fold takes less than MAX_STRETCH times
    the `intended` duration [s], else the shortest motion; and the first failure."""
    best: FoldMotion | None = None
    failure: Failure | None = None
    for choice in choices:
        planned = plan(choice)
        failure = failure or planned.failure
        if planned.value is not None and (best is None or planned.value.duration < best.duration):
            best = planned.value
        if best is not None and best.fold.duration < MAX_STRETCH * intended:
            break
    return best, failure


@skill
def _plan_with(
    model: RobotModel,
    checker: CollisionChecker,
    table: Table,
    paths: Mapping[GraspId, ToolPath],
    q_now: Array,
    choice: PostureChoice,
    *,
    limits: JointLimits | None,
    tool_speed: float | None,
    approach_height: float,
    lift: float,
    rng: np.random.Generator | None,
) -> Outcome[FoldMotion]:
    """Plan the whole motion in detail with one choice of postures."""
    grasp = plan_grasp(
        model, checker, table, paths, choice.postures, q_now, limits=limits,
        approach_height=approach_height, rng=rng, q_hint={side: q[0] for side, q in choice.q.items()},
    ).unwrap()  # fmt: skip
    q_fold = grasp.q_grasp
    if lift > 0.0:
        q_fold = plan_lift(model, checker, q_fold, tuple(choice.postures), lift, limits=limits).unwrap().q[-1]
    arc = plan_arc(
        model, checker, table, paths, choice.postures, q_fold,
        limits=limits, tool_speed=tool_speed, rng=rng,
    ).unwrap()  # fmt: skip
    return Outcome(FoldMotion(postures=choice.postures, **vars(grasp), **vars(arc)))


def _with_shift_suggestion(
    model: RobotModel,
    checker: CollisionChecker,
    table: Table,
    paths: Mapping[GraspId, ToolPath],
    q_now: Array,
    failure: Failure,
    *,
    above: float,
    below: float,
) -> Failure:
    """Return the same failure, with a shift of the garment that makes the fold feasible, if one of SHIFTS does.

    The hint describes the shift. values["shift_m"]: (2,) in the table frame, None when no shift helps. The search
    takes up to four posture searches. If the arms block each other, no shift is tried, because they would block
    each other wherever the garment lies.
    """
    if failure.values.get("binding", {}).get("constraint") == "arms":
        return failure
    for shift in _candidate_shifts(table, paths, failure):
        moved = {i: replace(p, position=frozen(p.position + np.append(shift, 0.0))) for i, p in paths.items()}
        if rank_postures(model, checker, table, moved, q_now, above=above, below=below).ok:
            values = {**failure.values, "shift_m": shift.tolist()}
            return replace(failure, hint=f"lay the garment {_describe(shift)}", values=values)
    none_helps = f"no shift of up to {max(SHIFTS) * 1e3:.0f} mm towards the table's middle would help"
    return replace(failure, hint=f"{failure.hint}; {none_helps}", values={**failure.values, "shift_m": None})


def _candidate_shifts(table: Table, paths: Mapping[GraspId, ToolPath], failure: Failure) -> Iterator[Array]:
    """Yield shifts (2,) [m] that move the place which no arm reached towards the table's middle. If the failure
    states no such place, the shifts move the middle of the tool paths."""
    place = failure.values.get("binding", {}).get("where_m", [])[:2]
    if not place:
        place = np.mean([p.position[:, :2].mean(axis=0) for p in paths.values()], axis=0)
    gap = np.array([sum(table.x) / 2, sum(table.y) / 2]) - place
    for size in SHIFTS:
        for axis in np.argsort(-np.abs(gap)):
            yield size * (1.0 if gap[axis] >= 0.0 else -1.0) * np.eye(2)[axis]


def _describe(shift: Array) -> str:
    length = f"{np.abs(shift).max() * 1e3:.0f} mm"
    if shift[0]:
        return f"{length} {'further from' if shift[0] > 0 else 'nearer to'} the robot"
    return f"{length} to the robot's {'left' if shift[1] > 0 else 'right'}"
