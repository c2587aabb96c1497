"""The path that the arms came along, as a record of the set-points that were sent."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field

import numpy as np

from robots.ports import Array

__all__ = ["PathRecord"]

SPACING = 0.01
"""Smallest joint motion between two recorded set-points [rad]."""
LONGEST = 6000
"""Largest number of recorded set-points; older ones are dropped."""


@dataclass(eq=False)
class PathRecord:
    """The set-points sent since the arms last stood parked.

    Each of them belongs to a motion that was checked before it began, so the arms can be led back along them.
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
