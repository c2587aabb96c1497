"""The set-point of one hand in a descent. It follows a goal that may jump, within limits of speed, acceleration
and jerk."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from cell.control.ticks import TICK_S
from robots.ports import Array, Side, arm_slice
from skills.motion.moves.grasp import Descent
from skills.motion.timing.jerk_limiter import JerkLimiter, step_towards

__all__ = ["Lowering", "lowered_joints"]

HAND_SPEED, HAND_ACCELERATION, HAND_JERK = 0.4, 0.6, 12.0
"""Limits of the set-point: speed [m/s], acceleration [m/s2], jerk [m/s3]."""


@dataclass(eq=False)
class Lowering:
    """Set-point of one descending hand. descent: the joints as a function of depth; top: height of depth 0 above
    the table [m]; hand: depth of the set-point [m], with its speed and acceleration."""

    descent: Descent
    top: float
    hand: JerkLimiter = field(default_factory=lambda: JerkLimiter(0.0))

    @property
    def height(self) -> float:
        """Height of the set-point above the table [m]."""
        return self.top - self.hand.position

    @property
    def rests(self) -> bool:
        return abs(self.hand.velocity) < 1e-4 and abs(self.hand.acceleration) < 1e-2

    @property
    def brakes_at(self) -> float:
        """Approximate depth at which the set-point would come to rest if it braked now [m]."""
        v = self.hand.velocity
        return self.hand.position + 0.5 * v * (abs(v) / HAND_ACCELERATION + HAND_ACCELERATION / HAND_JERK)

    def follow(self, depth: float, speed: float) -> None:
        """Advance the set-point by one tick towards `depth` [m], a goal that grows at `speed` [m/s]."""
        self.hand = step_towards(
            self.hand, depth, speed, TICK_S, speed=HAND_SPEED, acceleration=HAND_ACCELERATION, jerk=HAND_JERK
        )


def lowered_joints(q: Array, hands: Mapping[Side, Lowering]) -> Array:
    """Return q (joints,) [rad], in which the joints of each lowered arm are those at the depth of its
    set-point."""
    q = np.array(q)
    for side, hand in hands.items():
        q[arm_slice(side, len(q))] = hand.descent.at(hand.hand.position)
    return q
