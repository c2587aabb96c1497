"""One hand's set-point on its straight way down: it follows a goal that may jump, and does not jump itself."""

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
"""Of the set-point [m/s], [m/s2], [m/s3]: what the controller asks for may jump."""


@dataclass(eq=False)
class Lowering:
    """way: the joints by depth. top: height of depth 0 over the table [m]. hand: depth of the set-point [m]."""

    way: Descent
    top: float
    hand: JerkLimiter = field(default_factory=lambda: JerkLimiter(0.0))

    @property
    def height(self) -> float:
        """Of the set-point over the table [m]."""
        return self.top - self.hand.position

    @property
    def rests(self) -> bool:
        return abs(self.hand.velocity) < 1e-4 and abs(self.hand.acceleration) < 1e-2

    @property
    def brakes_at(self) -> float:
        """About the depth at which the set-point comes to rest when it brakes from now on [m]."""
        v = self.hand.velocity
        return self.hand.position + 0.5 * v * (abs(v) / HAND_ACCELERATION + HAND_ACCELERATION / HAND_JERK)

    def follow(self, depth: float, speed: float) -> None:
        """A tick on, on the way to a depth [m] that grows at `speed` [m/s]."""
        self.hand = step_towards(
            self.hand, depth, speed, TICK_S, speed=HAND_SPEED, acceleration=HAND_ACCELERATION, jerk=HAND_JERK
        )


def lowered_joints(q: Array, hands: Mapping[Side, Lowering]) -> Array:
    """q (14,) with each of the hands where its set-point is on its way."""
    q = np.array(q)
    for side, hand in hands.items():
        q[arm_slice(side)] = hand.way.at(hand.hand.position)
    return q
