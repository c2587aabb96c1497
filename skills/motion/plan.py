"""One fold as arm motion: to above the grasps, down, along the arc, up, and to the parked pose.

`plan_fold_motion` plans all of it before anything moves. The guarded descent then ends where it meets
something, so `plan_arc` is called again from the configuration that was really reached, and `plan_grasp`
when a grasp is tried again elsewhere.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from robots.errors import Failure, FailureKind
from robots.model import JointLimits, RobotModel
from robots.ports import ArmTrajectory, Array, Side, arm_slice, frozen
from skills.motion import ik
from skills.motion.advice import with_helpful_shift
from skills.motion.check import check_trajectory, thinned
from skills.motion.collision import CollisionChecker
from skills.motion.posture import Posture, angles_of, blended, in_base, resampled
from skills.motion.route import free_path, rounded
from skills.motion.search import Choice, rank_postures
from skills.motion.sensible import senseless_goal, senseless_height, senseless_paths, senseless_state
from skills.motion.timing import free_motion, hold, join, time_law, time_path
from skills.vocabulary import FoldStep, Outcome, Table, ToolPath

__all__ = [
    "ArcMotion",
    "Descent",
    "FoldMotion",
    "GraspMotion",
    "Withdrawal",
    "plan_arc",
    "plan_fold_motion",
    "plan_free_motion",
    "plan_grasp",
    "plan_hands_motion",
    "plan_lift",
    "plan_withdrawal",
]

APPROACH_HEIGHT = 0.08
OVERTRAVEL = 0.015
"""How far below the planned grasp a descent may go on before it has to have met something [m]."""
RETREAT_HEIGHT = 0.10
RETREAT_SHARES = (1.0, 0.7, 0.5, 0.35)
"""Of a height that cannot be reached, tried in turn: 35 mm clear every stack."""
RETREAT_SPEED = 0.25
"""Of the tools on their straight way up [m/s]."""
DESCENT_STEP = 0.002
SLOWED = 1.3
"""A fold that the arms stretch by more than this is planned with another choice of postures too."""
SEARCHES = 2
"""Searches for postures: the finer plan may refuse all that the first one, coarse, has found."""
CORNERS = (0.48, 0.3, 0.15)
"""Shares of each leg that a rounded corner may take, tried in turn."""
RETREAT_STEP = 0.006
"""Between joint samples of straight ways [m]."""
ARC_TICK = 0.04
"""Between joint samples of an arc [s]; a cubic spline joins them."""


@dataclass(frozen=True, eq=False)
class Descent:
    """One arm's straight way down: joints q (m, 7) at depths (m,) below the point above the grasp [m].

    `grasp_depth` is where the planned grasp lies; beyond it the way goes on for the overtravel.
    """

    q: Array
    depth: Array
    grasp_depth: float

    def at(self, depth: float) -> Array:
        """(7,) joints at a depth, clamped to the ends."""
        return np.array([np.interp(depth, self.depth, self.q[:, k]) for k in range(7)])


@dataclass(frozen=True, eq=False)
class GraspMotion:
    """approach: both arms, ends above the grasps. descend: per arm used."""

    approach: ArmTrajectory
    descend: Mapping[Side, Descent]

    @property
    def q_above(self) -> Array:
        return self.approach.q[-1]

    @property
    def q_grasp(self) -> Array:
        """(14,) with every hand at its planned grasp."""
        q = np.array(self.q_above)
        for side, way in self.descend.items():
            q[arm_slice(side)] = way.at(way.grasp_depth)
        return frozen(q)


@dataclass(frozen=True, eq=False)
class Withdrawal:
    """retreat: straight up. park: on to the parked pose."""

    retreat: ArmTrajectory
    park: ArmTrajectory


@dataclass(frozen=True, eq=False)
class ArcMotion:
    """fold: from the (lifted) grasps to the release. tool_paths: what the tools then do, by arm, table frame."""

    fold: ArmTrajectory
    retreat: ArmTrajectory
    park: ArmTrajectory
    tool_paths: Mapping[Side, ToolPath]


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


def plan_fold_motion(
    model: RobotModel,
    checker: CollisionChecker,
    table: Table,
    step: FoldStep,
    paths: Mapping[Side, ToolPath],
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
    paths: Mapping[Side, ToolPath],
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

    paths: by the side whose they are; where the hands lean and which arm takes which path is
    chosen here. limits: the model's planning set when None. tool_speed: cap while the cloth is held [m/s].
    lift: by which the hands rise straight before the fold begins [m]; the paths then begin that much higher.
    avoid: `postures` of motions that were tried, for another choice. rng: for the search of detours.
    Failures: UNREACHABLE, IN_COLLISION (with what binds, and by how much to shift the garment if that helps),
    LIMIT_EXCEEDED, STALE_STATE (q_now is no state).
    """
    senseless = senseless_state(model, q_now) or senseless_paths(paths)
    if senseless:
        return Outcome(failure=senseless)
    tried: list[Mapping[Side, Posture]] = list(avoid)
    first_failure: Failure | None = None
    for _ in range(SEARCHES):
        ranked = rank_postures(
            model, checker, table, paths, q_now, above=approach_height, below=RETREAT_HEIGHT, avoid=tried
        )
        if ranked.failure:
            break
        choices = ranked.unwrap()
        best, failure = _best_of(
            model, checker, table, paths, choices, q_now, limits, tool_speed, approach_height, lift, rng
        )
        if best is not None:
            return Outcome(best, notes={**ranked.notes, "duration_s": round(best.duration, 3)})
        first_failure = first_failure or failure
        tried += [choice.postures for choice in choices]
    failure = first_failure or ranked.failure
    assert failure is not None
    if first_failure or avoid:  # a recovery that wants another choice: the garment lies where it lies
        return Outcome(failure=failure)
    helped = with_helpful_shift(
        model, checker, table, paths, q_now, failure, above=approach_height, below=RETREAT_HEIGHT
    )
    return Outcome(failure=helped)


