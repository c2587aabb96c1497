"""The height of creases: of one layer against the elastica, of more layers against finer meshes."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks.cloth.free_fold import Case, crease_height
from foldcell.calibration.free_fold import elastica_height
from foldcell.skills.fold_plan.crease_mesh import EDGE_SHARE


def test_the_elastica_of_a_free_fold_is_0_907_bending_lengths_high() -> None:
    assert elastica_height() == pytest.approx(0.907, abs=5e-4)


@pytest.mark.parametrize("bending_length", [0.009, 0.015, 0.025])
@pytest.mark.parametrize("turn", [0.07, 0.3, 0.7])
def test_a_free_fold_is_as_high_as_the_elastica_on_any_mesh(bending_length: float, turn: float) -> None:
    height, _ = crease_height(Case("", 1, 1, bending_length, 0.0006), EDGE_SHARE, turn)
    assert height / bending_length == pytest.approx(elastica_height(), rel=0.10)


def test_a_fold_of_two_layers_converges() -> None:
    case = Case("", 2, 1, 0.018, 0.001)
    heights = [np.mean([crease_height(case, share, turn)[0] for turn in (0.07, 0.7)]) for share in (0.5, 0.4)]
    assert abs(heights[0] - heights[1]) < 1e-3
