"""`foldcell.optimise` with one simulation, against the closed form of the paper's initial arc."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import foldcell
from foldcell.cell.config.garments.garment_file import load_garment
from foldcell.skills.fold_plan.plan import plan_folds
from foldcell.skills.trajectory.arcs.bezier import arc_controls
from foldcell.skills.vocabulary import GraspId


def test_optimise_returns_the_initial_arcs_of_one_fold() -> None:
    folds = foldcell.optimise("small_towel", step=1, method="initial")
    assert len(folds) == 1
    fold = folds[0]
    assert (fold.step, fold.method, fold.failure) == (1, "initial", None)
    assert (fold.simulations, fold.failed_simulations) == (1, 0)
    assert fold.dissimilarity_m == fold.dissimilarity_initial_m
    assert 0.0 < fold.dissimilarity_m < 0.05
    assert fold.duration_s is not None and fold.duration_s > 0.5
    towel = load_garment("small_towel")
    step = plan_folds(towel.flat_state(*towel.poses.middle), towel).unwrap()[0]
    assert fold.name == step.name
    assert set(fold.control_points) == {i.value for i in step.grasps}
    for hand, points in fold.control_points.items():
        assert points.ndim == 2 and points.shape[1] == 3
        assert np.allclose(points[0, :2], step.grasps[GraspId(hand)].point)
        assert np.allclose(points[-1], step.targets[GraspId(hand)])
        assert np.allclose(points, arc_controls(points[0], points[-1], 1 / 3))


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ({"garment": "sock"}, "sock"),
        ({"garment": "small_towel", "step": 9}, "no step 9"),
        ({"garment": "small_towel", "step": 0}, "no step 0"),
        ({"garment": "small_towel", "method": "best"}, "no method 'best'"),
        ({"garment": "small_towel", "budget": 0}, "budget of 0"),
        ({"garment": "small_towel", "settings": {"optimiser": {"threads": 0}}}, "threads"),
    ],
)
def test_optimise_refuses_wrong_arguments_by_name(arguments: dict[str, Any], words: str) -> None:
    with pytest.raises(foldcell.ConfigurationError, match=words):
        foldcell.optimise(**arguments)
