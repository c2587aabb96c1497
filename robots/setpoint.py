"""Clipping of a set-point by a driver: to the joints' ranges, and to the distance that the joints can travel."""

from __future__ import annotations

import numpy as np

from foldcell.robots.model import JointLimits
from foldcell.robots.ports import Array, JointSetpoint, frozen

JUMP_TIME = 0.04
"""Largest step between set-points, expressed as the time in which the joints travel it at full speed [s]."""


def clip_setpoint(
    q: Array, qd: Array, before: Array, stands: Array, limits: JointLimits, stamp: float
) -> JointSetpoint:
    """Clip a set-point. q, qd: (joints,) requested [rad], [rad/s]. before: (joints,) present set-point [rad].
    stands: (joints,) measured joints [rad]. A set-point between `before` and `stands` is never clipped as a jump,
    even if these two are far apart.

    A joint outside its range moves no further out. It may stay there, or return with at most its full speed. The
    driver does not move it into its range in one step, because that would be an unrequested jump.
    """
    reach = limits.velocity * JUMP_TIME
    lower, upper = np.minimum(limits.lower, before), np.maximum(limits.upper, before)
    low, high = np.minimum(before, stands) - reach, np.maximum(before, stands) + reach
    sent = np.clip(np.clip(q, low, high), lower, upper)
    speed = np.clip(qd, -limits.velocity, limits.velocity)
    clipped = bool(np.any(sent != q) or np.any(speed != qd))
    return JointSetpoint(stamp, frozen(sent), frozen(speed), clipped)
