"""The shoulders of a drawn shirt: the outline is straight there, and the seams end at known places."""

import cv2
import numpy as np
import pytest

from foldcell.skills.perception.registration.details.cloth_picture import ClothPicture
from foldcell.skills.perception.registration.details.sleeve_seam import locate_seams
from foldcell.skills.perception.registration.energy import Boundary

PIXEL = 0.002
OUTLINE = np.array([[-0.3, 0.2], [-0.3, -0.2], [0.3, -0.2], [0.3, 0.2]])
SHOULDER, ARMPIT = np.array([0.12, 0.2]), np.array([0.13, 0.02])
SIDES = np.array([[1.0, 1.0], [-1.0, 1.0]])


def shirt(dark=0.25, bow=0.012, stripes=0.0, noise=2.0, part=1.0, sides=2):
    """Cloth with seams from SHOULDER to ARMPIT and on the other side. dark: share of light that a seam takes. bow:
    its sagitta [m]. stripes: brightness of stripes along the seam, relative to the cloth. part: visible share of
    the seam. sides: on how many sides there is one."""
    size = (340, 240)
    y, x = np.mgrid[: size[1], : size[0]]
    points = np.stack([x, y], -1) * PIXEL + np.array([-0.34, -0.24])
    mask = (np.abs(points[..., 0]) < 0.3) & (np.abs(points[..., 1]) < 0.2)
    chord = ARMPIT - SHOULDER
    t = np.linspace(0, part, 200)[:, None]
    seam = SHOULDER + t * chord + 4 * bow * t * (1 - t) * np.array([1.0, 0.0])
    line = np.zeros(size[::-1], np.uint8)
    for side in SIDES[:sides]:
        cv2.polylines(line, [np.round(pixels(side * seam) * 16).astype(np.int32)], False, 255, 1, cv2.LINE_AA, 4)
    bright = 110 * (1 - dark * line / 255.0) * (1 + stripes * (np.sin(2 * np.pi * points[..., 0] / 0.02) > 0))
    bright = np.where(mask, bright, 200.0)
    rgb = cv2.GaussianBlur(bright, (0, 0), 0.7) + np.random.default_rng(0).normal(0, noise, bright.shape)
    shown = np.clip(np.repeat(rgb[..., None], 3, axis=2), 0, 255).astype(np.uint8)
    return ClothPicture(shown, mask, pixels, shown, pixels)


def pixels(points):
    return (points - np.array([-0.34, -0.24])) / PIXEL


def found(picture, displaced=0.0, sigma=0.02, armpit=ARMPIT):
    """The places and standard deviations of the right and the left shoulder. displaced: outwards, of the places by
    the outline."""
    shoulders = [(side * (SHOULDER + np.array([displaced, 0.0])), sigma) for side in SIDES]
    return locate_seams(picture, Boundary(OUTLINE), shoulders, SIDES * armpit, np.array([0.0, 1.0]))


@pytest.mark.parametrize("displaced", [-0.025, 0.0, 0.025])
@pytest.mark.parametrize("bow", [-0.012, 0.0, 0.018])
def test_the_shoulders_are_where_the_seams_end(bow, displaced):
    for (place, sigma), side in zip(found(shirt(bow=bow), displaced), SIDES, strict=True):
        assert np.linalg.norm(place - side * SHOULDER) < 0.004
        assert sigma < 0.006


@pytest.mark.parametrize(
    "picture",
    [
        shirt(dark=0.0),
        shirt(dark=0.25, part=0.4),
        shirt(dark=0.0, stripes=0.3),
        shirt(dark=-0.25),
    ],
    ids=["none", "part of one", "stripes", "bright line"],
)
def test_no_shoulder_is_read_off_where_there_is_no_seam(picture):
    for place, sigma in found(picture, sigma=0.01):
        assert sigma > 0.005
        assert np.linalg.norm(np.abs(place) - SHOULDER) < 0.010


def test_the_armpit_need_not_be_known_exactly():
    for (place, _), side in zip(found(shirt(), armpit=ARMPIT + np.array([0.006, -0.006])), SIDES, strict=True):
        assert np.linalg.norm(place - side * SHOULDER) < 0.006


def test_a_seam_on_one_side_moves_the_other_shoulder_too():
    (right, clear), (left, unclear) = found(shirt(sides=1), displaced=0.02)
    assert np.linalg.norm(right - SHOULDER) < 0.004
    assert np.linalg.norm(left - SIDES[1] * SHOULDER) < 0.018  # and 0.020 without the other side
    assert clear < 0.004 < unclear < 0.02


def test_a_line_far_from_where_the_outline_puts_the_shoulder_is_no_seam():
    (place, _), _ = found(shirt(), displaced=0.06, sigma=0.01)
    assert np.linalg.norm(place - SHOULDER - np.array([0.06, 0.0])) < 0.004


@pytest.mark.parametrize("apart", [0.05, 0.07])
def test_one_of_many_dark_lines_is_no_seam(apart):
    """One line of checked cloth ends near the shoulder, with as much evidence as a seam."""
    plain = shirt(dark=0.0)
    dark = np.zeros(plain.rgb.shape[:2], np.float32)
    for x in np.arange(SHOULDER[0] - 0.006 - 6 * apart, 0.3, apart):
        column = round(float(pixels(np.array([x, 0.0]))[0]))
        dark[:, column : column + 2] = 0.3
    lined = np.where(
        plain.mask[..., None], plain.rgb * (1 - cv2.GaussianBlur(dark, (0, 0), 0.7))[..., None], 200.0
    )
    checked = lined.astype(np.uint8)
    for _, sigma in found(ClothPicture(checked, plain.mask, pixels, checked, pixels)):
        assert sigma > 0.012


def test_seams_near_the_edge_of_the_picture_are_weighed_without_what_lies_beside_it():
    """Lines that are displaced outwards lie beside the picture, on either side of it."""
    whole, beside = shirt(), np.array([15.0, 0.0])
    rgb, mask = whole.rgb[:, 15:-15].copy(), whole.mask[:, 15:-15].copy()
    picture = ClothPicture(rgb, mask, lambda points: pixels(points) - beside, rgb, lambda points: points)
    shoulders = [(side * (0.27, 0.2), 0.003) for side in SIDES]
    seams = locate_seams(picture, Boundary(OUTLINE), shoulders, SIDES * (0.28, 0.02), np.array([0.0, 1.0]))
    for place, sigma in seams:
        assert np.linalg.norm(np.abs(place) - (0.27, 0.2)) < 0.004 and sigma < 0.005
