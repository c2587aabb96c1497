"""Plans straight motions of the hands: the lift, which tests a grasp or takes the hands away from the table, and
others from where they stand."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from foldcell.robots.errors import Failure, FailureKind
from foldcell.robots.model import JointLimits, RobotModel
from foldcell.robots.ports import ArmTrajectory, Array, Side
from foldcell.skills.motion.kinematics import ik
from foldcell.skills.motion.timing.timing import hold, time_path
from foldcell.skills.motion.validation.collision import CollisionChecker
from foldcell.skills.motion.validation.failures import too_near, validate_height, validate_state
from foldcell.skills.motion.validation.trajectory_check import contact_along
from foldcell.skills.vocabulary import Outcome, refuse, skill

SPEED = 0.25
"""Maximum speed of the tools [m/s]."""
STEP = 0.006
"""Distance between two joint samples [m]."""
UP = np.array([0.0, 0.0, 1.0])


def plan_lift(
    model: RobotModel,
    checker: CollisionChecker,
    q_now: Array,
    sides: tuple[Side, ...],
    height: float,
    *,
    limits: JointLimits | None = None,
) -> Outcome[ArmTrajectory]:
    """Plan a straight lift of the hands of `sides` by `height` [m] from q_now (joints,), at rest.

    The hands rise together; a hand that is not listed stays. limits: the model's planning limits when None.
    Failures: STALE_STATE (q_now is not a valid state), LIMIT_EXCEEDED (the height is negative, too large or not
    finite, or the limits are so low that the lift would take too long), UNREACHABLE, IN_COLLISION.
    """
    ways = dict.fromkeys(sides, UP)
    return plan_straight(model, checker, q_now, ways, height, limits=limits)


@skill
def plan_straight(
    model: RobotModel,
    checker: CollisionChecker,
    q_now: Array,
    ways: Mapping[Side, Array],
    length: float,
    *,
    speed: float = SPEED,
    limits: JointLimits | None = None,
    name: str = "lift",
) -> Outcome[ArmTrajectory]:
    """Plan a straight motion of each hand along its unit vector in `ways`, by `length` [m], from q_now (joints,),
    at rest. speed: of the tools [m/s]; name: of the motion, for messages. Otherwise as `plan_lift`."""
    refuse(validate_state(model, q_now) or validate_height(length))
    n = max(2, int(np.ceil(length / STEP)))
    gone = np.linspace(0.0, length, n + 1)
    q = np.tile(q_now, (n + 1, 1))
    for side, way in ways.items():
        joints = model.arm(side)
        T = ik.tool_pose(model.chains[side], q_now[joints])
        position = T[:3, 3] + gone[:, None] * way
        found = ik.follow_path(model, side, np.tile(T[:3, :3], (n + 1, 1, 1)), position, q_now[joints])
        if len(found) <= n:
            return Outcome(failure=_unreachable(side, length, float(gone[max(len(found) - 1, 0)])))
        q[:, joints] = found
    if np.abs(q - q_now).max() < 1e-9:
        return Outcome(hold(q_now))
    motion = time_path(q, limits or model.planning, lengths=gone[:, None], speed=speed)
    contact = contact_along(checker, motion, allow_fingertips=True)
    if contact is not None:
        return Outcome(failure=too_near(f"the {name}", str(contact)))
    return Outcome(motion)


def _unreachable(side: Side, length: float, reached: float) -> Failure:
    return Failure(
        FailureKind.UNREACHABLE,
        f"the {side} hand cannot be moved straight by {length} m from its present pose",
        "jog the arm by hand",
        {"side": str(side), "reached_m": reached},
    )
