"""Swung limbs of templates: lengths stay, and the swing that was made is found again."""

from __future__ import annotations

import numpy as np
import pytest

from foldcell.cell.config.garments.garment_file import load_garment
from foldcell.skills.perception.classify import classify
from foldcell.skills.perception.limb_poses import best_poses, limb_tips, posed_template
from foldcell.skills.perception.outline import resample_closed
from tests.scenes import place


@pytest.mark.parametrize(
    ("name", "limbs"), [("jeans", 2), ("long_sleeve_shirt_small", 2), ("t_shirt", 0), ("shorts", 2), ("vest", 0)]
)
def test_long_limbs_are_found_by_their_tips(name: str, limbs: int) -> None:
    assert len(limb_tips(load_garment(name))) == limbs


@pytest.mark.parametrize("name", ["jeans", "long_sleeve_shirt_small"])
def test_a_swing_moves_the_tips_apart_and_keeps_their_width(name: str) -> None:
    garment = load_garment(name)
    before, after = np.asarray(garment.template), posed_template(garment, [0.3, 0.3])
    (a, b), (c, d) = limb_tips(garment)
    middle = lambda points, i, j: 0.5 * (points[i] + points[j])  # noqa: E731
    apart = [np.linalg.norm(middle(p, a, b) - middle(p, c, d)) for p in (before, after)]
    assert apart[1] > apart[0] + 0.02
    for i, j in limb_tips(garment):
        assert np.linalg.norm(after[i] - after[j]) == pytest.approx(np.linalg.norm(before[i] - before[j]))
    still = [k for k in range(len(before)) if k not in (a, b, c, d)]
    assert np.array_equal(after[still], before[still])


@pytest.mark.parametrize("swings", [(0.42, 0.42), (0.42, 0.0), (-0.2, 0.3)])
def test_observed_legs_match_better_with_the_swing_that_is_found(swings: tuple[float, float]) -> None:
    garment = load_garment("pants")
    seen = resample_closed(place(posed_template(garment, swings), 0.1, 0.2, 0.7), 0.004)
    (posed,) = best_poses(seen, [garment])
    assert classify(seen, [posed])[0].iou > max(0.95, classify(seen, [garment])[0].iou)
    assert posed.keypoints == garment.keypoints
