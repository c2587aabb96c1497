"""The height at which a hand takes only the upper layers of a stack."""

from __future__ import annotations

import numpy as np
import pytest

from foldcell.skills.grasping.upper_layers import Grip, next_height

LAYER = 0.002


def held(height: float, tops: list[float]) -> int:
    """Layers whose upper sides are at `tops` [m] are taken if the tips stand below these."""
    return sum(top > height for top in tops)


@pytest.mark.parametrize("wanted", [1, 2, 3])
@pytest.mark.parametrize("loft", [0.6, 1.0, 2.5])
@pytest.mark.parametrize("off", np.linspace(-1.5, 1.5, 7))
def test_a_few_tries_find_the_wanted_layers(wanted: int, loft: float, off: float) -> None:
    """Layers lie nearer to each other or further apart than expected, and the hand begins too high or too low."""
    tops = [LAYER * loft * k for k in range(1, 5)]
    middle = tops[4 - wanted] - 0.5 * LAYER * loft
    grips = [Grip(middle + off * LAYER, held(middle + off * LAYER, tops))]
    while grips[-1].layers != wanted:
        height = next_height(grips, wanted, LAYER)
        assert height is not None
        assert (height < grips[-1].height) == (grips[-1].layers < wanted), "lower for too few, higher for too many"
        grips.append(Grip(height, held(height, tops)))
    assert len(grips) <= 5


def test_layers_that_stick_together_end_the_search() -> None:
    together = [Grip(3.00e-3, 0), Grip(2.0e-3, 2), Grip(2.5e-3, 2), Grip(2.75e-3, 2), Grip(2.85e-3, 2)]
    assert next_height(together[:3], 1, LAYER) == pytest.approx(2.75e-3)
    assert next_height(together, 1, LAYER) is None


def test_cloth_that_has_moved_between_two_tries_ends_the_search() -> None:
    assert next_height([Grip(2.0e-3, 0), Grip(3.0e-3, 2)], 1, LAYER) is None
