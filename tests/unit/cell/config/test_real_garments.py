"""Real garments whose key points a person has placed: none that can be folded is refused."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from benchmarks.real_outlines import RealGarment, real_garments
from foldcell.cell.config.garments.garment_file import load_garment
from foldcell.cell.config.garments.new_garment import new_garment_text
from foldcell.skills.fold_plan.folding import layers_at
from foldcell.skills.fold_plan.plan import LEAST_FLAP, plan_folds
from foldcell.skills.garments.key_point_check import check_key_points
from foldcell.skills.garments.picture_measure import PictureMeasure

GARMENTS = {garment.name: garment for garment in real_garments()}
SCALE = 800.0
"""Pixels for the height of a garment in its picture."""


def pixels(garment: RealGarment) -> dict[str, np.ndarray]:
    return {name: np.array([640.0, 900.0]) + SCALE * place * (1, -1) for name, place in garment.keypoints.items()}


@pytest.mark.parametrize("name", GARMENTS)
def test_a_real_garment_with_key_points_by_hand_becomes_a_file_with_grasps_on_its_cloth(
    name: str, tmp_path: Path
) -> None:
    """The T-shirts are refused if proportions are an error, or if grasps keep the insets of the shipped one."""
    real = GARMENTS[name]
    like = load_garment(real.like)
    height = 0.92 if real.category == "pants" else 0.66
    points = pixels(real)
    first, last = like.keypoints[0], like.keypoints[-1]
    length = height * float(np.linalg.norm(points[first] - points[last])) / SCALE
    picture = PictureMeasure(1280, 960, (0, len(points) - 1), length)
    assert not any(finding.refused for finding in check_key_points(points, like, picture))

    template = picture.template(np.array([points[n] for n in like.keypoints]), like.template)
    text = new_garment_text(like.name, name, name, template, "by hand", "bare_table", lambda _: None)
    path = tmp_path / f"{name}.yaml"
    path.write_text(text, encoding="utf-8")
    own = load_garment(path)
    for step in plan_folds(own.flat_state(0.0, 0.0), own).unwrap():
        for grasp in step.grasps.values():
            assert layers_at(step.earlier, own.template, grasp.point) > 0
            assert step.line.signed_distance(grasp.point) >= LEAST_FLAP - 1e-9
