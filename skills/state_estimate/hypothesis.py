"""The possible states of a garment after a fold that failed, each with its simulated shape."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum

from foldcell.skills.vocabulary import GraspId, PredictedShape


class FoldState(StrEnum):
    """State of the garment with respect to one fold."""

    BEFORE = "before"  # as before the fold; it may have been displaced
    HALF_WAY = "half_way"  # partly folded
    AFTER = "after"  # as predicted after the fold
    HEAP = "heap"  # none of these


@dataclass(frozen=True)
class Interruption:
    """A way in which a fold ends early. Shares are of the length of the hands' way from the grasps to the targets.

    lost: share at which a hand loses its cloth, for each hand that loses it. end: share at which the remaining
    hands open. laid_back: from `end`, the remaining hands first return to the grasps along the same way, and open
    there. missed_layer: the hands hold one layer less than planned. measured: the hands moved and lost their cloth
    as their sensors measured it; nothing else is assumed. turned: grasp at which a corner of the upper layers lies
    turned back, without more of the fold.
    """

    lost: Mapping[GraspId, float] = field(default_factory=dict)
    end: float = 1.0
    laid_back: bool = False
    missed_layer: bool = False
    measured: bool = False
    turned: GraspId | None = None

    @property
    def begins(self) -> float:
        """Share of the way at which the motion first differs from the planned fold."""
        unmoved = self.missed_layer or self.measured or self.turned is not None
        return 0.0 if unmoved else min([self.end, *self.lost.values()])


@dataclass(frozen=True, eq=False)
class Hypothesis:
    """A state with its shape at the place where the garment lay before the fold. interruption: how the fold ended;
    None if it was not begun (BEFORE) or was completed (AFTER)."""

    state: FoldState
    shape: PredictedShape
    interruption: Interruption | None = None
