"""Shoulders and ends of the collar of drawn shirts: the outline is smooth there; the whole edge shows them."""

from dataclasses import replace

import numpy as np
import pytest

from foldcell.skills.perception.outline import resample_closed, smooth_closed
from foldcell.skills.perception.registration.details.upper_edge import _closed, _Edge, _knots, locate_upper_edge
from foldcell.skills.plane import rotation

HALF = {"hem": (0.0, -0.24), "armpit": (0.44, -0.25), "cuff_lower": (0.40, -0.36)}
SHOULDER, COLLAR = (0.635, -0.22), (0.68, -0.09)
NECKLINE, STAND = [(0.665, -0.04), (0.66, 0.0)], [(0.735, -0.07), (0.737, 0.0)]


def shirt(cuff=(0.51, -0.42), middle=NECKLINE, rounded=0.008, turn=0.0):
    """Key points and outline of a shirt whose halves mirror each other [m]. middle: from the collar's end to the
    axis. rounded: standard deviation of the Gaussian that smooths the outline [m]."""
    half = {**HALF, "cuff_upper": cuff, "shoulder": SHOULDER, "collar": COLLAR}
    right = np.array([*half.values(), *middle])
    outline = resample_closed(np.vstack([right, right[-2::-1] * (1, -1)]), 0.002)
    outline = smooth_closed(outline, rounded / 0.002) @ rotation(turn).T
    places = {f"{name}_{side}": rotation(turn) @ (np.array(p) * (1, sign))
              for name, p in half.items() for side, sign in (("right", 1), ("left", -1))}  # fmt: skip
    return places, outline


def located(places, outline):
    """Locate the upper edge from the other key points alone."""
    known = {name: place for name, place in places.items() if not name.startswith(("shoulder", "collar"))}
    return locate_upper_edge(known, outline, ("right", "left"))


@pytest.mark.parametrize("turn", [0.0, 2.1])
@pytest.mark.parametrize("cuff", [(0.51, -0.43), (0.44, -0.38)], ids=["raised", "drooping"])
@pytest.mark.parametrize("middle", [NECKLINE, STAND], ids=["neckline", "standing collar"])
def test_all_four_key_points_are_found(cuff, middle, turn):
    places, outline = shirt(cuff, middle, turn=turn)
    found = located(places, outline)
    diagonal = np.linalg.norm(np.ptp(np.array(list(places.values())), axis=0))
    assert len(found) == 4
    for name, (place, sigma) in found.items():
        assert np.linalg.norm(place - places[name]) < 0.02 * diagonal
        assert np.linalg.norm(place - places[name]) < 2.5 * sigma


def test_a_standing_collar_ends_at_the_seam_and_not_at_its_upper_edge():
    places, outline = shirt(middle=STAND)
    found = located(places, outline)
    upper = np.array([STAND[0][0], STAND[0][1]])
    assert np.linalg.norm(found["collar_right"][0] - upper) > 0.035


def test_a_smooth_edge_leaves_the_shoulder_less_certain_than_one_that_bends():
    bent = located(*shirt(cuff=(0.47, -0.39), rounded=0.004))["shoulder_left"][1]
    straight = (0.635 - 0.045 / 0.13 * 0.22, -0.44)  # on the line of the shoulder's seam
    smooth = located(*shirt(cuff=straight, rounded=0.004))["shoulder_left"][1]
    assert smooth > 1.1 * bent


def test_on_an_edge_without_bends_the_seams_tell_where_the_collar_ends():
    b = np.linspace(-0.6, 0.6, 151)
    unseen = _Edge(1.0 - 0.4 * np.sqrt(b**2 + 0.01), b, 0.6, 0.32, np.array([0.7, 0.6]), 0.0, None, None)
    _, usual, _ = _knots(unseen)
    _, places, _ = _knots(replace(unseen, seams=(0.0, 0.28, 0.02)))
    assert places[1] == pytest.approx([0.28, -0.28], abs=0.01)
    assert places[0, 0] > usual[0, 0] + 0.01 and places[0, 1] < usual[0, 1] - 0.01


def test_an_edge_without_room_for_shoulders_yields_nothing():
    places, _ = shirt()
    narrow = {
        name: place * (1.0, 0.3) if name.startswith("cuff_upper") else place for name, place in places.items()
    }
    outline = np.array([[0.0, -0.24], [0.44, -0.25], [0.51, -0.126], [0.51, 0.126], [0.44, 0.25], [0.0, 0.24]])
    assert located(narrow, resample_closed(outline, 0.002)) == {}


def test_a_notch_as_narrow_as_a_label_is_filled_and_a_collar_is_not() -> None:
    b = np.linspace(-0.6, 0.6, 151)
    edge = 1.0 - 0.3 * np.abs(b) - 0.06 * np.clip(1.0 - (b / 0.2) ** 2, 0.0, None)
    notched = edge - np.where(np.abs(b - 0.03) < 0.035, 0.05, 0.0)
    assert np.abs(_closed(notched, b) - edge).max() < 0.02 < np.abs(notched - edge).max()
    assert np.abs(_closed(edge, b) - edge).max() < 0.01
