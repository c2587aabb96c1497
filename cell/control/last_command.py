"""The set-point that the arms were last sent, and how the gap from there to what comes next is closed."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cell.control.ticks import TICK_S
from robots.ports import Array

__all__ = ["LastCommand", "blend"]

FADE_S = 0.25
"""In which the gap between the last set-point and the next motion's first is closed [s]."""
NEAR = float(np.deg2rad(1.5))
"""A set-point further from the reading than this is not where the arms stand [rad]."""


@dataclass(eq=False)
class LastCommand:
    """The set-point that the arms were last sent, so that what comes next begins there.

    The arms are never read back exactly where they were sent: a set-point that begins at the reading is a jump.
    """

    q: Array | None = None

    def offset(self, q: Array) -> Array:
        """(14,) from q to the last set-point; zero when that is too far off to be where the arms stand now."""
        if self.q is None or not np.abs(self.q - q).max() <= NEAR:
            return np.zeros_like(q)
        return self.q - q


def blend(ticks: int, seconds: float = FADE_S) -> float:
    """Share of an offset that is left after some ticks: 1 to 0 in `seconds`, with minimum jerk."""
    u = min(1.0, ticks * TICK_S / seconds)
    return 1.0 - u**3 * (10.0 - 15.0 * u + 6.0 * u**2)
