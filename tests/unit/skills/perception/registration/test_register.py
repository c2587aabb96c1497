from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from foldcell.skills.perception.outline import polygon_area, resample_closed, symmetries
from foldcell.skills.perception.registration.energy import Boundary, EnergyWeights
from foldcell.skills.perception.registration.register import FitSettings, best_starts, fit, register
from tests.builders.silhouettes import Silhouette
from tests.scenes import (
    SHIRT_NAMES,
    TOWEL,
    TOWEL_NAMES,
    TROUSERS_NAMES,
    place,
    shirt,
    trousers,
)

TOWEL_TEMPLATE = Silhouette("medium_towel", "towel", TOWEL_NAMES, TOWEL)
TROUSERS = Silhouette("pants", "pants", TROUSERS_NAMES, trousers())


def error(registration, names, truth):
    return max(np.linalg.norm(registration.keypoints[n] - p) for n, p in zip(names, truth, strict=True))


@settings(max_examples=12)
@given(
    st.floats(-0.1, 0.1), st.floats(-0.1, 0.1), st.floats(-1.4, 1.4), st.floats(0.9, 1.1), st.floats(0.93, 1.07)
)
def test_a_towel_is_registered_at_any_place_turn_and_size(x, y, angle, size, aspect):
    truth = place(TOWEL * (size * aspect, size), x, y, angle)
    found = register(resample_closed(truth, 0.002), TOWEL_TEMPLATE)
    assert error(found, TOWEL_NAMES, truth) < 0.002


def test_the_labelling_nearest_to_the_orientation_as_laid_is_chosen():
    """A towel turned by 100 degrees looks like one turned by -80 degrees. The smaller turn determines the names of
    the corners."""
    truth = place(TOWEL, 0.0, 0.0, np.deg2rad(100))
    found = register(resample_closed(truth, 0.002), TOWEL_TEMPLATE)
    swapped = np.roll(truth, 2, axis=0)
    assert error(found, TOWEL_NAMES, swapped) < 0.002
    assert found.ambiguous == ("rotated_180", "mirrored")


def test_trousers_upside_down_are_not_ambiguous():
    for angle in (0.2, np.pi + 0.2):
        truth = place(TROUSERS.template, 0.0, 0.0, angle)
        found = register(resample_closed(truth, 0.002), TROUSERS)
        assert error(found, TROUSERS.keypoints, truth) < 0.01
        assert found.ambiguous == ("mirrored",)


def test_a_clockwise_template_keeps_the_names_of_its_key_points():
    clockwise = Silhouette("towel", "towel", TOWEL_NAMES[::-1], TOWEL[::-1])
    assert polygon_area(clockwise.template) < 0
    found = register(resample_closed(TOWEL, 0.002), clockwise)
    assert error(found, TOWEL_NAMES, TOWEL) < 0.002
    assert tuple(found.keypoints) == clockwise.keypoints
    assert polygon_area(found.contour) > 0


def rounded_towel(radius):
    """A boundary with round corners, and the middles of its arcs, which are the tips of these corners."""
    from shapely import Polygon

    outline = np.array(Polygon(TOWEL).buffer(-radius).buffer(radius).exterior.coords)[:-1]
    tips = TOWEL - np.sign(TOWEL) * radius * (1.0 - np.sqrt(0.5))
    return resample_closed(outline, 0.002), tips


@pytest.mark.parametrize("radius", [0.004, 0.008, 0.02])
def test_the_key_point_of_a_round_corner_is_at_its_tip(radius):
    """The accuracy is a few millimetres. The registration expects the smoothing of a picture, which this boundary
    does not have."""
    points, tips = rounded_towel(radius)
    points = points + 0.0005 * np.random.default_rng(0).standard_normal(points.shape)
    assert error(register(points, TOWEL_TEMPLATE), TOWEL_NAMES, tips) < 0.0035


def test_snapping_finds_the_tip_of_a_well_rounded_corner():
    points, tips = rounded_towel(0.04)
    snapped = register(points, TOWEL_TEMPLATE)
    lagging = np.linalg.norm(snapped.stages[-1] - tips[:, None], axis=2).min(axis=1)
    assert error(snapped, TOWEL_NAMES, tips) < 0.5 * lagging.max()


@pytest.mark.parametrize("spread", [0.0, 0.03, -0.02])
def test_a_crotch_is_found_between_close_legs(spread):
    """The boundary ends 25 mm before the crotch, where the legs are 3 mm apart."""
    truth = trousers(spread, spread)
    crotch = TROUSERS_NAMES.index("crotch")
    inner = [truth[crotch - 1], truth[crotch + 1]]
    apart = [truth[crotch] + 0.025 * (p - truth[crotch]) / np.linalg.norm(p - truth[crotch]) for p in inner]
    seen = np.vstack([truth[:crotch], apart, truth[crotch + 1 :]])
    found = register(resample_closed(seen, 0.002), TROUSERS)
    assert np.linalg.norm(found.keypoints["crotch"] - truth[crotch]) < 0.010


