"""The stated accuracy of key points on drawn outlines, whose true corners are known."""

import numpy as np
import pytest

from foldcell.skills.perception.outline import MemberOutline, resample_closed
from foldcell.skills.perception.registration.accuracy import (
    in_photograph,
    keypoint_sigmas,
    probability_within,
    with_shape,
)
from foldcell.skills.perception.registration.register import register
from tests.builders.silhouettes import Silhouette
from tests.scenes import TOWEL, TOWEL_NAMES

VEST_NAMES = ("hem_right", "armpit_right", "shoulder_right", "shoulder_left", "armpit_left", "hem_left")
VEST = np.array([[-0.31, -0.22], [0.08, -0.22], [0.3, -0.12], [0.3, 0.12], [0.08, 0.22], [-0.31, 0.22]])


def sigmas(outline, name, names, template):
    garment = Silhouette(name, name, names, template)
    points = resample_closed(outline, 0.002)
    return keypoint_sigmas(register(points, garment), garment, points)


def ragged(outline, corner, depth):
    """The outline with notches, `depth` deep and 15 mm long, around one of its corners, as if the segmentation had
    taken stripes of the cloth for table."""
    points = resample_closed(outline, 0.002)
    away = np.linalg.norm(points - outline[corner], axis=1)
    inwards = outline.mean(axis=0) - points
    inwards /= np.linalg.norm(inwards, axis=1, keepdims=True)
    bite = (away > 0.01) & (away < 0.10) & ((away * 1e3) % 30 < 15)
    return points + depth * bite[:, None] * inwards


def test_the_corners_of_a_clean_outline_are_certain():
    found = sigmas(TOWEL, "towel", TOWEL_NAMES, TOWEL)
    assert max(found.values()) < 0.002
    assert probability_within(found, 0.010) > 0.97


def test_a_ragged_outline_makes_the_key_points_near_it_uncertain():
    found = sigmas(ragged(TOWEL, 2, 0.012), "towel", TOWEL_NAMES, TOWEL)
    near = TOWEL_NAMES[2]
    assert found[near] > 0.006
    assert max(s for name, s in found.items() if name != near) < 0.003
    assert probability_within(found, 0.010) < 0.8


def test_more_of_it_makes_them_more_uncertain():
    said = [
        probability_within(sigmas(ragged(TOWEL, 2, depth), "towel", TOWEL_NAMES, TOWEL), 0.010)
        for depth in (0.0, 0.004, 0.008, 0.016)
    ]
    assert said == sorted(said, reverse=True)


def test_an_armpit_is_uncertain_where_the_outline_hardly_bends():
    """The sides of the second vest go on in nearly the same direction as its armholes."""
    straight = VEST.copy()
    straight[[1, 4], 1] *= 0.86
    clear = sigmas(VEST, "vest", VEST_NAMES, VEST)
    blunt = sigmas(straight, "vest", VEST_NAMES, VEST)
    for side in ("left", "right"):
        assert blunt[f"armpit_{side}"] > 1.5 * clear[f"armpit_{side}"]
    assert probability_within(blunt, 0.010) < probability_within(clear, 0.010)


def test_the_corners_of_a_narrow_strap_do_not_make_each_other_uncertain():
    """The two corners at the end of a strap are 45 mm apart."""
    right = np.array([[-0.31, -0.22], [0.0, -0.22], [0.28, -0.13], [0.3, -0.09]])
    strap = np.vstack([right, [[0.15, 0.0]], right[::-1] * [1, -1]])
    names = (
        "hem_right", "armpit_right", "shoulder_right", "collar_right", "neck", "collar_left", "shoulder_left",
        "armpit_left", "hem_left",
    )  # fmt: skip
    found = sigmas(strap, "vest", names, strap)
    for name in ("shoulder_left", "shoulder_right", "collar_left", "collar_right"):
        assert found[name] < 0.0025
    assert probability_within(found, 0.010) > 0.9


@pytest.mark.parametrize(("sigma", "expected"), [(1e-9, 1.0), (0.010, 0.6261), (1.0, 0.0075)])
def test_the_probability_is_that_of_a_t_distribution(sigma, expected):
    """Values of Student's t-distribution with 4 degrees of freedom."""
    assert probability_within({"a": sigma}, 0.010) == pytest.approx(expected, abs=1e-3)
    assert probability_within({"a": sigma, "b": sigma}, 0.010) == pytest.approx(expected**2, abs=1e-3)


def test_a_fitted_shape_leaves_inward_corners_least_certain():
    names = ("hem_right", "armpit_right", "cuff_right", "cuff_left", "armpit_left", "hem_left")
    template = np.array([[-0.3, -0.2], [0.1, -0.2], [0.1, -0.4], [0.1, 0.4], [0.1, 0.2], [-0.3, 0.2]])
    template[[2, 3], 0] = 0.3
    for order in (slice(None), slice(None, None, -1)):  # a template may run clockwise
        shape = template[order]
        member = MemberOutline("shirt", "shirt", names[order], shape, shape, np.arange(6), 0.0)
        scales = with_shape(dict.fromkeys(names, 0.001), member, 1.0)
        assert scales["armpit_left"] == scales["armpit_right"] > 1.5 * scales["hem_left"] > 0.003
        assert scales["cuff_right"] == scales["hem_left"]


def test_a_photograph_of_unknown_scale_leaves_more_doubt():
    worth = [in_photograph(p) for p in (0.0, 0.6, 0.75, 0.98, 1.0)]
    assert worth == sorted(worth)
    assert worth == pytest.approx([0.0, 0.40, 0.57, 0.96, 1.0], abs=0.01)
