"""One whole fold as arm motion: to above the grasps, down, along the arc, up, and to the parked pose.

`plan_fold_motion` plans all of it before anything moves. The guarded descent then ends where it meets
something, so `arc.plan_arc` is called again from the configuration that was really reached, and
`grasp.plan_grasp` when a grasp is tried again elsewhere.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from robots.errors import Failure
from robots.model import JointLimits, RobotModel
from robots.ports import ArmTrajectory, Array, Side
from skills.motion.kinematics.posture import Posture
from skills.motion.moves.arc import ArcMotion, intended_duration, plan_arc
from skills.motion.moves.grasp import APPROACH_HEIGHT, Descent, GraspMotion, plan_grasp
from skills.motion.moves.helpful_shift import with_shift_suggestion
from skills.motion.moves.lift import plan_lift
from skills.motion.moves.posture_search import Choice, rank_postures
from skills.motion.moves.retreat import RETREAT_HEIGHT
from skills.motion.validation.collision import CollisionChecker
from skills.motion.validation.inputs import validate_paths, validate_state
from skills.vocabulary import FoldStep, GraspId, Outcome, Table, ToolPath

__all__ = ["FoldMotion", "plan_fold_motion", "plan_hands_motion"]

SLOWED = 1.3
"""A fold that the arms stretch by more than this is planned with another choice of postures too."""
SEARCHES = 2
"""Searches for postures: the finer plan may refuse all that the first one, coarse, has found."""


@dataclass(frozen=True, eq=False)
class FoldMotion:
    """A whole fold. postures: by arm; each says whose grasp of the step it takes."""

    postures: Mapping[Side, Posture]
    grasp: GraspMotion
    arc: ArcMotion

    @property
    def approach(self) -> ArmTrajectory:
        return self.grasp.approach

    @property
    def descend(self) -> Mapping[Side, Descent]:
        return self.grasp.descend

    @property
    def fold(self) -> ArmTrajectory:
        return self.arc.fold

    @property
    def retreat(self) -> ArmTrajectory:
        return self.arc.retreat

    @property
    def park(self) -> ArmTrajectory:
        return self.arc.park

    @property
    def tool_paths(self) -> Mapping[Side, ToolPath]:
        return self.arc.tool_paths

    @property
    def duration(self) -> float:
        """Of the parts with a fixed clock: all but the guarded descent [s]."""
        return sum(part.duration for part in (self.approach, self.fold, self.retreat, self.park))


@dataclass(frozen=True, eq=False)
class _Task:
    """What is to be planned, as `plan_hands_motion` is asked for it; the same for every choice of postures."""

    model: RobotModel
    checker: CollisionChecker
    table: Table
    paths: Mapping[GraspId, ToolPath]
    q_now: Array
    limits: JointLimits | None
    tool_speed: float | None
    approach_height: float
    lift: float
    rng: np.random.Generator | None


def plan_fold_motion(
    model: RobotModel,
    checker: CollisionChecker,
    table: Table,
    step: FoldStep,
    paths: Mapping[GraspId, ToolPath],
    q_now: Array,
    *,
    limits: JointLimits | None = None,
    tool_speed: float | None = None,
    approach_height: float = APPROACH_HEIGHT,
    lift: float = 0.0,
    avoid: Sequence[Mapping[Side, Posture]] = (),
    rng: np.random.Generator | None = None,
) -> Outcome[FoldMotion]:
    """Plan one fold from q_now (14,), at rest: paths are keyed as step.grasps, the rest as `plan_hands_motion`."""
    if set(paths) != set(step.grasps):
        raise ValueError(f"paths for {sorted(paths)} do not fit grasps for {sorted(step.grasps)}")
    return plan_hands_motion(
        model, checker, table, paths, q_now, limits=limits, tool_speed=tool_speed,
        approach_height=approach_height, lift=lift, avoid=avoid, rng=rng,
    )  # fmt: skip


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
    lift: float = 0.0,
    avoid: Sequence[Mapping[Side, Posture]] = (),
    rng: np.random.Generator | None = None,
) -> Outcome[FoldMotion]:
    """Hands to above the start of their paths, down, along them, up and home, from q_now (14,), at rest.

    Where the hands lean and which arm takes which path is chosen here. limits: the model's planning set when
    None. tool_speed: cap while the cloth is held [m/s].
    lift: by which the hands rise straight before the fold begins [m]; the paths then begin that much higher.
    avoid: `postures` of motions that were tried, for another choice. rng: for the search of detours.
    Failures: UNREACHABLE, IN_COLLISION (with what binds, and by how much to shift the garment if that helps),
    LIMIT_EXCEEDED, STALE_STATE (q_now is no state).
    """
    senseless = validate_state(model, q_now) or validate_paths(paths)
    if senseless:
        return Outcome(failure=senseless)
    task = _Task(model, checker, table, paths, q_now, limits, tool_speed, approach_height, lift, rng)
    tried: list[Mapping[Side, Posture]] = list(avoid)
    first_failure: Failure | None = None
    for _ in range(SEARCHES):
        ranked = rank_postures(
            model, checker, table, paths, q_now, above=approach_height, below=RETREAT_HEIGHT, avoid=tried
        )
        if ranked.failure:
            break
        choices = ranked.unwrap()
        best, failure = _best_of(task, choices)
        if best is not None:
            return Outcome(best, notes={**ranked.notes, "duration_s": round(best.duration, 3)})
        first_failure = first_failure or failure
        tried += [choice.postures for choice in choices]
    failure = first_failure or ranked.failure
    assert failure is not None
    if first_failure or avoid:  # a recovery that wants another choice: the garment lies where it lies
        return Outcome(failure=failure)
    helped = with_shift_suggestion(
        model, checker, table, paths, q_now, failure, above=approach_height, below=RETREAT_HEIGHT
    )
    return Outcome(failure=helped)


def _best_of(task: _Task, choices: Sequence[Choice]) -> tuple[FoldMotion | None, Failure | None]:
    """The first choice whose fold the arms do not slow much, else the shortest; and why the first one fails."""
    wish = intended_duration(task.paths, task.tool_speed)
    best: FoldMotion | None = None
    failure: Failure | None = None
    for choice in choices:
        made = _planned_as(task, choice)
        failure = failure or made.failure
        if made.value is not None and (best is None or made.value.duration < best.duration):
            best = made.value
        if best is not None and best.fold.duration < SLOWED * wish:
            break
    return best, failure


def _planned_as(task: _Task, choice: Choice) -> Outcome[FoldMotion]:
    """The whole motion with one choice of postures, finely."""
    grasp = plan_grasp(
        task.model, task.checker, task.table, task.paths, choice.postures, task.q_now, limits=task.limits,
        approach_height=task.approach_height, rng=task.rng, q_hint={side: q[0] for side, q in choice.q.items()},
    )  # fmt: skip
    if grasp.failure:
        return Outcome(failure=grasp.failure)
    q_fold = grasp.unwrap().q_grasp
    if task.lift > 0.0:
        up = plan_lift(task.model, task.checker, q_fold, tuple(choice.postures), task.lift, limits=task.limits)
        if up.failure:
            return Outcome(failure=up.failure)
        q_fold = up.unwrap().q[-1]
    arc = plan_arc(
        task.model, task.checker, task.table, task.paths, choice.postures, q_fold,
        limits=task.limits, tool_speed=task.tool_speed, rng=task.rng,
    )  # fmt: skip
    if arc.failure:
        return Outcome(failure=arc.failure)
    return Outcome(FoldMotion(choice.postures, grasp.unwrap(), arc.unwrap()))
