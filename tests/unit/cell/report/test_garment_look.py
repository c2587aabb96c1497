"""The garment's colours and its original outline: as the camera saw them, and where the camera saw them."""

from __future__ import annotations

import numpy as np
import pytest
import synthetic_run as show

from foldcell.cell.report.pictures.fold_pictures import (
    TABLE_COLOUR,
    TAPE,
    ClothColours,
    KeyFrame,
    Scenery,
    View,
    draw_frame,
)
from foldcell.cell.report.pictures.garment_look import outlined, seen_colours
from tests.scenes import Scene, camera, render

SQUARE = np.array([[0.5, -0.15], [0.75, -0.15], [0.75, 0.15], [0.5, 0.15]])


def along(outline: np.ndarray, n: int = 60) -> np.ndarray:
    """Places on a closed line, n on each side, in the table frame (k, 3)."""
    ends = zip(outline, np.roll(outline, -1, axis=0), strict=True)
    places = np.vstack([np.linspace(a, b, n) for a, b in ends])
    return np.column_stack([places, np.zeros(len(places))])


def pinhole(matrix: np.ndarray, rotation: np.ndarray, eye: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Pixels (k, 2) by the pinhole equation. rotation: its rows are right, down and forward."""
    p = (matrix @ rotation @ (points - eye).T).T
    return p[:, :2] / p[:, 2:]


def share_of(colour: tuple[int, int, int], picture: np.ndarray, pixels: np.ndarray) -> float:
    column, row = np.round(pixels).astype(int).T
    distance = np.abs(picture[row, column].astype(int) - colour).max(axis=1)
    return float((distance < 45).mean())


def test_the_outline_in_a_drawn_picture_lies_where_the_pinhole_equation_puts_it() -> None:
    view = View(np.array([1.2, 0.7, 1.1]), np.array([0.62, 0.0, 0.0]), 420.0, 400, 300, (7.0, -4.0))
    towel = show.Towel.make(3, 3)
    aside = np.column_stack([towel.material - [0.0, 5.0], np.zeros(9)])  # out of the picture
    picture = draw_frame(KeyFrame(aside), towel.triangles, view, Scenery(show.TABLE, (), SQUARE))
    forward = (view.target - view.eye) / np.linalg.norm(view.target - view.eye)
    right = np.cross(forward, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    rotation = np.stack([right, np.cross(forward, right), forward])
    matrix = np.array([[420.0, 0.0, 207.0], [0.0, 420.0, 146.0], [0.0, 0.0, 1.0]])
    assert share_of(TAPE, picture, pinhole(matrix, rotation, view.eye, along(SQUARE)) - 0.5) > 0.95
    inside = 0.625 + 0.85 * (along(SQUARE) - [0.625, 0.0, 0.0]) - [0.0, 0.625, 0.625] * np.array([0, 1, 1])
    assert share_of(TABLE_COLOUR, picture, pinhole(matrix, rotation, view.eye, inside)) > 0.95


def test_cloth_hides_the_outline_to_dashes() -> None:
    view = View(np.array([0.62, -0.01, 1.2]), np.array([0.62, 0.0, 0.0]), 420.0, 400, 300)
    towel = show.Towel.make()
    over = np.column_stack([towel.material, np.full(len(towel.material), 0.02)])
    colours = ClothColours((150, 80, 110), (150, 80, 110))
    picture = draw_frame(KeyFrame(over), towel.triangles, view, Scenery(show.TABLE, (), SQUARE, colours))
    seen = share_of(TAPE, picture, view.project(along(SQUARE))[:, :2])
    assert 0.4 < seen < 0.75, "dashes and gaps are equally long, and dashes have round ends"


def test_the_outline_in_a_camera_picture_lies_where_the_pinhole_equation_puts_it() -> None:
    calibration = camera()
    frame = render(Scene(), calibration)
    picture = outlined(frame, calibration, SQUARE)
    k, T = calibration.intrinsics, calibration.T_table_camera
    matrix = np.array([[k.fx, 0.0, k.cx], [0.0, k.fy, k.cy], [0.0, 0.0, 1.0]])
    pixels = pinhole(matrix, T[:3, :3].T, T[:3, 3], along(SQUARE)) * (picture.shape[1] / frame.rgb.shape[1])
    assert share_of(TAPE, picture, pixels) > 0.97
    assert (outlined(frame, None, SQUARE) == frame.rgb).all(), "without calibration the place is not known"
    assert (outlined(frame, calibration, None) == frame.rgb).all()


@pytest.mark.parametrize("colour", [(134, 68, 95), (40, 90, 160), (196, 190, 181)])
def test_flat_cloth_is_drawn_in_the_colour_that_the_camera_saw(colour: tuple[int, int, int]) -> None:
    rng = np.random.default_rng(3)
    rgb = np.full((120, 160, 3), (168, 140, 108), np.int64)
    mask = np.zeros((120, 160), bool)
    mask[30:90, 40:120] = True
    rgb[mask] = colour
    seen = (rgb + rng.integers(-9, 10, rgb.shape)).clip(0, 255).astype(np.uint8)
    towel = show.Towel.make()
    flat = np.column_stack([towel.material, np.full(len(towel.material), 0.001)])
    facing_down = towel.triangles[:, ::-1]
    view = View(np.array([0.6, -0.01, 1.2]), np.array([0.6, 0.0, 0.0]), 300.0, 200, 150)
    up = np.cross(*(flat[towel.triangles[0, 1:]] - flat[towel.triangles[0, 0]]))[2] > 0.0
    triangles = towel.triangles if up else facing_down
    picture = draw_frame(KeyFrame(flat), triangles, view, Scenery(colours=seen_colours(seen, mask)))
    middle = np.median(picture[65:85, 90:110].reshape(-1, 3), axis=0)
    assert middle == pytest.approx(colour, abs=5)


@pytest.mark.parametrize("level", [0, 12, 90, 200, 255])
def test_both_sides_can_be_told_apart_whatever_the_colour(level: int) -> None:
    colours = seen_colours(np.full((40, 40, 3), level, np.uint8), np.ones((40, 40), bool))
    assert abs(np.subtract(colours.front, colours.back)).max() >= 40
    assert max(colours.front) >= 40, "the shading of a black garment has to show"
