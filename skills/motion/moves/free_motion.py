"""Plans motions of both arms through free space, from rest to rest: straight if possible, else through
way-points."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise

import numpy as np

from foldcell.robots.model import JointLimits, RobotModel
from foldcell.robots.ports import ArmTrajectory, Array
from foldcell.skills.motion.moves.rrt_connect import blend_corners, candidate_paths, check_endpoints, no_path_found
from foldcell.skills.motion.timing.timing import free_motion, join, time_path
from foldcell.skills.motion.validation.collision import CollisionChecker
from foldcell.skills.motion.validation.failures import validate_goal, validate_state
from foldcell.skills.motion.validation.trajectory_check import contact_along
from foldcell.skills.vocabulary import Outcome, refuse, skill

__all__ = ["plan_free_motion"]

CORNERS = (0.48, 0.3, 0.15)
"""The blend at a way-point replaces this share of each adjoining segment. The values are tried in turn."""


@skill
def plan_free_motion(
    model: RobotModel,
    checker: CollisionChecker,
    q0: Array,
    q1: Array,
    *,
    limits: JointLimits | None = None,
    rng: np.random.Generator | None = None,
) -> Outcome[ArmTrajectory]:
    """Plan a collision-free motion from rest at q0 (joints,) to rest at q1 (joints,).

    The motion is straight in joint space if that is free. Otherwise it passes through way-points, with blended
    corners if these are free too. The result has passed the same collision check that is made again before it is
    sent. limits: the model's planning limits when None. rng: for RRT-Connect. Failures: STALE_STATE (q0 is not a
    valid state), LIMIT_EXCEEDED (q1 is not a valid goal, or the limits are so low that the motion would take too
    long), IN_COLLISION (q0 or q1 is in collision, or no path was found).
    """
    limits = limits or model.planning
    refuse(validate_state(model, q0) or validate_goal(model, q1, q0) or check_endpoints(checker, q0, q1))
    contact = None
    for method, points in candidate_paths(model, checker, q0, q1, rng):
        for motion in _time_parameterized(points, limits):
            contact = contact_along(checker, motion)
            if contact is None:
                return Outcome(motion, notes={"way": method})
    return Outcome(failure=no_path_found(contact))


def _time_parameterized(points: Array, limits: JointLimits) -> Iterator[ArmTrajectory]:
    """Yield trajectories through points (n, joints): first those with blended corners that are faster than
    stopping, then the one that stops at each point."""
    stopping = join([free_motion(a, b, limits) for a, b in pairwise(points)])
    for share in CORNERS if len(points) > 2 else ():
        blended = time_path(blend_corners(points, share), limits)
        if blended.duration < stopping.duration:
            yield blended
    yield stopping
