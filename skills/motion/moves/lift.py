"""Hands straight up as they are: with what they hold, to see whether it holds, or away from the table."""

from __future__ import annotations

import numpy as np

from robots.errors import Failure, FailureKind
from robots.model import JointLimits, RobotModel
from robots.ports import ArmTrajectory, Array, Side, arm_slice
from skills.motion.kinematics import ik
from skills.motion.timing.timing import hold, time_path
from skills.motion.validation.collision import CollisionChecker
from skills.motion.validation.failures import too_near
from skills.motion.validation.inputs import validate_height, validate_state
from skills.motion.validation.trajectory_check import contact_along
from skills.vocabulary import Outcome

__all__ = ["plan_lift"]

SPEED = 0.25
"""Of the tools on their straight way up, at most [m/s]."""
STEP = 0.006
"""Between joint samples of the way [m]."""


def plan_lift(
    model: RobotModel,
    checker: CollisionChecker,
    q_now: Array,
    sides: tuple[Side, ...],
    height: float,
    *,
    limits: JointLimits | None = None,
) -> Outcome[ArmTrajectory]:
    """Hands straight up by `height` [m] from q_now (14,), at rest; all in step, the other hand stays.

    limits: the model's planning set when None. Failures: STALE_STATE (q_now is no state), LIMIT_EXCEEDED (the
    height is none), UNREACHABLE, IN_COLLISION.
    """
    senseless = validate_state(model, q_now) or validate_height(height)
    if senseless:
        return Outcome(failure=senseless)
    n = max(2, int(np.ceil(height / STEP)))
    rise = np.linspace(0.0, height, n + 1)
    q = np.tile(q_now, (n + 1, 1))
    for side in sides:
        cut = arm_slice(side)
        T = ik.tool_pose(model.chains[side], q_now[cut])
        position = np.tile(T[:3, 3], (n + 1, 1))
        position[:, 2] += rise
        solution = ik.follow_path(model, side, np.tile(T[:3, :3], (n + 1, 1, 1)), position, q_now[cut])
        if not solution.complete:
            return Outcome(failure=_too_high(side, height, float(rise[max(len(solution.q) - 1, 0)])))
        q[:, cut] = solution.q
    if np.abs(q - q_now).max() < 1e-9:
        return Outcome(hold(q_now))
    lift = time_path(q, limits or model.planning, lengths=rise[:, None], speed=SPEED)
    contact = contact_along(checker, lift, allow_fingertips=True)
    if contact is not None:
        return Outcome(failure=too_near("the way up", str(contact)))
    return Outcome(lift)


def _too_high(side: Side, height: float, reached: float) -> Failure:
    return Failure(
        FailureKind.UNREACHABLE,
        f"the {side} hand cannot go straight up by {height} m from where it is",
        "jog the arm by hand",
        {"side": str(side), "reached_m": reached},
    )