def _best_of(
    model: RobotModel,
    checker: CollisionChecker,
    table: Table,
    paths: Mapping[Side, ToolPath],
    choices: Sequence[Choice],
    q_now: Array,
    limits: JointLimits | None,
    tool_speed: float | None,
    approach_height: float,
    lift: float,
    rng: np.random.Generator | None,
) -> tuple[FoldMotion | None, Failure | None]:
    """The first choice whose fold the arms do not slow much, else the shortest; and why the first one fails."""
    wish = float(_clock(paths)[-1])
    best: FoldMotion | None = None
    failure: Failure | None = None
    for choice in choices:
        made = _planned_as(
            model, checker, table, paths, choice, q_now, limits, tool_speed, approach_height, lift, rng
        )
        failure = failure or made.failure
        if made.value is not None and (best is None or made.value.duration < best.duration):
            best = made.value
        if best is not None and best.fold.duration < SLOWED * wish * _slowing(paths, _clock(paths), tool_speed):
            break
    return best, failure


def _planned_as(
    model: RobotModel,
    checker: CollisionChecker,
    table: Table,
    paths: Mapping[Side, ToolPath],
    choice: Choice,
    q_now: Array,
    limits: JointLimits | None,
    tool_speed: float | None,
    approach_height: float,
    lift: float,
    rng: np.random.Generator | None,
) -> Outcome[FoldMotion]:
    """The whole motion with one choice of postures, finely."""
    grasp = plan_grasp(
        model, checker, table, paths, choice.postures, q_now, limits=limits, approach_height=approach_height,
        rng=rng, q_hint={side: q[0] for side, q in choice.q.items()},
    )  # fmt: skip
    if grasp.failure:
        return Outcome(failure=grasp.failure)
    q_fold = grasp.unwrap().q_grasp
    if lift > 0.0:
        up = plan_lift(model, checker, q_fold, tuple(choice.postures), lift, limits=limits)
        if up.failure:
            return Outcome(failure=up.failure)
        q_fold = up.unwrap().q[-1]
    arc = plan_arc(
        model, checker, table, paths, choice.postures, q_fold, limits=limits, tool_speed=tool_speed, rng=rng
    )
    if arc.failure:
        return Outcome(failure=arc.failure)
    return Outcome(FoldMotion(choice.postures, grasp.unwrap(), arc.unwrap()))


