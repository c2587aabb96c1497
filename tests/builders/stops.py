"""Protective stops for tests: the motion of an arm from the moment of the stop."""

from __future__ import annotations

import numpy as np

from foldcell.robots.model import JointLimits
from foldcell.robots.ports import ArmTrajectory
from foldcell.skills.motion.timing.timing import STOP_TIME, ClockWarp, warp_clock, warped


def stop_profile(
    trajectory: ArmTrajectory, t: float, limits: JointLimits, duration: float = STOP_TIME
) -> ArmTrajectory:
    """The motion from time t on the same path, whose clock slows to rest in `duration` [s], or later where
    `limits` require it."""
    start = float(np.clip(t, 0.0, trajectory.duration))
    return warped(trajectory, warp_clock(trajectory, ClockWarp(start, duration, 0.0), limits))
