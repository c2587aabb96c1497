"""The set-points sent to the arms: the last one, with the blend to the next motion, and the path of the arms."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field

import numpy as np

from foldcell.cell.control.ticks import TICK_S
from foldcell.robots.ports import Array

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


SPACING = 0.01
"""Smallest joint motion between two recorded set-points [rad]."""
LONGEST = 6000
"""Largest number of recorded set-points; older ones are dropped."""


@dataclass(eq=False)
class PathRecord:
    """The set-points sent since the arms last stood parked.

    Each set-point belongs to a motion that was checked before it began, so the arms can be led back along the
    set-points.
    """

    _points: deque[Array] = field(default_factory=lambda: deque(maxlen=LONGEST))

    def add(self, q: Array) -> None:
        """Record a set-point (joints,) [rad], if it differs enough from the last one."""
        if not self._points or np.abs(q - self._points[-1]).max() >= SPACING:
            self._points.append(np.array(q))

    def forget(self) -> None:
        """Forget the path, because the arms stand parked."""
        self._points.clear()

    def back(self) -> Array:
        """Return the path in reverse (n, joints), from the last set-point to the first; (0, 0) if there is
        none."""
        return np.array(self._points)[::-1] if self._points else np.zeros((0, 0))