def plan_grasp(
    model: RobotModel,
    checker: CollisionChecker,
    table: Table,
    paths: Mapping[Side, ToolPath],
    postures: Mapping[Side, Posture],
    q_now: Array,
    *,
    limits: JointLimits | None = None,
    approach_height: float = APPROACH_HEIGHT,
    overtravel: float = OVERTRAVEL,
    q_hint: Mapping[Side, Array] | None = None,
    rng: np.random.Generator | None = None,
) -> Outcome[GraspMotion]:
    """To `approach_height` [m] above the first point of each path, then straight down, per arm.

    postures: by arm. paths: as for `plan_fold_motion`; shift them to try a grasp elsewhere. q_hint: joints
    (7,) near the point above, by arm (else the arm's present ones are the hint).
    """
    limits = limits or model.planning
    senseless = senseless_state(model, q_now) or senseless_paths(paths)
    if senseless:
        return Outcome(failure=senseless)
    q_above = np.array(q_now)
    descend: dict[Side, Descent] = {}
    for side, posture in postures.items():
        hint = q_hint[side] if q_hint else q_now[arm_slice(side)]
        way = _descent(model, table, side, posture, paths[posture.path], hint, approach_height, overtravel)
        if way.failure:
            return Outcome(failure=way.failure)
        descend[side] = way.unwrap()
        q_above[arm_slice(side)] = descend[side].q[0]
    contact = checker.first_collision(_in_step(q_above, descend), allow_fingertips=True)
    if contact is not None:
        return Outcome(failure=_touching("the way down", str(contact)))
    approach = plan_free_motion(model, checker, q_now, q_above, limits=limits, rng=rng)
    if approach.failure:
        return Outcome(failure=approach.failure)
    return Outcome(GraspMotion(approach.unwrap(), descend))


def plan_arc(
    model: RobotModel,
    checker: CollisionChecker,
    table: Table,
    paths: Mapping[Side, ToolPath],
    postures: Mapping[Side, Posture],
    q_grasp: Array,
    *,
    limits: JointLimits | None = None,
    tool_speed: float | None = None,
    rng: np.random.Generator | None = None,
) -> Outcome[ArcMotion]:
    """The fold, from the configuration q_grasp (14,) that was really reached, then up and to the parked pose.

    The paths begin at the tools' real positions; the offset fades out along the arc, the orientation error of
    the start likewise. Timing is the paths' own unless the arms' limits or tool_speed [m/s] are slower.
    """
    limits = limits or model.planning
    senseless = senseless_state(model, q_grasp) or senseless_paths(paths)
    if senseless:
        return Outcome(failure=senseless)
    clock = _clock(paths)
    q = np.tile(q_grasp, (len(clock), 1))
    for side, posture in postures.items():
        path = resampled(paths[posture.path], clock)
        rotation, position = _from_here(model, table, side, posture, path, q_grasp)
        solution = ik.follow_path(model, side, rotation, position, q_grasp[arm_slice(side)])
        if not solution.complete:
            return Outcome(failure=_ends_at(table, side, "the arc", position[len(solution.q)]))
        q[:, arm_slice(side)] = solution.q
    fold = time_law(q, clock * _slowing(paths, clock, tool_speed), limits)
    checked = check_trajectory(model, checker, fold, q_grasp, limits, allow_fingertips=True)
    if checked.failure:
        return Outcome(failure=checked.failure)
    away = plan_withdrawal(model, checker, fold.q[-1], tuple(postures), limits=limits, rng=rng)
    if away.failure:
        return Outcome(failure=away.failure)
    executed = {side: _executed(model, table, side, fold) for side in postures}
    return Outcome(ArcMotion(fold, away.unwrap().retreat, away.unwrap().park, executed))


def plan_withdrawal(
    model: RobotModel,
    checker: CollisionChecker,
    q_now: Array,
    sides: tuple[Side, ...] = tuple(Side),
    *,
    height: float = RETREAT_HEIGHT,
    limits: JointLimits | None = None,
    rng: np.random.Generator | None = None,
) -> Outcome[Withdrawal]:
    """Hands straight up by `height` [m] as they are, then both arms to the parked pose. Also the way to safety:
    where the arms cannot go so high, they go as high as they can, but no less than clears a stack."""
    limits = limits or model.planning
    why: Failure | None = None
    for share in RETREAT_SHARES:
        retreat = _straight_up(model, checker, q_now, sides, share * height, limits)
        if retreat.ok:
            way = plan_free_motion(model, checker, retreat.unwrap().q[-1], model.q_park, limits=limits, rng=rng)
            if way.ok:
                return Outcome(Withdrawal(retreat.unwrap(), way.unwrap()))
        why = why or retreat.failure or way.failure
    return Outcome(failure=why)


