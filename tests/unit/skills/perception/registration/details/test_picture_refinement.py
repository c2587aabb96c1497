"""Seams of the two sleeves, and what the upper edge says of the shoulders."""

import numpy as np

from foldcell.skills.perception.registration.details.picture_refinement import _agreeing
from foldcell.skills.perception.registration.energy import Boundary

BOUNDARY = Boundary(np.array([[-0.3, 0.2], [-0.3, -0.2], [0.3, -0.2], [0.3, 0.2]]))
RIGHT, LEFT = np.array([0.1, -0.2]), np.array([0.1, 0.2])
LOCATED = {"shoulder_right": (RIGHT, 0.010), "shoulder_left": (LEFT, 0.010)}


def seam(place, displaced):
    return place + np.array([displaced, 0.0]), 0.0016


def test_seams_near_the_places_by_the_edge_are_taken():
    found = _agreeing({"shoulder_right": seam(RIGHT, 0.01), "shoulder_left": seam(LEFT, -0.01)}, LOCATED, BOUNDARY)
    assert np.allclose(found["shoulder_right"][0], [0.11, -0.2])
    assert np.allclose(found["shoulder_left"][0], [0.09, 0.2])


def test_a_seam_on_one_side_moves_the_other_shoulder_by_as_much():
    found = _agreeing({"shoulder_right": seam(RIGHT, 0.015)}, LOCATED, BOUNDARY)
    assert np.allclose(found["shoulder_left"][0], [0.115, 0.2], atol=0.003)
    assert 0.0016 < found["shoulder_left"][1] < 0.010


def test_a_line_far_from_where_the_edge_puts_the_shoulder_is_no_seam():
    assert _agreeing({"shoulder_right": seam(RIGHT, 0.05)}, LOCATED, BOUNDARY) == {}
    assert _agreeing({}, LOCATED, BOUNDARY) == {}
