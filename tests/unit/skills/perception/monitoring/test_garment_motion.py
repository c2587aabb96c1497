"""The motion of a garment between two pictures, with and without arms over the table."""

from __future__ import annotations

import functools

import numpy as np
import pytest

from foldcell.robots.errors import FailureKind
from foldcell.skills.perception.monitoring.garment_motion import displaced_boundary, measure_motion
from foldcell.skills.perception.views import open_views
from tests.builders.shipped_settings import PERCEPTION
from tests.scenes import TABLE, TOWEL, Scene, camera, empty, place, render, with_arm

CAMERA, SETTINGS = camera(), PERCEPTION
HOME = (0.6, 0.0, 0.1)
BARE = Scene(seed=5)


@functools.cache
def picture(at=HOME, bumps=(), sequence=1):
    return render(
        Scene(seed=5, polygons=[place(TOWEL * 0.8, *at)], bumps=list(bumps), wobble=0.0), sequence=sequence
    )


@functools.cache
def bare():
    return empty(BARE)


def views(frame, arms=False):
    return open_views(frame, CAMERA, TABLE, bare(), None, SETTINGS, arms_in_view=arms).unwrap()


def motion(later):
    return measure_motion(views(picture()), views(later), SETTINGS).unwrap()


def test_a_garment_that_lies_still_has_not_moved():
    for sequence in (2, 3):
        still = motion(picture(sequence=sequence))
        assert still.moved_m < 0.002 and still.deviation_m < 0.004 and still.reshaped_m2 < 1e-4


@pytest.mark.parametrize(
    ("dx", "dy", "turn"), [(0.08, 0.0, 0.0), (0.0, -0.02, 0.0), (-0.03, 0.04, 0.15), (0.0, 0.0, -0.3)]
)
def test_the_rigid_motion_of_a_shoved_garment_is_measured(dx, dy, turn):
    seen = motion(picture((HOME[0] + dx, HOME[1] + dy, HOME[2] + turn)))
    corners = place(TOWEL * 0.8, *HOME)
    true = place(TOWEL * 0.8, HOME[0] + dx, HOME[1] + dy, HOME[2] + turn)
    np.testing.assert_allclose(corners @ seen.R.T + seen.t, true, atol=0.004)
    assert seen.moved_m == pytest.approx(np.linalg.norm(true - corners, axis=1).max(), abs=0.006)
    assert seen.turned_rad == pytest.approx(turn, abs=0.01) and seen.deviation_m < 0.006
    assert f"{seen.moved_m * 1e3:.0f} mm" in seen.says()


def test_a_garment_that_was_rumpled_in_its_place_is_reshaped():
    rumpled = motion(picture(bumps=((0.6, 0.05, 0.05, 0.03),)))
    assert rumpled.reshaped_m2 > 0.002 and rumpled.moved_m < 0.008


def test_a_garment_that_was_folded_over_deviates():
    half = place(TOWEL * (0.8, 0.5), *HOME)
    folded = render(Scene(seed=5, polygons=[half], wobble=0.0), sequence=4)
    assert motion(folded).deviation_m > 0.03


@pytest.mark.parametrize(("frame", "kind"), [(bare, FailureKind.NO_GARMENT)])
def test_a_garment_that_was_taken_away_is_reported(frame, kind):
    outcome = measure_motion(views(picture()), views(render(BARE, sequence=9)), SETTINGS)
    assert outcome.failure is not None and outcome.failure.kind is kind


def armed(at=HOME):
    """Two arms reach over the garment, as before a grasp."""
    one = with_arm(
        picture(at, sequence=6), CAMERA, (0.72, 0.1), (0.15, 0.75), height=0.12, width=0.12, colour=(60, 60, 62)
    )
    return with_arm(one, CAMERA, (0.72, -0.1), (0.15, -0.75), height=0.12, width=0.12, colour=(60, 60, 62))


def test_arms_over_a_garment_that_lies_still_displace_nothing():
    assert displaced_boundary(views(picture()), views(armed(), arms=True), SETTINGS) < 0.02


@pytest.mark.parametrize("shift", [(0.08, 0.0), (0.0, 0.08), (-0.05, -0.04)])
def test_a_shove_is_seen_between_the_arms(shift):
    later = armed((HOME[0] + shift[0], HOME[1] + shift[1], HOME[2]))
    assert displaced_boundary(views(picture()), views(later, arms=True), SETTINGS) > 0.10
