"""The figures of a score, their limits, and the two verdicts: `shape` concerns the figures seen from above, `flat`
the heights.

The height of unpressed cloth depends on its fabric. The heights are therefore compared with those of an ideal fold
of the same garment. A fold that is not pressed cannot be required to be flatter than that.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

from foldcell.skills.vocabulary import FoldLine


@dataclass(frozen=True)
class IdealHeights:
    """Heights of an ideal fold [m], measured as those of the garment, and figures that show whether this fold can
    serve as the ideal.

    flaw: the reason why it cannot serve as the ideal, in words; None if it can. crossings: number of places where
    layers pass through each other; strain: largest strain of an edge away from creases, as a fraction; motion:
    largest displacement of a vertex in the last 0.1 s [m]; iou: overlap with the target. A figure is NaN if it is
    not known because the fold cannot be made.
    """

    height: float
    crease_height: float
    flaw: str | None = None
    crossings: int = 0
    strain: float = 0.0
    motion: float = 0.0
    iou: float = 1.0

    def to_json(self) -> dict[str, Any]:
        """Plain values: `valid`, the `reason` if it is not, and the figures; null for an unknown figure."""
        figures = {"strain": self.strain, "motion_m": self.motion, "iou": self.iou}
        return {
            "valid": self.flaw is None,
            "reason": self.flaw,
            "crossings": self.crossings,
            **{name: _known(value) for name, value in figures.items()},
        }


@dataclass(frozen=True)
class ScoreLimits:
    """Limits of the figures for a pass. correspondence: as a fraction of the garment's diagonal; height: above the
    flat stack [m]; ideal_height, ideal_crease_height: above the heights of the ideal fold [m]; edges, keypoints,
    drift [m]; drift_angle [rad]."""

    iou: float = 0.90
    correspondence: float = 0.025
    edges: float = 0.030
    keypoints: float = 0.030
    height: float = 0.010
    ideal_height: float = 0.003
    ideal_crease_height: float = 0.010
    drift: float = 0.050
    drift_angle: float = math.radians(10.0)


DEFAULT_LIMITS = ScoreLimits()
HEIGHTS = ("height_m", "crease_height_m")
"""Names of the figures of the verdict `flat`."""


@dataclass(frozen=True)
class Figure:
    """One figure and its limit. at_least: the figure must be at least the limit; else at most the limit."""

    value: float
    limit: float
    at_least: bool = False

    @property
    def passed(self) -> bool:
        return self.value >= self.limit if self.at_least else self.value <= self.limit


@dataclass(frozen=True)
class Score:
    """The figures by name, and the verdicts. layers: number of layers in the stack of the flat target; stack: its
    height [m]. lines: the fold lines of the target. ideal: None if the heights are not judged."""

    figures: Mapping[str, Figure]
    layers: int
    stack: float = 0.0
    lines: tuple[FoldLine, ...] = ()
    ideal: IdealHeights | None = None

    def with_ideal(self, ideal: IdealHeights, limits: ScoreLimits = DEFAULT_LIMITS) -> Score:
        """Return the score with the heights judged against those of the ideal fold about the same lines."""
        limit = {
            "height_m": max(self.stack + limits.height, ideal.height + limits.ideal_height),
            "crease_height_m": ideal.crease_height + limits.ideal_crease_height,
        }
        judged = {name: replace(self.figures[name], limit=limit[name]) for name in HEIGHTS}
        return replace(self, figures={**self.figures, **judged}, ideal=ideal)

    @property
    def shape(self) -> bool:
        return all(f.passed for name, f in self.figures.items() if name not in HEIGHTS)

    @property
    def flat(self) -> bool | None:
        """Whether the heights pass; None if they are not judged or if the ideal fold has a flaw."""
        if self.ideal is None or self.ideal.flaw is not None:
            return None
        return all(self.figures[name].passed for name in HEIGHTS)

    @property
    def passed(self) -> bool:
        """Whether the shape passes, and the heights if they are judged. A run whose ideal fold has a flaw has not
        passed."""
        return self.shape and (self.ideal is None or self.flat is True)

    @property
    def failed(self) -> tuple[str, ...]:
        """Names of the figures that do not pass their limit."""
        return tuple(name for name, f in self._judged.items() if not f.passed)

    @property
    def _judged(self) -> dict[str, Figure]:
        return {n: f for n, f in self.figures.items() if self.flat is not None or n not in HEIGHTS}

    @property
    def iou(self) -> float:
        return self.figures["iou"].value

    def to_json(self) -> dict[str, Any]:
        """Plain values: the verdicts `passed`, `shape` and `flat`, each figure, `limits` with the limit of each
        judged figure, the heights of the ideal fold, its validity (`ideal`), and `layers`."""
        ideal = self.ideal
        return {
            "passed": self.passed,
            "shape": self.shape,
            "flat": self.flat,
            **{name: f.value for name, f in self.figures.items()},
            "ideal_height_m": None if ideal is None else _known(ideal.height),
            "ideal_crease_height_m": None if ideal is None else _known(ideal.crease_height),
            "ideal": None if ideal is None else ideal.to_json(),
            "limits": {name: f.limit for name, f in self._judged.items()},
            "layers": self.layers,
        }


def _known(figure: float) -> float | None:
    return figure if math.isfinite(figure) else None
