"""Measures how long a garment lay untouched after each fold, as the hands hold and release it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

__all__ = ["DwellTimes"]


@dataclass
class DwellTimes:
    """Notes when hands hold the garment. A hold during which the garment was lifted counts as a fold."""

    _folds: list[tuple[float, float | None]] = field(default_factory=list)
    """Time of each fold's release, and of the next grasp [s]."""
    _held_at: float | None = None
    _lifted: bool = False

    def note(self, stamp: float, held: bool, lifted: bool) -> None:
        """Note at cell time `stamp` [s] whether a hand holds the garment, and whether it has lifted it."""
        if held:
            if self._held_at is None and self._folds and self._folds[-1][1] is None:
                self._folds[-1] = self._folds[-1][0], stamp
            self._held_at = stamp
            self._lifted = self._lifted or lifted
        elif self._held_at is not None:
            if self._lifted:
                self._folds.append((stamp, None))
            self._held_at, self._lifted = None, False

    def after_each(self, folds: int, end: float) -> Sequence[float] | None:
        """Return the time between the release of each fold and the next grasp, or `end` for the last [s]. None if
        the garment was not folded exactly `folds` times: then a fold was repeated, or not seen."""
        if len(self._folds) != folds:
            return None
        return [(end if grasp is None else grasp) - release for release, grasp in self._folds]
