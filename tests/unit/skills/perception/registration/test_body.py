"""The pose of a garment's body with turned sleeves and blunt corners."""

import numpy as np
import pytest

from foldcell.skills.perception.outline import interior_angles, resample_closed
from foldcell.skills.perception.registration.body import lay_body
from foldcell.skills.perception.registration.energy import Boundary
from tests.scenes import SHIRT_NAMES, place, shirt

TEMPLATE = shirt()
BODY = [i for i, name in enumerate(SHIRT_NAMES) if not name.startswith("cuff")]
CLEAR = np.abs(np.sin(interior_angles(TEMPLATE))) > 0.7


@pytest.mark.parametrize("swing", [(0.0, 0.0), (0.25, -0.2), (0.25, 0.25)])
def test_turned_sleeves_do_not_move_the_body(swing):
    truth = place(shirt(*swing) * (1.04, 0.97), 0.6, 0.02, 0.15)
    placed = truth + 0.004 * np.random.default_rng(0).standard_normal(truth.shape)
    found = lay_body(TEMPLATE, placed, CLEAR, Boundary(resample_closed(truth, 0.002)))
    assert np.linalg.norm(found - truth, axis=1)[BODY].max() < 0.003


def test_the_body_pose_does_not_depend_on_blunt_corners():
    truth = place(shirt(0.1, -0.1), 0.6, 0.0, -0.1)
    placed = np.where(CLEAR[:, None], truth, truth + np.array([0.02, -0.03]))
    found = lay_body(TEMPLATE, placed, CLEAR, Boundary(resample_closed(truth, 0.002)))
    assert np.linalg.norm(found - truth, axis=1)[BODY].max() < 0.003


def test_corners_without_a_common_rigid_motion_give_no_body_pose():
    scattered = np.random.default_rng(3).uniform(-0.5, 0.5, TEMPLATE.shape)
    contour = resample_closed(place(TEMPLATE, 0.6, 0.0, 0.0), 0.002)
    few = CLEAR & (np.cumsum(CLEAR) <= 4)
    assert lay_body(TEMPLATE, scattered, few, Boundary(contour)) is None