@pytest.mark.parametrize(
    ("make", "names", "swings"),
    [(shirt, SHIRT_NAMES, (-0.3, 0.3)), (trousers, TROUSERS_NAMES, (0.03, 0.10))],
    ids=["shirt", "trousers"],
)
def test_turned_sleeves_and_legs_are_registered(make, names, swings):
    """Sleeves and legs are turned by up to 17 degrees. Nearly every key point is found within 1 cm."""
    template = Silhouette(make.__name__, make.__name__, names, make())
    errors = []
    for seed in range(5):
        rng = np.random.default_rng(seed)
        truth = place(make(*rng.uniform(*swings, 2)), 0.6, 0.0, rng.uniform(-0.3, 0.3))
        found = register(resample_closed(truth, 0.002), template)
        errors += [np.linalg.norm(found.keypoints[n] - p) for n, p in zip(names, truth, strict=True)]
        assert found.ambiguous == ("mirrored",)
    assert np.median(errors) < 0.003 and np.quantile(errors, 0.95) < 0.010 and max(errors) < 0.03


def test_the_energy_falls_in_each_update():
    truth = place(TROUSERS.template * (1.05, 0.95), 0.02, 0.03, 0.4)
    history = register(resample_closed(truth, 0.002), TROUSERS).history
    assert all(b <= a * 1.0001 for a, b in pairwise(history[:-1]))
    assert history[-1] < 0.05 * history[0]


def test_the_papers_energy_alone_also_fits_a_towel():
    truth = place(TOWEL * 1.04, 0.02, -0.03, 0.25)
    boundary = Boundary(truth)
    one_way = FitSettings(weights=EnergyWeights(cover=0.0))
    X, feature, _, _ = fit(best_starts(TOWEL, boundary)[0].polygon, boundary, one_way)
    assert np.linalg.norm(X[[list(feature).index(i) for i in range(4)]] - truth, axis=1).max() < 0.012


SQUARE = np.array([[0.2, 0.2], [-0.2, 0.2], [-0.2, -0.2], [0.2, -0.2]])


@pytest.mark.parametrize(
    ("polygon", "names"),
    [
        (SQUARE, ("rotated_90", "rotated_180", "mirrored")),
        (SQUARE * (1.0, 1.5), ("rotated_180", "mirrored")),
        (SQUARE + np.outer(SQUARE[:, 1], (0.4, 0.0)), ("rotated_180",)),
        (shirt(), ("mirrored",)),
        (trousers(), ("mirrored",)),
        (np.array([[0, 0], [0.3, 0], [0.1, 0.12]]), ()),
        (shirt(left=0.6), ()),
    ],
    ids=["square", "towel", "leaning", "shirt", "trousers", "triangle", "shirt with one sleeve down"],
)
def test_a_silhouettes_symmetries_do_not_depend_on_how_it_is_turned(polygon, names):
    for angle in np.deg2rad(np.arange(0, 180, 5)):
        assert symmetries(place(polygon, 0.3, 0.1, angle)) == names


def test_a_misplaced_corner_along_an_edge_is_reported():
    """The outline belongs to a towel with a missing corner, but the template has all four corners."""
    whole = register(resample_closed(TOWEL, 0.002), TOWEL_TEMPLATE)
    assert whole.least_turn > 0.8
    cut = np.array([TOWEL[0], TOWEL[1], TOWEL[2], TOWEL[3] + (-0.25, 0.0), TOWEL[3] + (0.0, 0.35)])
    missing = register(resample_closed(cut, 0.002), TOWEL_TEMPLATE)
    assert missing.least_turn < 0.7
    at = missing.keypoints[missing.straightest]
    assert np.linalg.norm(at - TOWEL[3]) == min(np.linalg.norm(p - TOWEL[3]) for p in missing.keypoints.values())


def test_the_recorded_stages_lead_from_the_template_to_the_fit():
    truth = place(shirt(0.2, -0.1), 0.6, 0.0, 0.1)
    found = register(resample_closed(truth, 0.002), Silhouette("shirt", "shirt", SHIRT_NAMES, shirt()))
    assert len(found.stages) == len(found.history)
    off = [np.mean([np.linalg.norm(stage - p, axis=1).min() for p in truth]) for stage in found.stages]
    assert off[-1] < 0.5 * off[0]
