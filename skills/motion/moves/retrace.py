"""Plans a motion along a given path: backwards along a path that the arms have followed, after a failure, or
forwards along the rest of a path, to its end."""

from __future__ import annotations

import numpy as np

from foldcell.robots.errors import Failure, FailureKind
from foldcell.robots.model import JointLimits, RobotModel
from foldcell.robots.ports import ArmTrajectory, Array, Side
from foldcell.skills.motion.kinematics import ik
from foldcell.skills.motion.timing.timing import hold, time_path
from foldcell.skills.motion.validation.collision import CollisionChecker
from foldcell.skills.motion.validation.failures import too_near, validate_state, validate_tool_speed
from foldcell.skills.motion.validation.trajectory_check import contact_along, spaced_samples
from foldcell.skills.plane import lengths_along
from foldcell.skills.vocabulary import Outcome, refuse, skill

SPACING = 0.02
"""Joint motion between two samples of a path [rad]."""
FARTHEST = 0.35
"""If a joint is further than this from the path, the path says nothing about the arms' surroundings [rad]."""
FADE = 0.3
"""Joint motion along the path in which the arms' distance from it fades out [rad]."""
LOOP = 1.5 * SPACING
"""Two samples that are nearer to each other than this are joined, and the path between them is left out [rad]."""


@skill
def plan_along(
    model: RobotModel,
    checker: CollisionChecker,
    q_now: Array,
    path: Array,
    *,
    limits: JointLimits | None = None,
    tool_speed: float | None = None,
) -> Outcome[ArmTrajectory]:
    """Plan the motion from q_now (joints,), at rest, to the end of `path` (n, joints).

    The motion joins the path at the sample nearest to q_now, and its distance from the path fades out. If this
    motion is in collision, the arms first move straight to that sample. The fingers may touch the table.
    tool_speed: maximum speed of the tools [m/s]. Failures: STALE_STATE (q_now is not a valid state), UNREACHABLE
    (q_now is too far from the path), LIMIT_EXCEEDED, IN_COLLISION.
    """
    refuse(validate_state(model, q_now) or validate_tool_speed(tool_speed))
    k = nearest_on(path, q_now)
    offset = q_now - path[k]
    joint = int(np.abs(offset).argmax())
    if abs(offset[joint]) > FARTHEST:
        return Outcome(failure=_too_far(model, joint, float(offset[joint])))
    rest = path[k:][spaced_samples(path[k:], SPACING)]
    fading = _fading(rest, offset)
    if np.abs(fading - q_now).max() < 1e-6:
        return Outcome(hold(q_now))
    planned = _timed(model, checker, fading, limits, tool_speed)
    if planned.failure and planned.failure.kind is FailureKind.IN_COLLISION:
        joining = np.linspace(q_now, rest[0], int(np.ceil(np.abs(offset).max() / SPACING)) + 1)
        straight = _timed(model, checker, np.vstack([joining[:-1], rest]), limits, tool_speed)
        return straight if straight.ok else planned
    return planned


def _fading(rest: Array, offset: Array) -> Array:
    """Return the path `rest` (n, joints) with `offset` (joints,) added at its start, which fades out along it."""
    travelled = _travelled(rest)
    left = 1.0 - np.clip(travelled / min(FADE, max(float(travelled[-1]), SPACING)), 0.0, 1.0)
    q = rest + (left**2 * (3.0 - 2.0 * left))[:, None] * offset
    if np.abs(q[-1] - rest[-1]).max() > 1e-9:  # the rest of the path is shorter than the fade
        q = np.vstack([q, rest[-1:]])
    return np.asarray(q)


@skill
def _timed(
    model: RobotModel,
    checker: CollisionChecker,
    q: Array,
    limits: JointLimits | None,
    tool_speed: float | None,
) -> Outcome[ArmTrajectory]:
    """Return the motion along q (n, joints), if it is free."""
    lengths = np.stack([_tool_travelled(model, side, q) for side in Side], axis=1)
    motion = time_path(q, limits or model.planning, lengths=lengths, speed=tool_speed)
    contact = contact_along(checker, motion, allow_fingertips=True)
    if contact is not None:
        return Outcome(failure=too_near("the way along the earlier path", str(contact)))
    return Outcome(motion)


def nearest_on(path: Array, q: Array) -> int:
    """Return the index of the sample of path (n, joints) that is nearest to q (joints,)."""
    return int(np.linalg.norm(path - q, axis=1).argmin())


def share_done(path: Array, q: Array) -> float:
    """Return the share of path (n, joints) that lies before its sample nearest to q (joints,): 0 at its start, 1
    at its end."""
    travelled = _travelled(path)
    return float(travelled[nearest_on(path, q)] / travelled[-1]) if travelled[-1] > 0.0 else 0.0


def without_loops(path: Array) -> Array:
    """Return path (n, joints) without the parts that lead back to where they began, such as down and up again."""
    kept, k = [0], 0
    while k < len(path) - 1:
        near = np.flatnonzero(np.abs(path[k + 1 :] - path[k]).max(axis=1) < LOOP)
        k = k + 1 + (int(near[-1]) if len(near) else 0)
        kept.append(k)
    return np.asarray(path[kept])


def _travelled(path: Array) -> Array:
    """Return the joint motion (n,) from the path's start to each sample: the sum of the largest steps [rad]."""
    return np.concatenate([[0.0], np.cumsum(np.abs(np.diff(path, axis=0)).max(axis=1))])


def _tool_travelled(model: RobotModel, side: Side, q: Array) -> Array:
    """Return the distance (n,) that a tool has travelled at each sample of q (n, joints) [m]."""
    position = np.array([ik.tool_pose(model.chains[side], row)[:3, 3] for row in q[:, model.arm(side)]])
    return lengths_along(position)


def _too_far(model: RobotModel, joint: int, off: float) -> Failure:
    return Failure(
        FailureKind.UNREACHABLE,
        f"{model.joint_names[joint]} is {np.rad2deg(abs(off)):.0f} degrees from the path that the arms came along",
        "move the arms by hand",
        {"joint": model.joint_names[joint], "off_rad": off},
    )
