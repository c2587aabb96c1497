"""The final check of a trajectory before it is sent: nothing moves unchecked.

The check does not depend on how the trajectory was made. It judges the samples that the arms receive, and the
Hermite interpolant between them.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from foldcell.robots.errors import Failure, FailureKind
from foldcell.robots.model import JointLimits, RobotModel
from foldcell.robots.ports import ArmTrajectory, Array
from foldcell.skills.motion.timing.timing import Peaks, peaks
from foldcell.skills.motion.validation.collision import CollisionChecker, Contact
from foldcell.skills.vocabulary import Outcome, refuse, skill

START_TOLERANCE = float(np.deg2rad(1.0))
LIMIT_TOLERANCE = 1e-6
"""Relative excess over a limit that is tolerated. It covers only rounding."""
REST = 1e-6
"""Maximum joint speed of an arm at rest [rad/s]."""
LONGEST_GAP = 0.0101
"""Maximum time between samples [s]."""
CHECK_STEP = 0.02
"""Joint motion between two poses that are checked for collision [rad]."""


@skill
def check_trajectory(
    model: RobotModel,
    checker: CollisionChecker,
    trajectory: ArmTrajectory,
    q_now: Array,
    limits: JointLimits,
    *,
    allow_fingertips: bool = False,
    start_tolerance: float = START_TOLERANCE,
) -> Outcome[Peaks]:
    """Check a trajectory before it is sent. The outcome's value is the largest share of each limit that it uses.

    q_now: (joints,) the arms' present joints [rad]. allow_fingertips: the fingers may touch the table (a grasp).
    start_tolerance: maximum distance of each joint from the trajectory's start [rad]. Failures: LIMIT_EXCEEDED,
    START_MISMATCH, IN_COLLISION.
    """
    refuse(
        _malformed(trajectory, len(model.joint_names))
        or _start_mismatch(model, trajectory, q_now, start_tolerance)
        or _position_limits(model, trajectory, limits)
    )
    share = peaks(trajectory, limits)
    if share.worst > 1.0 + LIMIT_TOLERANCE:
        return Outcome(failure=_too_fast(share))
    contact = contact_along(checker, trajectory, allow_fingertips=allow_fingertips)
    if contact is None:
        return Outcome(share)
    return Outcome(
        failure=Failure(
            FailureKind.IN_COLLISION,
            f"the trajectory is in collision: {contact}",
            "plan again; if it repeats, clear the arms' workspace",
            {"pair": str(contact), "at_s": float(trajectory.t[contact.index])},
        )
    )


def _malformed(trajectory: ArmTrajectory, joints: int) -> Failure | None:
    arrays = {"t": trajectory.t, "q": trajectory.q, "qd": trajectory.qd, "qdd": trajectory.qdd}
    for name, a in arrays.items():
        if not np.all(np.isfinite(a)):
            return _limit_exceeded(f"the trajectory's {name} has values that are not finite", {"field": name})
    shape = (len(trajectory.t), joints)
    if shape[0] < 2 or any(a.shape != shape for name, a in arrays.items() if name != "t"):
        return _limit_exceeded("the trajectory's arrays do not fit each other", {"samples": shape[0]})
    gap = np.diff(trajectory.t)
    if trajectory.t[0] != 0.0 or gap.min() <= 0.0:
        return _limit_exceeded(
            "the trajectory's times do not start at zero and rise", {"least_step_s": float(gap.min())}
        )
    if gap.max() > LONGEST_GAP:
        return _limit_exceeded("the trajectory's samples are too far apart", {"largest_step_s": float(gap.max())})
    moving = max(np.abs(trajectory.qd[0]).max(), np.abs(trajectory.qd[-1]).max())
    if moving > REST:
        return _limit_exceeded("the trajectory does not start and end at rest", {"speed_rad_s": float(moving)})
    return None


def _start_mismatch(
    model: RobotModel, trajectory: ArmTrajectory, q_now: Array, tolerance: float
) -> Failure | None:
    deviation = np.abs(trajectory.q[0] - q_now)
    joint = int(np.nan_to_num(deviation, nan=np.inf).argmax())
    if deviation[joint] <= tolerance:
        return None
    return Failure(
        FailureKind.START_MISMATCH,
        f"{model.joint_names[joint]} is {np.rad2deg(deviation[joint]):.2f} degrees from the trajectory's start",
        "plan again from where the arms are",
        {"joint": model.joint_names[joint], "off_rad": float(deviation[joint]), "allowed_rad": tolerance},
    )


def _position_limits(model: RobotModel, trajectory: ArmTrajectory, limits: JointLimits) -> Failure | None:
    # The first sample is the arms' present position, which may lie a little outside the planning range. The joints
    # may stay as far outside, but not move further out.
    over = np.maximum(limits.lower - trajectory.q, trajectory.q - limits.upper).max(axis=0)
    over -= np.maximum(0.0, np.maximum(limits.lower - trajectory.q[0], trajectory.q[0] - limits.upper))
    joint = int(over.argmax())
    if over[joint] <= 1e-9:
        return None
    return _limit_exceeded(
        f"{model.joint_names[joint]} would leave its range by {over[joint]:.4f} rad",
        {"joint": model.joint_names[joint], "over_rad": float(over[joint])},
    )


def _too_fast(share: Peaks) -> Failure:
    return _limit_exceeded(
        f"the trajectory takes {share.velocity:.2f} of the velocity, {share.acceleration:.2f} of the acceleration "
        f"and {share.jerk:.2f} of the jerk limits",
        {"velocity_share": share.velocity, "acceleration_share": share.acceleration, "jerk_share": share.jerk},
    )


def _limit_exceeded(what: str, values: Mapping[str, object]) -> Failure:
    return Failure(FailureKind.LIMIT_EXCEEDED, what, "report this: a bug in the planner", dict(values))


def contact_along(
    checker: CollisionChecker, trajectory: ArmTrajectory, *, allow_fingertips: bool = False
) -> Contact | None:
    """Return the first contact along a trajectory, with the index of its sample, or None.

    Samples about CHECK_STEP apart are checked. Planners use the same spacing, because two hands can pass through
    each other between samples that are further apart. Arms that a fault has brought too near to each other, or to
    something else, may move apart, because no other motion can free them.
    """
    indices = spaced_samples(trajectory.q, CHECK_STEP)
    contact = checker.first_collision(trajectory.q[indices], allow_fingertips=allow_fingertips)
    if contact is not None and contact.index == 0:
        path = trajectory.q[indices]
        contact = checker.first_contact_after_parting(path, allow_fingertips=allow_fingertips)
    return None if contact is None else replace(contact, index=int(indices[contact.index]))


def spaced_samples(q: Array, step: float) -> NDArray[np.intp]:
    """Return the indices of samples of q (n, joints) that are about `step` [rad] apart, including both ends."""
    travelled = np.concatenate([[0.0], np.cumsum(np.abs(np.diff(q, axis=0)).max(axis=1))])
    marks = np.arange(0.0, travelled[-1], step)
    keep = np.unique(np.concatenate([np.searchsorted(travelled, marks), [len(q) - 1]]))
    return np.minimum(keep, len(q) - 1)
