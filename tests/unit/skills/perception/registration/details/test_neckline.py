"""A neckline on a drawn shirt: below a straight upper edge, which does not show where the collar ends."""

import cv2
import numpy as np
import pytest

from foldcell.skills.perception.registration.details.cloth_picture import ClothPicture
from foldcell.skills.perception.registration.details.neckline import locate_neckline

PIXEL, SIZE = 0.002, 0.5
ORIGIN = np.array([0.0, 0.4])  # middle of the shirt's hem [m]; the picture's rows run downwards
FRAME = SIZE * np.array([[0.0, 1.0], [-1.0, 0.0]])
ACROSS = np.linspace(-0.6, 0.6, 61)
EDGE = np.column_stack([np.full(61, 0.7), ACROSS])


def pixels(points):
    return (points - np.array([-0.4, -0.05])) / PIXEL


def shirt(axis=0.04, half=0.15, depth=0.12, dark=25, pattern=0.0, cut=1.0):
    """A shirt whose neck is open. dark: how much darker its inside is. pattern: of crossing stripes. cut: share of
    the opening that is seen."""
    y, x = np.mgrid[:250, :400]
    shown = np.full((250, 400, 3), 120.0) + (pattern * np.sign(np.sin(x / 5.0) * np.sin(y / 6.0)))[..., None]
    b = axis + np.linspace(-half, -half + 2 * half * cut, 80)
    drop = depth * (1 - ((b - axis) / half) ** 2)
    low = np.column_stack([0.7 - drop, b])
    high = np.column_stack([np.full(80, 0.7), b])
    opening = np.round(pixels(ORIGIN + np.vstack([low, high[::-1]]) @ FRAME.T) * 16).astype(np.int32)
    inside = cv2.fillPoly(np.zeros((250, 400), np.uint8), [opening], 1, shift=4)
    shown -= float(dark) * inside[..., None]
    corners = pixels(ORIGIN + np.array([[0.0, -0.6], [0.7, -0.6], [0.7, 0.6], [0.0, 0.6]]) @ FRAME.T)
    mask = cv2.fillPoly(np.zeros((250, 400), np.uint8), [np.round(corners).astype(np.int32)], 1) > 0
    shown = np.where(mask[..., None], shown, 220.0) + np.random.default_rng(1).normal(0, 2, (250, 400, 3))
    rgb = np.clip(cv2.GaussianBlur(shown, (0, 0), 0.7), 0, 255).astype(np.uint8)
    return ClothPicture(rgb, mask, pixels, rgb, pixels)


@pytest.mark.parametrize("dark", [25, -25], ids=["dark inside", "bright inside"])
@pytest.mark.parametrize("axis", [-0.06, 0.04])
@pytest.mark.parametrize("half", [0.11, 0.18])
def test_the_collar_ends_where_the_neckline_does(half, axis, dark):
    found = locate_neckline(shirt(axis, half, dark=dark), EDGE, FRAME, ORIGIN, 0.0)
    assert found == pytest.approx((axis, half), abs=0.02)


@pytest.mark.parametrize(
    "picture", [shirt(dark=0), shirt(dark=0, pattern=20.0), shirt(cut=0.6)], ids=["none", "pattern", "part of one"]
)
def test_cloth_without_a_neckline_has_none(picture):
    assert locate_neckline(picture, EDGE, FRAME, ORIGIN, 0.0) is None


def test_an_edge_that_is_too_short_for_a_collar_has_none():
    assert locate_neckline(shirt(), EDGE[30:34], FRAME, ORIGIN, 0.0) is None
