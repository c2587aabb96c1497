"""Protective stops, for tests: the motion that an arm makes from the moment at which it is stopped."""

from __future__ import annotations

import numpy as np

from robots.model import JointLimits
from robots.ports import ArmTrajectory
from skills.motion.timing.timing import STOP_TIME, ClockWarp, warp_clock, warped

__all__ = ["stop_profile"]


def stop_profile(
    trajectory: ArmTrajectory, t: float, limits: JointLimits, duration: float = STOP_TIME
) -> ArmTrajectory:
    """From t on the same path, the clock run down to rest in `duration` [s], or longer where `limits` need it."""
    start = float(np.clip(t, 0.0, trajectory.duration))
    return warped(trajectory, warp_clock(trajectory, ClockWarp(start, duration, 0.0), limits))
