"""A shoulder on a drawn shirt: the outline is straight there, and the seam ends at a known place."""

import cv2
import numpy as np
import pytest

from foldcell.skills.perception.registration.details.cloth_picture import ClothPicture
from foldcell.skills.perception.registration.details.sleeve_seam import locate_seam
from foldcell.skills.perception.registration.energy import Boundary

PIXEL = 0.002
OUTLINE = np.array([[-0.3, 0.2], [-0.3, -0.2], [0.3, -0.2], [0.3, 0.2]])
SHOULDER, ARMPIT = np.array([0.05, 0.2]), np.array([0.06, 0.02])


def shirt(dark=0.25, bow=0.012, stripes=0.0, noise=2.0, part=1.0):
    """Cloth with a seam from SHOULDER to ARMPIT. dark: share of light that the seam takes. bow: its sagitta [m].
    stripes: brightness of stripes along the seam, relative to the cloth. part: visible share of the seam."""
    size = (340, 240)
    y, x = np.mgrid[: size[1], : size[0]]
    points = np.stack([x, y], -1) * PIXEL + np.array([-0.34, -0.24])
    mask = (np.abs(points[..., 0]) < 0.3) & (np.abs(points[..., 1]) < 0.2)
    chord = ARMPIT - SHOULDER
    t = np.linspace(0, part, 200)[:, None]
    seam = SHOULDER + t * chord + 4 * bow * t * (1 - t) * np.array([1.0, 0.0])
    line = np.zeros(size[::-1], np.uint8)
    cv2.polylines(line, [np.round(pixels(seam) * 16).astype(np.int32)], False, 255, 1, cv2.LINE_AA, 4)
    bright = 110 * (1 - dark * line / 255.0) * (1 + stripes * (np.sin(2 * np.pi * points[..., 0] / 0.02) > 0))
    bright = np.where(mask, bright, 200.0)
    rgb = cv2.GaussianBlur(bright, (0, 0), 0.7) + np.random.default_rng(0).normal(0, noise, bright.shape)
    shown = np.clip(np.repeat(rgb[..., None], 3, axis=2), 0, 255).astype(np.uint8)
    return ClothPicture(shown, mask, pixels, shown, pixels)


def pixels(points):
    return (points - np.array([-0.34, -0.24])) / PIXEL


def found(picture, displaced):
    return locate_seam(picture, Boundary(OUTLINE), SHOULDER + np.array([displaced, 0.0]), ARMPIT)


@pytest.mark.parametrize("displaced", [-0.025, 0.0, 0.025])
@pytest.mark.parametrize("bow", [-0.012, 0.0, 0.018])
def test_the_shoulder_is_where_the_seam_ends(bow, displaced):
    place = found(shirt(bow=bow), displaced)
    assert place is not None
    assert np.linalg.norm(place - SHOULDER) < 0.004


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
    assert found(picture, 0.0) is None


def test_the_armpit_need_not_be_known_exactly():
    place = locate_seam(shirt(), Boundary(OUTLINE), SHOULDER, ARMPIT + np.array([0.006, -0.006]))
    assert place is not None
    assert np.linalg.norm(place - SHOULDER) < 0.006
