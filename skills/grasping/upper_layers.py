"""At which height a hand takes only the upper layers of a stack.

Open pads that stand in a stack take the layers above their tips. How high the layers lie is known only roughly:
cloth is lofty beside creases, and its thickness differs. What the closed pads hold shows whether they stood too
high or too low, so the next try is made between the heights that the tries before have shown to be wrong.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

STEP = 0.5
"""A hand that took one layer too many or too few next stands higher or lower by this [layers]. The wanted layers
are taken over a range of heights of one layer, so this cannot step over it."""
NARROWEST = 0.1
"""If the heights that were too low and too high differ by less, no height between them is tried [layers]."""


@dataclass(frozen=True)
class Grip:
    """What pads held that closed at a height above the table [m]."""

    height: float
    layers: int


def next_height(grips: Sequence[Grip], wanted: int, thickness: float) -> float | None:
    """Return the height above the table at which a hand closes next [m], after grips that did not take the wanted
    number of layers. None if these have shown that no height will do. thickness: of a layer [m]."""
    last = grips[-1]
    too_low = max((grip.height for grip in grips if grip.layers > wanted), default=None)
    too_high = min((grip.height for grip in grips if grip.layers < wanted), default=None)
    if too_low is not None and too_high is not None:
        return 0.5 * (too_low + too_high) if too_high - too_low > NARROWEST * thickness else None
    excess = last.layers - wanted
    return last.height + (excess - (1.0 - STEP) * (1 if excess > 0 else -1)) * thickness
