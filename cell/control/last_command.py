"""The last set-point sent to the arms, and the blend from it to the next motion."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cell.control.ticks import TICK_S
from robots.ports import Array

__all__ = ["LastCommand", "blend"]

FADE_S = 0.25
"""Duration of the blend from the last set-point to the next motion [s]."""
NEAR = float(np.deg2rad(1.5))
"""The last set-point is used only if the measured joints are within this distance of it [rad]."""


@dataclass(eq=False)
class LastCommand:
    """The last set-point sent to the arms. The next motion begins at it.

    The measured joints differ from it by the tracking error. A motion that began at the measured joints would
    therefore begin with a jump.
    """

    q: Array | None = None

    def offset(self, q: Array) -> Array:
        """Return the offset (joints,) from q to the last set-point [rad], or zeros if a joint differs by more than
        NEAR."""
        if self.q is None or not np.abs(self.q - q).max() <= NEAR:
            return np.zeros_like(q)
        return self.q - q


def blend(ticks: int, seconds: float = FADE_S) -> float:
    """Return the share of an offset that remains `ticks` ticks after the blend began. The share falls from 1 to 0
    in `seconds`, with minimum jerk."""
    u = min(1.0, ticks * TICK_S / seconds)
    return 1.0 - u**3 * (10.0 - 15.0 * u + 6.0 * u**2)
