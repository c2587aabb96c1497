"""Height maps: equal places and heights have equal colours."""

from __future__ import annotations

from types import SimpleNamespace

import cv2
import numpy as np
import pytest

from foldcell.cell.report.pictures.height_map import BAR, INK, PAPER, TICK, height_maps


def seen(height: np.ndarray, mask: np.ndarray) -> SimpleNamespace:
    return SimpleNamespace(height=height.astype(np.float32), mask=mask)


def test_pictures_of_one_fold_share_their_part_of_the_table_and_their_colours() -> None:
    mask = np.zeros((200, 300), bool)
    mask[60:120, 80:220] = True
    other = np.roll(mask, 5, axis=1)
    high, low = np.where(mask, 0.02, 0.0), np.where(other, 0.02, 0.0)
    high[60:120, 80:110] = 0.04  # a crease, which is pressed
    before, after = height_maps([seen(high, mask), seen(low, other)])  # type: ignore[list-item]
    assert before.shape == after.shape and before.shape[1] >= 420
    h, w = before.shape[0] - BAR, before.shape[1]
    assert (before[0, 0] == PAPER).all()
    assert (before[h // 2, w // 2] == after[h // 2, w // 2]).all(), "what was not pressed looks as it did"
    crease = int(w * (12 + 15) / (145 + 24))
    highest, flat = before[h // 2, crease].astype(int), before[h // 2, w // 2].astype(int)
    assert highest.sum() > flat.sum() + 50, "higher places are lighter"
    assert (before[h + BAR // 2] == highest).all(axis=1).any(), "the bar shows the colour of the highest place"
    assert (after[h // 2, crease] == after[h // 2, w // 2]).all()


def test_unseen_parts_of_a_height_map_are_white() -> None:
    mask = np.zeros((100, 100), bool)
    mask[20:80, 20:80] = True
    height = np.where(mask, 0.02, 0.0)
    height[30:60, 30:60] = np.nan
    (picture,) = height_maps([seen(height, mask)])  # type: ignore[list-item]
    h, w = picture.shape[0] - BAR, picture.shape[1]
    assert (picture[h * 37 // 84, w * 37 // 84] == PAPER).all()


def test_equal_steps_of_height_are_equal_steps_of_lightness() -> None:
    mask = np.ones((300, 1001), bool)
    height = np.broadcast_to(np.linspace(0.0, 0.02, 1001), mask.shape)
    (picture,) = height_maps([seen(height, mask)])  # type: ignore[list-item]
    lightness = cv2.cvtColor(picture[100:101], cv2.COLOR_RGB2LAB)[0, 30:-30, 0].astype(float)
    steps = np.diff(lightness[:: len(lightness) // 8])
    assert (steps > 0).all() and steps.max() < 1.6 * steps.min()


def cam02_ucs(rgb: np.ndarray) -> np.ndarray:
    """Return colours (n, 3) of sRGB (n, 3) in CAM02-UCS, in which equal distances look equal (Luo, Cui and
    Li 2006; average surround, 64 lux, grey background)."""
    c = rgb / 255.0
    linear = np.where(c <= 0.04045, c / 12.92, ((c + 0.055) / 1.055) ** 2.4)
    to_xyz = np.array([[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]])
    cat = np.array([[0.7328, 0.4296, -0.1624], [-0.7036, 1.6975, 0.0061], [0.0030, 0.0136, 0.9834]])
    cones = np.array([[0.38971, 0.68898, -0.07868], [-0.22981, 1.18340, 0.04641], [0.0, 0.0, 1.0]])
    white = np.array([95.047, 100.0, 108.883])
    adapting = 64.0 / np.pi / 5.0
    degree = 1.0 - np.exp((-adapting - 42.0) / 92.0) / 3.6
    k = 1.0 / (5.0 * adapting + 1.0)
    level = 0.2 * k**4 * 5.0 * adapting + 0.1 * (1.0 - k**4) ** 2 * (5.0 * adapting) ** (1.0 / 3.0)
    n = 0.2
    induction, base = 0.725 * n**-0.2, 1.48 + np.sqrt(n)

    def response(xyz: np.ndarray) -> np.ndarray:
        adapted = xyz @ cat.T * (degree * 100.0 / (cat @ white) + 1.0 - degree)
        x = adapted @ np.linalg.inv(cat).T @ cones.T
        power = (level * np.abs(x) / 100.0) ** 0.42
        return np.sign(x) * 400.0 * power / (power + 27.13) + 0.1

    def achromatic(r: np.ndarray) -> np.ndarray:
        return (2.0 * r[..., 0] + r[..., 1] + r[..., 2] / 20.0 - 0.305) * induction

    r, r_white = response(100.0 * linear @ to_xyz.T), response(white[None])[0]
    a, b = r[:, 0] - 12.0 * r[:, 1] / 11.0 + r[:, 2] / 11.0, (r[:, 0] + r[:, 1] - 2.0 * r[:, 2]) / 9.0
    hue = np.arctan2(b, a)
    lightness = 100.0 * (np.maximum(achromatic(r), 0.0) / achromatic(r_white)) ** (0.69 * base)
    t = 50000.0 / 13.0 * induction * 0.25 * (np.cos(hue + 2.0) + 3.8) * np.hypot(a, b)
    t /= r[:, 0] + r[:, 1] + 1.05 * r[:, 2]
    colourfulness = t**0.9 * np.sqrt(lightness / 100.0) * (1.64 - 0.29**n) ** 0.73 * level**0.25
    scaled = 1.7 * lightness / (1.0 + 0.007 * lightness)
    radius = np.log(1.0 + 0.0228 * colourfulness) / 0.0228
    return np.column_stack([scaled, radius * np.cos(hue), radius * np.sin(hue)])


def test_equal_steps_of_height_look_equally_large() -> None:
    mask = np.ones((300, 1001), bool)
    height = np.broadcast_to(np.linspace(0.0, 0.02, 1001), mask.shape)
    (picture,) = height_maps([seen(height, mask)])  # type: ignore[list-item]
    colours = cam02_ucs(picture[100].astype(float))[20:-20]
    steps = np.linalg.norm(np.diff(colours[:: len(colours) // 8], axis=0), axis=1)
    assert steps.max() < 1.15 * steps.min()


def test_the_ticks_of_the_bar_stand_at_equal_heights() -> None:
    mask = np.ones((200, 300), bool)
    height = np.where(np.arange(300) < 150, 0.004, 0.022) * np.ones((200, 1))
    (picture,) = height_maps([seen(height, mask)])  # type: ignore[list-item]
    above_the_labels, below = picture[-BAR + 9], picture[-BAR + 28]
    left, right = np.flatnonzero((above_the_labels != PAPER).any(axis=1))[[0, -1]]
    ticks = np.flatnonzero((below[left : right + 1] == INK).all(axis=1))
    top = 0.022
    assert ticks / (right - left) * top == pytest.approx(np.arange(TICK, top, TICK), abs=2e-4)
