"""Blunt corners of drawn outlines, whose true places are known."""

import numpy as np
import pytest

from foldcell.skills.perception.registration.bend import PLACE_SIGMA, locate_bend
from foldcell.skills.perception.registration.energy import Boundary
from foldcell.skills.perception.registration.register import register
from tests.builders.silhouettes import Silhouette

SPAN = 0.20
"""Length of the edges on both sides of the corner [m]."""


def outline(turn, bow=0.0, noise=0.0):
    """A closed outline, counter-clockwise, whose upper edge turns by `turn` [rad] at the origin. bow: sagitta of
    the edge on the left of the corner [m]. noise: standard deviation of waves along the edge [m]."""
    right = np.array([np.cos(turn / 2), -np.sin(turn / 2)]) * SPAN
    left = np.array([-np.cos(turn / 2), -np.sin(turn / 2)]) * SPAN
    t = np.linspace(0, 1, 100, endpoint=False)[:, None]
    normal = np.array([left[1], -left[0]]) / SPAN
    upper = np.vstack([right * (1 - t), left * t + 4 * bow * t * (1 - t) * normal, left])
    waves = sum(np.sin(2 * np.pi * upper[:, 0] / length + length * 1e3) for length in (0.03, 0.05, 0.08))
    upper = upper + noise / np.sqrt(1.5) * np.outer(waves, (0.0, 1.0))
    down = np.array([0.0, -0.3])
    return Boundary(np.vstack([upper, left + down, right + down]))


def _found(boundary, turn, displaced, template_turn=None):
    start = boundary.points[np.argmin(np.abs(boundary.points[:, 0] - displaced) + (boundary.points[:, 1] < -0.1))]
    return locate_bend(boundary, start, SPAN, SPAN, turn if template_turn is None else template_turn)


@pytest.mark.parametrize(
    ("turn", "displaced"), [(20.0, -0.008), (20.0, 0.008), (35.0, -0.015), (35.0, 0.0), (35.0, 0.015)]
)
def test_a_bend_is_found_wherever_the_registration_put_it(turn, displaced):
    place, sigma = _found(outline(np.deg2rad(turn), noise=0.0003), np.deg2rad(turn), displaced)
    assert np.linalg.norm(place) < 0.005
    assert sigma < 0.005


def test_the_corner_between_a_straight_and_a_curved_edge_is_where_they_meet():
    """Such as the armpit of a vest: a straight side and a round armhole."""
    for bow in (-0.01, 0.01):
        place, _ = _found(outline(np.deg2rad(35), bow=bow), np.deg2rad(35), 0.012)
        assert np.linalg.norm(place) < 0.003


def test_the_turn_may_differ_from_the_template_s():
    place, _ = _found(outline(np.deg2rad(35)), np.deg2rad(35), 0.012, template_turn=np.deg2rad(20))
    assert np.linalg.norm(place) < 0.003


def test_a_corner_on_a_straight_edge_stays_and_its_place_is_uncertain():
    place, sigma = _found(outline(0.0, noise=0.0003), 0.0, 0.01)
    assert abs(place[0] - 0.01) < 0.004
    assert sigma > 0.7 * PLACE_SIGMA


def test_a_blunter_bend_is_less_certain():
    sigmas = [
        _found(outline(np.deg2rad(turn), noise=0.0003), np.deg2rad(turn), 0.0)[1] for turn in (40, 20, 10, 3)
    ]
    assert sigmas == sorted(sigmas)


def test_a_registered_vest_has_its_armpits_where_the_sides_end():
    """The armhole of this vest begins 25 mm lower than that of the template."""
    names = ("hem_right", "armpit_right", "shoulder_right", "shoulder_left", "armpit_left", "hem_left")
    template = np.array([[-0.31, -0.22], [0.08, -0.22], [0.3, -0.14], [0.3, 0.14], [0.08, 0.22], [-0.31, 0.22]])
    truth = template.copy()
    truth[[1, 4], 0] -= 0.025
    found = register(truth, Silhouette("vest", "vest", names, template))
    for name, place in zip(names, truth, strict=True):
        assert np.linalg.norm(found.keypoints[name] - place) < 0.006, name
