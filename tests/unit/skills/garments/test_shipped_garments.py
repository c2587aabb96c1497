"""The shipped garment files agree with the paper's table and fit the cell."""

from __future__ import annotations

import itertools
import math
from importlib import resources

import numpy as np
import pytest
import shapely
import yaml

from foldcell.cell.config.garments.garment_file import list_garments, load_garment
from foldcell.skills.fold_plan.plan import plan_folds
from foldcell.skills.vocabulary import REFERENCE_DROP

GARMENTS = {name: load_garment(name) for name in list_garments()}

PAPER = {  # stretch %, friction angle in degrees, folds
    "long_sleeve_shirt_large": (2.9, 24.3, 3),
    "long_sleeve_shirt_small": (2.9, 24.7, 3),
    "jeans": (2.9, 19.1, 2),
    "pants": (1.7, 21.9, 2),
    "large_towel": (2.2, 18.7, 2),
    "medium_towel": (3.1, 22.3, 2),
    "small_towel": (1.1, 24.3, 2),
}

# The part of the table plane that the head camera sees. Nearer rows are narrower.
VIEW = shapely.Polygon([(0.17, -0.52), (1.10, -0.72), (1.10, 0.72), (0.17, 0.52)])


@pytest.mark.parametrize("name", PAPER)
def test_the_measured_figures_of_shipped_garments_agree_with_the_paper(name: str) -> None:
    stretch, angle, folds = PAPER[name]
    garment = GARMENTS[name]
    stated = yaml.safe_load((resources.files("foldcell.skills.garments") / f"{name}.yaml").read_text())["material"]
    assert stated["stretch_fraction"] == pytest.approx(stretch / 100)
    # elongation is proportional to the hanging length, and the solver's value refers to one reference length
    assert garment.material.stretch_fraction == pytest.approx(stretch / 100 * REFERENCE_DROP / stated["hang_drop"])
    assert garment.material.friction_static == pytest.approx(math.tan(math.radians(angle)))
    assert len(garment.plan) == folds
    assert not {"stretch_fraction", "friction_static"} & set(garment.material.assumed)
    assert {"areal_mass", "bending_length", "thickness", "friction_layers"} <= set(garment.material.assumed)


@pytest.mark.parametrize("name", GARMENTS)
def test_every_pose_is_in_view_and_on_the_table(name: str) -> None:
    garment = GARMENTS[name]
    for x, y, angle in itertools.product(garment.poses.x, garment.poses.y, garment.poses.angle):
        points = garment.place(x, y, angle)
        assert shapely.Polygon(points).within(VIEW)
        assert points[:, 0].min() >= 0.24 and points[:, 0].max() <= 0.98
        assert garment.poses.contains(x, y, angle)


@pytest.mark.parametrize("name", GARMENTS)
def test_drawn_poses_are_in_their_ranges_and_depend_on_the_seed(name: str) -> None:
    poses = GARMENTS[name].poses
    drawn = [poses.sample(np.random.default_rng(7)) for _ in range(2)]
    assert drawn[0] == drawn[1]
    rng = np.random.default_rng(8)
    samples = np.array([poses.sample(rng) for _ in range(200)])
    assert all(poses.contains(*s) for s in samples)
    assert (np.ptp(samples, axis=0) > 0.7 * np.ptp([poses.x, poses.y, poses.angle], axis=1)).all()
    assert poses.contains(*poses.middle)


@pytest.mark.parametrize("name", GARMENTS)
def test_placing_a_garment_is_a_similarity_transform(name: str) -> None:
    garment = GARMENTS[name]
    placed = garment.place(0.5, 0.1, 0.4, 1.1)
    before = np.linalg.norm(garment.template[:, None] - garment.template, axis=-1)
    after = np.linalg.norm(placed[:, None] - placed, axis=-1)
    assert np.allclose(after, 1.1 * before)
    assert shapely.Polygon(placed).exterior.is_ccw
    turned = garment.place(0.0, 0.0, np.pi / 2)
    assert np.allclose(turned, garment.template @ np.array([[0, 1], [-1, 0]]))


@pytest.mark.parametrize("name", GARMENTS)
def test_folds_of_a_flat_garment_can_be_planned_in_all_variants(name: str) -> None:
    garment = GARMENTS[name]
    state = garment.flat_state(*garment.poses.middle)
    for step in garment.plan:
        for variant in step.variants:
            assert plan_folds(state, garment, {step.name: variant.name}).ok
