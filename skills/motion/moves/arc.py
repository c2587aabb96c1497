"""The fold itself: hands along their tool paths, from where they really hold to the release, then up and home."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from robots.model import JointLimits, RobotModel
from robots.ports import ArmTrajectory, Array, Side, arm_slice, frozen
from skills.motion.kinematics import ik
from skills.motion.kinematics.posture import Posture, angles_of, blended, in_base, resampled
from skills.motion.moves.retreat import plan_retreat
from skills.motion.timing.timing import time_law
from skills.motion.validation.collision import CollisionChecker
from skills.motion.validation.failures import out_of_reach
from skills.motion.validation.inputs import validate_paths, validate_state
from skills.motion.validation.trajectory_check import check_trajectory
from skills.vocabulary import GraspId, Outcome, Table, ToolPath

__all__ = ["ArcMotion", "intended_duration", "plan_arc"]

TICK = 0.04
"""Between joint samples of an arc [s]; a cubic spline joins them."""


@dataclass(frozen=True, eq=False)
class ArcMotion:
    """fold: from the (lifted) grasps to the release. tool_paths: what the tools then do, by arm, table frame."""

    fold: ArmTrajectory
    retreat: ArmTrajectory
    park: ArmTrajectory
    tool_paths: Mapping[Side, ToolPath]


def plan_arc(
    model: RobotModel,
    checker: CollisionChecker,
    table: Table,
    paths: Mapping[GraspId, ToolPath],
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
    Failures: STALE_STATE (q_grasp is no state), UNREACHABLE, those of `check_trajectory` and `plan_retreat`.
    """
    limits = limits or model.planning
    senseless = validate_state(model, q_grasp) or validate_paths(paths)
    if senseless:
        return Outcome(failure=senseless)
    clock = _clock(paths)
    q = np.tile(q_grasp, (len(clock), 1))
    for side, posture in postures.items():
        path = resampled(paths[posture.path], clock)
        rotation, position = _from_here(model, table, side, posture, path, q_grasp)
        solution = ik.follow_path(model, side, rotation, position, q_grasp[arm_slice(side)])
        if not solution.complete:
            return Outcome(failure=out_of_reach(table, side, "the arc", position[len(solution.q)]))
        q[:, arm_slice(side)] = solution.q
    fold = time_law(q, clock * _slowing(paths, clock, tool_speed), limits)
    checked = check_trajectory(model, checker, fold, q_grasp, limits, allow_fingertips=True)
    if checked.failure:
        return Outcome(failure=checked.failure)
    away = plan_retreat(model, checker, fold.q[-1], tuple(postures), limits=limits, rng=rng)
    if away.failure:
        return Outcome(failure=away.failure)
    executed = {side: _executed(model, table, side, fold) for side in postures}
    return Outcome(ArcMotion(fold, away.unwrap().retreat, away.unwrap().park, executed))


def intended_duration(paths: Mapping[GraspId, ToolPath], tool_speed: float | None) -> float:
    """How long the fold takes where the arms are not what slows it [s]; tool_speed: the cap [m/s], or none."""
    clock = _clock(paths)
    return float(clock[-1]) * _slowing(paths, clock, tool_speed)


def _clock(paths: Mapping[GraspId, ToolPath]) -> Array:
    """(n,) evenly spaced times of both tools' samples, over the first path's own duration."""
    t = next(iter(paths.values())).t
    return np.linspace(t[0], t[-1], max(8, int(np.ceil((t[-1] - t[0]) / TICK)) + 1))


def _slowing(paths: Mapping[GraspId, ToolPath], clock: Array, tool_speed: float | None) -> float:
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
    error = pin.log3(rotation[0].T @ T[:3, :3])
    turned = np.array([R @ pin.exp3(f * error) for R, f in zip(rotation, fade, strict=True)])
    return turned, in_base(table, begun.position)


def _executed(model: RobotModel, table: Table, side: Side, fold: ArmTrajectory) -> ToolPath:
    """What the tool really does, table frame."""
    T = np.array([ik.tool_pose(model.chains[side], q) for q in fold.q[:, arm_slice(side)]])
    heading, pitch, roll = angles_of(T[:, :3, :3])
    position = T[:, :3, 3] - np.array([0.0, 0.0, table.height])
    return ToolPath(fold.t, frozen(position), frozen(heading), frozen(pitch), frozen(roll))
