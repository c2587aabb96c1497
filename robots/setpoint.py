"""What a driver makes of a set-point before it sends it: within the joints' ranges, no further than they go."""

from __future__ import annotations

import numpy as np

from robots.model import JointLimits
from robots.ports import Array, JointSetpoint, frozen

__all__ = ["JUMP_TIME", "clip_setpoint"]

JUMP_TIME = 0.04
"""A set-point may lie as far from the last one as the joints travel in this time at full speed [s]."""


def clip_setpoint(
    q: Array, qd: Array, before: Array, stands: Array, limits: JointLimits, stamp: float
) -> JointSetpoint:
    """q, qd: (14,) as asked for [rad], [rad/s]. before: (14,) the set-point that holds now. stands: (14,) where
    the joints were read: a set-point there, or on the way there, is no jump however far `before` is.

    A joint that stands outside of its range goes no further out; it may stay, and it comes back no faster than any
    joint goes. It is never sent to the range at once: that would be a jump, and nobody asked for it.
    """
    reach = limits.velocity * JUMP_TIME
    lower, upper = np.minimum(limits.lower, before), np.maximum(limits.upper, before)
    low, high = np.minimum(before, stands) - reach, np.maximum(before, stands) + reach
    sent = np.clip(np.clip(q, low, high), lower, upper)
    speed = np.clip(qd, -limits.velocity, limits.velocity)
    clipped = bool(np.any(sent != q) or np.any(speed != qd))
    return JointSetpoint(stamp, frozen(sent), frozen(speed), clipped)
