"""Plans the fold itself: the tools follow their paths from the actual grasps to the release; then the arms
park."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from foldcell.robots.model import JointLimits, RobotModel
from foldcell.robots.ports import ArmTrajectory, Array, Side, frozen
from foldcell.skills.motion.kinematics import ik
from foldcell.skills.motion.kinematics.posture import Posture, angles_of, blended, in_base
from foldcell.skills.motion.moves.retreat import Retreat, plan_retreat
from foldcell.skills.motion.timing.timing import time_law
from foldcell.skills.motion.validation.collision import CollisionChecker
from foldcell.skills.motion.validation.failures import (
    out_of_reach,
    validate_paths,
    validate_state,
    validate_tool_speed,
)
from foldcell.skills.motion.validation.trajectory_check import check_trajectory
from foldcell.skills.vocabulary import GraspId, Outcome, Table, ToolPath, refuse, skill

SAMPLE_TIME = 0.04
"""Time between the joint samples of an arc [s]; a cubic spline joins them."""


@dataclass(frozen=True, eq=False)
class ArcMotion(Retreat):
    """Motion after the grasp. fold: from the (lifted) grasps to the release, then the retreat. tool_paths: the
    tools' motion during `fold`, by arm, table frame."""

    fold: ArmTrajectory
    tool_paths: Mapping[Side, ToolPath]


@skill
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
    """Plan the fold from the configuration actually reached, q_grasp (joints,), then up and to the parked pose.

    The paths are shifted to begin at the tools' actual poses. The offsets of position and orientation fade out
    along the arc. The times are those of the paths, unless the arms' limits or tool_speed [m/s] require more time.
    Failures: STALE_STATE (q_grasp is not a valid state), LIMIT_EXCEEDED (tool_speed is not above zero, or the fold
    would take too long), UNREACHABLE, those of `check_trajectory` and `plan_retreat`.
    """
    limits = limits or model.planning
    refuse(validate_state(model, q_grasp) or validate_paths(paths) or validate_tool_speed(tool_speed))
    times = _sample_times(paths)
    q = np.tile(q_grasp, (len(times), 1))
    for side, posture in postures.items():
        path = paths[posture.path].at(times)
        rotation, position = _tool_poses_from_actual(model, table, side, posture, path, q_grasp)
        found = ik.follow_path(model, side, rotation, position, q_grasp[model.arm(side)])
        if len(found) < len(position):
            return Outcome(failure=out_of_reach(table, side, "the arc", position[len(found)]))
        q[:, model.arm(side)] = found
    fold = time_law(q, times * _speed_stretch(paths, times, tool_speed), limits)
    check_trajectory(model, checker, fold, q_grasp, limits, allow_fingertips=True).unwrap()
    retreat = plan_retreat(model, checker, fold.q[-1], tuple(postures), limits=limits, rng=rng).unwrap()
    executed = {side: _resulting_path(model, table, side, fold) for side in postures}
    return Outcome(ArcMotion(**vars(retreat), fold=fold, tool_paths=executed))


def intended_duration(paths: Mapping[GraspId, ToolPath], tool_speed: float | None) -> float:
    """Duration of the fold if the arms' limits do not slow it down [s]. tool_speed: maximum speed [m/s], or
    None."""
    times = _sample_times(paths)
    return float(times[-1]) * _speed_stretch(paths, times, tool_speed)


def _sample_times(paths: Mapping[GraspId, ToolPath]) -> Array:
    """Return evenly spaced sample times (n,) for all tools [s], from start to end of the first path."""
    t = next(iter(paths.values())).t
    return np.linspace(t[0], t[-1], max(8, int(np.ceil((t[-1] - t[0]) / SAMPLE_TIME)) + 1))


def _speed_stretch(paths: Mapping[GraspId, ToolPath], times: Array, tool_speed: float | None) -> float:
    """Factor (1 or more) by which time is stretched so that no tool is faster than `tool_speed` [m/s]."""
    if tool_speed is None:
        return 1.0
    longest_step = max(
        float(np.linalg.norm(np.diff(p.at(times).position, axis=0), axis=1).max()) for p in paths.values()
    )
    return max(1.0, longest_step / (float(times[1] - times[0]) * tool_speed))


def _tool_poses_from_actual(
    model: RobotModel, table: Table, side: Side, posture: Posture, path: ToolPath, q_grasp: Array
) -> tuple[Array, Array]:
    """Compute poses of the tool from its actual pose to the planned end: rotations (n, 3, 3), positions (n, 3),
    base frame."""
    T = ik.tool_pose(model.chains[side], q_grasp[model.arm(side)])
    actual_position = T[:3, 3] - np.array([0.0, 0.0, table.height])
    shifted = blended(path, actual_position)
    rotation = posture.rotation(shifted)
    fade = 1.0 - np.linspace(0.0, 1.0, len(shifted.t))
    fade = fade**2 * (3.0 - 2.0 * fade)
    error = pin.log3(rotation[0].T @ T[:3, :3])
    corrected = np.array([R @ pin.exp3(f * error) for R, f in zip(rotation, fade, strict=True)])
    return corrected, in_base(table, shifted.position)


def _resulting_path(model: RobotModel, table: Table, side: Side, fold: ArmTrajectory) -> ToolPath:
    """Compute the path of one tool during the planned trajectory, table frame."""
    T = np.array([ik.tool_pose(model.chains[side], q) for q in fold.q[:, model.arm(side)]])
    heading, pitch, roll = angles_of(T[:, :3, :3])
    position = T[:, :3, 3] - np.array([0.0, 0.0, table.height])
    return ToolPath(fold.t, frozen(position), frozen(heading), frozen(pitch), frozen(roll))