def plan_lift(
    model: RobotModel,
    checker: CollisionChecker,
    q_now: Array,
    sides: tuple[Side, ...],
    height: float,
    *,
    limits: JointLimits | None = None,
) -> Outcome[ArmTrajectory]:
    """Hands straight up together by `height` [m]: to see whether a grasp holds."""
    return _straight_up(model, checker, q_now, sides, height, limits or model.planning)


def plan_free_motion(
    model: RobotModel,
    checker: CollisionChecker,
    q0: Array,
    q1: Array,
    *,
    limits: JointLimits | None = None,
    rng: np.random.Generator | None = None,
) -> Outcome[ArmTrajectory]:
    """From rest at q0 (14,) to rest at q1 (14,), free of collision.

    Straight if that is free; else by way-points, with rounded corners if those are free too.
    """
    limits = limits or model.planning
    senseless = senseless_state(model, q0) or senseless_goal(model, q1, q0)
    if senseless:
        return Outcome(failure=senseless)
    way = free_path(model, checker, q0, q1, rng)
    if way.failure:
        return Outcome(failure=way.failure)
    points = way.unwrap()
    stopping = join([free_motion(a, b, limits) for a, b in pairwise(points)])
    for share in CORNERS if len(points) > 2 else ():
        flowing = time_path(rounded(points, share), limits)
        if flowing.duration < stopping.duration and checker.first_collision(thinned(flowing.q, 0.03)) is None:
            return Outcome(flowing, notes=dict(way.notes))
    return Outcome(stopping, notes=dict(way.notes))


def _descent(
    model: RobotModel,
    table: Table,
    side: Side,
    posture: Posture,
    path: ToolPath,
    hint: Array,
    above: float,
    overtravel: float,
) -> Outcome[Descent]:
    to_grasp = np.linspace(0.0, above, int(np.ceil(above / DESCENT_STEP)) + 1)
    beyond = np.linspace(0.0, overtravel, int(np.ceil(overtravel / DESCENT_STEP)) + 1)
    depth = np.concatenate([to_grasp, above + beyond[1:]])
    n = len(depth) - 1
    position = np.tile(in_base(table, path.position[:1])[0], (n + 1, 1))
    position[:, 2] += above - depth
    rotation = np.tile(posture.rotation(path)[:1], (n + 1, 1, 1))
    start = np.eye(4)
    start[:3, :3], start[:3, 3] = rotation[0], position[0]
    q0 = ik.solve_pose(model, side, start, hint, gain=0.0)
    if q0 is None:
        return Outcome(failure=_ends_at(table, side, "the point above the grasp", position[0]))
    solution = ik.follow_path(model, side, rotation, position, q0)
    reached = len(solution.q)
    if reached < len(to_grasp):
        return Outcome(failure=_ends_at(table, side, "the way down", position[reached]))
    return Outcome(Descent(frozen(solution.q), frozen(depth[:reached]), above))


def _in_step(q_above: Array, descend: Mapping[Side, Descent], samples: int = 12) -> Array:
    """(samples, 14) with all hands going down together, to their planned grasps."""
    q = np.tile(q_above, (samples, 1))
    for i, share in enumerate(np.linspace(0.0, 1.0, samples)):
        for side, way in descend.items():
            q[i, arm_slice(side)] = way.at(share * way.grasp_depth)
    return q


def _clock(paths: Mapping[Side, ToolPath]) -> Array:
    """(n,) evenly spaced times of both tools' samples, over the first path's own duration."""
    t = next(iter(paths.values())).t
    return np.linspace(t[0], t[-1], max(8, int(np.ceil((t[-1] - t[0]) / ARC_TICK)) + 1))


def _slowing(paths: Mapping[Side, ToolPath], clock: Array, tool_speed: float | None) -> float:
    """By how much the paths' time has to be stretched to keep both tools to the speed cap [m/s]."""
    if tool_speed is None:
        return 1.0
    fastest = max(
        float(np.linalg.norm(np.diff(resampled(p, clock).position, axis=0), axis=1).max()) for p in paths.values()
    )
    return max(1.0, fastest / (float(clock[1] - clock[0]) * tool_speed))


