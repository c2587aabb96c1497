"""A template fitted to observed key points: rotation, scale and symmetry."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from foldcell.cell.config.garments.garment_file import load_garment
from foldcell.skills.garments.picture_measure import fitted_template, mirror_images
from tests.scenes import place

SHIRT = load_garment("t_shirt", "bare_table").template
SKEW = np.array([[-0.3, -0.2], [0.3, -0.25], [0.2, 0.3], [-0.25, 0.2]])


@given(st.floats(-np.pi, np.pi), st.floats(0.01, 1e4), st.floats(-50.0, 50.0), st.sampled_from([0, 1]))
def test_a_fitted_template_does_not_depend_on_turn_scale_and_place(
    angle: float, scale: float, shift: float, which: int
) -> None:
    shape = (SHIRT, SKEW)[which]
    pair = (0, len(shape) // 2)
    length = float(np.linalg.norm(shape[pair[0]] - shape[pair[1]]))
    found = fitted_template(scale * place(shape, 0.0, 0.0, angle) + shift, shape, pair, length)
    centred = shape - 0.5 * (shape.min(axis=0) + shape.max(axis=0))
    assert found == pytest.approx(centred, abs=1e-6)


def test_a_fitted_symmetric_template_is_the_mean_of_its_halves() -> None:
    twins = mirror_images(SHIRT)
    assert twins is not None and (twins[twins] == np.arange(len(SHIRT))).all()
    seen = SHIRT.copy()
    seen[0] += [0.02, 0.0]  # one corner of the hem is pulled out
    found = fitted_template(seen, SHIRT, None, None)
    assert found[twins] * [1.0, -1.0] == pytest.approx(found, abs=1e-9)
    hem = found[0, 0] - found[5, 0]
    assert hem == pytest.approx(SHIRT[0, 0] - SHIRT[5, 0] + 0.01, abs=1e-3)
    assert mirror_images(SKEW) is None


@pytest.mark.parametrize("length", [0.0, -1.0])
def test_points_without_extent_are_refused(length: float) -> None:
    with pytest.raises(ValueError, match="no scale"):
        fitted_template(SHIRT, SHIRT, (0, 1), length)
    with pytest.raises(ValueError, match="no scale"):
        fitted_template(np.zeros_like(SHIRT), SHIRT, (0, 1), 0.5)
