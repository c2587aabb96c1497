"""`foldcell.perceive` for rendered pictures with known key points."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

import foldcell
from foldcell.cell.config.cell_settings import load_settings
from foldcell.cell.hardware.camera import camera_calibration
from foldcell.robots.errors import FailureKind
from foldcell.robots.ports import CameraFrame
from tests.scenes import TOWEL_NAMES, render, towel_scene


@pytest.fixture(scope="module")
def taken() -> tuple[CameraFrame, CameraFrame, np.ndarray]:
    """Pictures of a medium towel and of the empty table by the shipped camera, and the true corners (4, 2)."""
    scene, corners = towel_scene(0)
    calibration = camera_calibration(load_settings())
    return render(scene, calibration), render(replace(scene, polygons=[]), calibration, 1), corners


def worst(seen: foldcell.PerceivedGarment, corners: np.ndarray) -> float:
    """Largest distance of a key point from the truth [m]."""
    return max(np.linalg.norm(seen.keypoints[n] - p) for n, p in zip(TOWEL_NAMES, corners, strict=True))


def test_perceive_finds_the_towel_in_arrays_from_the_cells_camera(
    taken: tuple[CameraFrame, CameraFrame, np.ndarray],
) -> None:
    frame, bare, corners = taken
    seen = foldcell.perceive(
        frame.rgb, frame.depth, reference=bare.rgb, reference_depth=bare.depth, garment="medium_towel"
    )
    assert seen.failure is None and seen.unit == "m"
    assert (seen.garment, seen.category) == ("medium_towel", "towel")
    assert seen.confidence > 0.8
    assert worst(seen, corners) < 0.008
    x, y = seen.contour.T
    area = 0.5 * float(np.sum(x * np.roll(y, -1) - y * np.roll(x, -1)))  # positive means counter-clockwise
    assert area == pytest.approx(0.24, rel=0.05)


def test_picture_files_give_the_same_result_as_arrays(
    taken: tuple[CameraFrame, CameraFrame, np.ndarray], tmp_path: Path
) -> None:
    frame, _, _ = taken
    cv2.imwrite(str(tmp_path / "rgb.png"), frame.rgb[:, :, ::-1])
    np.save(tmp_path / "depth.npy", frame.depth)
    by_arrays = foldcell.perceive(frame.rgb, frame.depth)
    by_files = foldcell.perceive(tmp_path / "rgb.png", str(tmp_path / "depth.npy"))
    assert by_arrays.failure is None
    assert by_arrays.garment == by_files.garment
    assert np.array_equal(by_arrays.contour, by_files.contour)


@pytest.mark.parametrize(
    ("factor", "unit"), [(4.0, "steps of 0.25 mm"), (5.0, "steps of 0.2 mm"), (1000.0, "floats in millimetres")]
)
@pytest.mark.parametrize("which", ["depth", "reference_depth"])
def test_depth_in_another_unit_is_refused_with_its_factor(
    taken: tuple[CameraFrame, CameraFrame, np.ndarray], factor: float, unit: str, which: str
) -> None:
    frame, bare, _ = taken
    depths = {"depth": frame.depth, "reference_depth": bare.depth}
    depths[which] = depths[which] * np.float32(factor)
    seen = foldcell.perceive(frame.rgb, reference=bare.rgb, **depths)
    assert seen.failure is not None and seen.failure.kind is FailureKind.CAMERA_FAULT
    assert seen.failure.values["depth_ratio"] == pytest.approx(factor, rel=0.05)
    assert f"{unit}: divide it by {factor:.0f}" in seen.failure.hint


def test_depth_far_below_the_table_counts_as_missing(taken: tuple[CameraFrame, CameraFrame, np.ndarray]) -> None:
    frame, _, _ = taken
    depth = frame.depth.copy()
    depth[: len(depth) * 4 // 10] = np.nan
    assert foldcell.perceive(frame.rgb, depth).failure is None
    depth[len(depth) * 8 // 10 :] = 5.0
    seen = foldcell.perceive(frame.rgb, depth)
    assert seen.failure is not None and seen.failure.kind is FailureKind.CAMERA_FAULT
    assert "of the table is missing or more than 10 cm below its top" in seen.failure.what


def test_a_picture_without_a_garment_returns_a_failure_and_raises_no_error() -> None:
    table = np.random.default_rng(0).normal(170, 2, (240, 320, 3)).astype(np.uint8)
    seen = foldcell.perceive(table, unit="px")
    assert seen.failure is not None and seen.failure.kind is FailureKind.NO_GARMENT
    assert seen.garment is None and seen.keypoints == {} and seen.contour.shape == (0, 2)


@pytest.mark.parametrize(
    ("size", "message"),
    [((1, 1), "at least 50"), ((49, 80), "at least 50"), ((400, 8), "5 times"), ((60, 301), "5 times")],
)
def test_a_picture_by_an_unknown_camera_must_not_be_tiny_or_very_long(size: tuple[int, int], message: str) -> None:
    """Tiny pictures of noise had been taken for skirts."""
    noise = np.random.default_rng(0).integers(0, 255, (*size, 3), dtype=np.uint8)
    with pytest.raises(foldcell.ConfigurationError, match=message):
        foldcell.perceive(noise, unit="px")


PICTURE = np.zeros((480, 640, 3), np.uint8)
DEPTH = np.ones((480, 640), np.float32)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ({"rgb": PICTURE[:48, :64]}, "rgb: is 64 x 48 pixels"),
        ({"rgb": PICTURE[:, :, 0]}, "rgb: holds uint8"),
        ({"rgb": PICTURE.astype(float)}, "rgb: holds float64"),
        ({"rgb": PICTURE, "depth": DEPTH.astype(np.uint16)}, "depth: holds uint16"),
        ({"rgb": PICTURE, "depth": DEPTH[:48, :64]}, "depth: is 64 x 48 pixels"),
        ({"rgb": PICTURE, "reference_depth": DEPTH}, "reference_depth without reference"),
        ({"rgb": PICTURE, "depth": DEPTH, "reference": PICTURE}, "without reference_depth"),
        ({"rgb": PICTURE, "unit": "cm"}, "no unit 'cm'"),
        ({"rgb": PICTURE, "garment": "sock"}, "sock"),
        ({"rgb": "nowhere.png"}, "nowhere.png: cannot be read"),
        ({"rgb": PICTURE, "settings": {"perception": {"metod": "plain"}}}, "metod"),
    ],
)
def test_perceive_refuses_wrong_arguments_by_name(arguments: dict[str, Any], words: str) -> None:
    with pytest.raises(foldcell.ConfigurationError, match=words):
        foldcell.perceive(**arguments)
