"""Both arms through free space, from rest to rest: straight on where that is free, else by way-points."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise

import numpy as np

from robots.model import JointLimits, RobotModel
from robots.ports import ArmTrajectory, Array
from skills.motion.moves.rrt_connect import blocked_end, no_way, rounded, ways
from skills.motion.timing.timing import free_motion, join, time_path
from skills.motion.validation.collision import CollisionChecker
from skills.motion.validation.inputs import validate_goal, validate_state
from skills.motion.validation.trajectory_check import contact_along
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

    Straight if that is free; else by way-points, with rounded corners if those are free too. What comes out is
    free by the very look that is taken before it is sent.
    limits: the model's planning set when None. rng: for the search of detours.
    Failures: STALE_STATE (q0 is no state), LIMIT_EXCEEDED (q1 is no goal), IN_COLLISION (an end is not free, or no
    way was found).
    """
    limits = limits or model.planning
    senseless = validate_state(model, q0) or validate_goal(model, q1, q0)
    if senseless:
        return Outcome(failure=senseless)
    blocked = blocked_end(checker, q0, q1)
    if blocked:
        return Outcome(failure=blocked)
    contact = None
    for kind, points in ways(model, checker, q0, q1, rng):
        for motion in _timed(points, limits):
            contact = contact_along(checker, motion)
            if contact is None:
                return Outcome(motion, notes={"way": kind})
    return Outcome(failure=no_way(contact))


def _timed(points: Array, limits: JointLimits) -> Iterator[ArmTrajectory]:
    """Trajectories through points (n, 14): round its corners where that is faster, and at rest in each."""
    stopping = join([free_motion(a, b, limits) for a, b in pairwise(points)])
    for share in CORNERS if len(points) > 2 else ():
        flowing = time_path(rounded(points, share), limits)
        if flowing.duration < stopping.duration:
            yield flowing
    yield stopping
