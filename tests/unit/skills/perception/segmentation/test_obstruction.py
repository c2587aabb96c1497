"""A hand in view: it is found by its height, whatever it hides, and a garment is not taken for one."""

from __future__ import annotations

import functools
from dataclasses import replace

import numpy as np
import pytest

from foldcell.robots.errors import FailureKind
from foldcell.skills.perception.rectification.table_view import TableView
from foldcell.skills.perception.segmentation.obstruction import find_obstruction, standing_parts
from foldcell.skills.vocabulary import PredictedShape
from tests.builders.shipped_settings import inspect, perceive
from tests.scenes import TABLE, TOWEL, Scene, camera, empty, place, render, with_arm

CAMERA = camera()
VIEW = TableView(CAMERA, TABLE, 0.002)
FLAT = Scene(seed=3, polygons=[place(TOWEL, 0.6, 0.0, 0.1)])
LEFT, RIGHT, NEAR = (0.55, 0.75), (0.55, -0.75), (0.10, 0.1)


@functools.cache
def bare():
    return empty(FLAT)


@functools.cache
def lying(thickness=0.003, bumps=()):
    scene = Scene(seed=3, polygons=FLAT.polygons, thickness=thickness, bumps=list(bumps))
    return render(scene)


def sheet(quad):
    """The prediction of a fold: a flat sheet with these four corners [m]."""
    vertices = np.column_stack([quad, np.full(4, 0.003)])
    return PredictedShape(vertices, np.array([[0, 1, 2], [0, 2, 3]], np.int32), quad)


def found(frame, known=None):
    return find_obstruction(VIEW.rectify(frame), known, VIEW.pixel)


@pytest.mark.parametrize(("start", "side"), [(LEFT, "left"), (RIGHT, "right"), (NEAR, "near")])
@pytest.mark.parametrize("reach", [0.35, 0.9])
@pytest.mark.parametrize("reference", [True, False])
def test_an_arm_is_found_with_the_edge_that_it_comes_from(start, side, reach, reference, towels):
    """It may end before the garment, or reach over it so that both are one region."""
    tip = np.asarray(start) + reach * (np.array([0.6, 0.0]) - start)
    outcome = perceive(
        with_arm(lying(), CAMERA, tip, start), CAMERA, TABLE, bare() if reference else None, towels, "medium_towel"
    )
    assert outcome.failure is not None and outcome.failure.kind is FailureKind.VIEW_OBSTRUCTED
    assert f"{side} edge" in outcome.failure.what and "hands" in outcome.failure.hint
    assert outcome.failure.values["height_m"] == pytest.approx(0.06, abs=0.006)


def test_something_that_hides_most_of_the_picture_is_found():
    """The median height is then its own, and the table seems to lie deep."""
    frame = lying()
    near = np.array(frame.depth)
    near[:, : round(0.8 * near.shape[1])] = 0.3
    assert np.mean(found(replace(frame, depth=near))[VIEW.valid]) > 0.6


def test_an_arm_is_found_whatever_its_colour():
    """Also in the colour of the table or of the garment."""
    for place_of_colour in ((200, 400), (300, 320)):
        colour = tuple(int(c) for c in lying().rgb[place_of_colour])
        assert found(with_arm(lying(), CAMERA, (0.6, 0.2), LEFT, colour=colour)).any()


@pytest.mark.parametrize("bumps", [(), ((0.6, 0.05, 0.09, 0.07),)])
@pytest.mark.parametrize("thickness", [0.003, 0.02])
def test_a_garment_is_no_obstruction(thickness, bumps):
    """Neither a thick one nor one that is piled up in the middle of the table."""
    assert not found(lying(thickness, bumps)).any()


def test_what_stood_there_already_is_no_obstruction():
    """Parts of the robot reach into the picture of the empty table too."""
    elbow = functools.partial(with_arm, calibration=CAMERA, tip=(0.45, 0.4), start=(0.4, 0.75), height=0.15)
    known = standing_parts(VIEW.rectify(elbow(bare())), VIEW.pixel)
    parked = elbow(lying())
    assert found(parked).any() and not found(parked, known).any()
    assert found(with_arm(parked, CAMERA, (0.6, -0.2), RIGHT), known).any()


def test_a_few_centimetres_of_error_in_the_tables_height_are_no_obstruction():
    """Without a picture of the empty table, heights are nominal."""
    assert not found(render(FLAT, camera(position=(0.12, 0.0, 1.01)))).any()


def test_a_hand_in_the_picture_leaves_a_fold_unjudged():
    """Cloth and hand together would look like a bad fold."""
    shape = sheet(FLAT.polygons[0])
    assert inspect(lying(), CAMERA, TABLE, bare(), shape).unwrap().accepted
    hidden = inspect(with_arm(lying(), CAMERA, (0.6, 0.2), LEFT), CAMERA, TABLE, bare(), shape)
    assert hidden.failure is not None and hidden.failure.kind is FailureKind.VIEW_OBSTRUCTED


def test_a_second_garment_beside_a_fold_is_reported():
    quad = place(TOWEL * 0.5, 0.5, -0.25, 0.0)
    both = Scene(seed=3, polygons=[quad, place(TOWEL * 0.4, 0.6, 0.25, 0.3)])
    outcome = inspect(render(both), CAMERA, TABLE, bare(), sheet(quad))
    assert outcome.failure is not None and outcome.failure.kind is FailureKind.UNKNOWN_GARMENT
