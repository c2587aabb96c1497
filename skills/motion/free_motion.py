"""Both arms through free space, from rest to rest: straight on where that is free, else by way-points."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from robots.model import JointLimits, RobotModel
from robots.ports import ArmTrajectory, Array
from skills.motion.check import thinned
from skills.motion.collision import CollisionChecker
from skills.motion.route import free_path, rounded
from skills.motion.sensible import senseless_goal, senseless_state
from skills.motion.timing import free_motion, join, time_path
from skills.vocabulary import Outcome

__all__ = ["plan_free_motion"]

CORNERS = (0.48, 0.3, 0.15)
"""Shares of each leg that a rounded corner may take, tried in turn."""


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
    limits: the model's planning set when None. rng: for the search of detours.
    Failures: STALE_STATE (q0 is no state), LIMIT_EXCEEDED (q1 is no goal), those of `route.free_path`.
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