def _from_here(
    model: RobotModel, table: Table, side: Side, posture: Posture, path: ToolPath, q_grasp: Array
) -> tuple[Array, Array]:
    """Tool poses in the base frame that begin at the real one and end as planned."""
    T = ik.tool_pose(model.chains[side], q_grasp[arm_slice(side)])
    here = T[:3, 3] - np.array([0.0, 0.0, table.height])
    begun = blended(path, here)
    rotation = posture.rotation(begun)
    fade = 1.0 - np.linspace(0.0, 1.0, len(begun.t))
    fade = fade**2 * (3.0 - 2.0 * fade)
    error = _rotation_vector(rotation[0].T @ T[:3, :3])
    turned = np.array([R @ _rotation(f * error) for R, f in zip(rotation, fade, strict=True)])
    return turned, in_base(table, begun.position)


def _rotation_vector(R: Array) -> Array:
    w = 0.5 * np.array([R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]])
    sine = float(np.linalg.norm(w))
    angle = np.arctan2(sine, 0.5 * (np.trace(R) - 1.0))
    return w * (angle / sine if sine > 1e-12 else 1.0)


def _rotation(w: Array) -> Array:
    """Rodrigues' formula."""
    angle = float(np.linalg.norm(w))
    if angle < 1e-12:
        return np.eye(3)
    x, y, z = w / angle
    K = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    R: Array = np.eye(3) + np.sin(angle) * K + (1.0 - np.cos(angle)) * (K @ K)
    return R


def _straight_up(
    model: RobotModel,
    checker: CollisionChecker,
    q_now: Array,
    sides: tuple[Side, ...],
    height: float,
    limits: JointLimits,
) -> Outcome[ArmTrajectory]:
    """Each hand up as far as `height` [m]; all in step, at most RETREAT_SPEED."""
    senseless = senseless_state(model, q_now) or senseless_height(height)
    if senseless:
        return Outcome(failure=senseless)
    n = max(2, int(np.ceil(height / RETREAT_STEP)))
    rise = np.linspace(0.0, height, n + 1)
    q = np.tile(q_now, (n + 1, 1))
    for side in sides:
        cut = arm_slice(side)
        T = ik.tool_pose(model.chains[side], q_now[cut])
        position = np.tile(T[:3, 3], (n + 1, 1))
        position[:, 2] += rise
        solution = ik.follow_path(model, side, np.tile(T[:3, :3], (n + 1, 1, 1)), position, q_now[cut])
        if not solution.complete:
            return Outcome(
                failure=Failure(
                    FailureKind.UNREACHABLE,
                    f"the {side} hand cannot go straight up by {height} m from where it is",
                    "jog the arm by hand",
                    {"side": str(side), "reached_m": float(rise[max(len(solution.q) - 1, 0)])},
                )
            )
        q[:, cut] = solution.q
    lengths = rise[:, None]
    if np.abs(q - q_now).max() < 1e-9:
        return Outcome(hold(q_now))
    contact = checker.first_collision(thinned(q, 0.03), allow_fingertips=True)
    if contact is not None:
        return Outcome(failure=_touching("the way up", str(contact)))
    return Outcome(time_path(q, limits, lengths=lengths, speed=RETREAT_SPEED))


def _executed(model: RobotModel, table: Table, side: Side, fold: ArmTrajectory) -> ToolPath:
    T = np.array([ik.tool_pose(model.chains[side], q) for q in fold.q[:, arm_slice(side)]])
    heading, pitch, roll = angles_of(T[:, :3, :3])
    position = T[:, :3, 3] - np.array([0.0, 0.0, table.height])
    return ToolPath(fold.t, frozen(position), frozen(heading), frozen(pitch), frozen(roll))


def _ends_at(table: Table, side: Side, what: str, point: Array) -> Failure:
    where = [round(float(x), 3) for x in point - np.array([0.0, 0.0, table.height])]
    return Failure(
        FailureKind.UNREACHABLE,
        f"the {side} arm does not reach {what} at {where} (table frame, m)",
        "lay the garment nearer to the middle of the table",
        {"side": str(side), "where_m": where},
    )


def _touching(what: str, pair: str) -> Failure:
    return Failure(
        FailureKind.IN_COLLISION,
        f"{what} comes too near: {pair}",
        "take hold further apart, or with another tilt",
        {"pair": pair},
    )
