"""`foldcell perceive IMAGE`: what the cell sees in a picture from its camera."""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from cell.calibration_file import camera_calibration
from cell.config import load_settings
from cell.garments import list_garments, load_garment
from cell.subcommands.output import print_json, write_whole
from robots.errors import ConfigurationError
from robots.ports import CameraFrame, Intrinsics
from skills.perception.overlay import draw_on_camera
from skills.perception.perceive import Perception, perceive

__all__ = ["read_frame", "run"]

MILLIMETRES = 1e-3


def run(options: argparse.Namespace) -> int:
    """0 with key points, 2 when no garment was recognised."""
    settings = load_settings(options.cell)
    calibration = camera_calibration(settings)
    names = list_garments() if options.garment == "auto" else (options.garment,)
    garments = [load_garment(name, settings.surface) for name in names]
    frame = read_frame(options.image, options.depth, calibration.intrinsics, 0)
    empty = None
    if options.reference is not None:
        empty = read_frame(options.reference, options.reference_depth, calibration.intrinsics, 1)
    thresholds = settings.perception.settings()
    if options.depth is None:  # that there is none is the user's choice, not a broken camera
        thresholds = replace(thresholds, depth_holes=1.0)
    output = options.output or options.image.with_name(f"{options.image.stem}-perceived.png")
    seen = perceive(
        frame, calibration, settings.table, empty, garments,
        None if options.garment == "auto" else garments[0].name, thresholds,
    )  # fmt: skip
    if seen.failure is not None:
        failure = seen.failure
        if options.json:
            print_json({"image": str(options.image), "recognised": False, "failure": failure, "notes": seen.notes})
        else:
            print(f"not recognised: {failure}")
        return 2
    perception = seen.unwrap()
    _write_overlay(output, draw_on_camera(perception, frame.rgb))
    if options.json:
        print_json({**_figures(options.image, perception, output), "notes": seen.notes})
    else:
        _print(perception, output)
    return 0


def read_frame(image: Path, depth: Path | None, intrinsics: Intrinsics, sequence: int) -> CameraFrame:
    """A picture from files. Raises ConfigurationError when one cannot be read or has another size."""
    size = (intrinsics.height, intrinsics.width)
    bgr = _read_image(image, cv2.IMREAD_COLOR)
    _check_size(image, bgr.shape[:2], size)
    metres = np.full(size, np.nan, np.float32)
    if depth is not None:
        metres = _read_depth(depth)
        _check_size(depth, metres.shape, size)
    return CameraFrame(0.0, sequence, np.ascontiguousarray(bgr[:, :, ::-1]), metres, intrinsics)


def _read_image(path: Path, flags: int) -> NDArray:
    try:
        data = np.frombuffer(path.read_bytes(), np.uint8)
    except OSError as e:
        raise ConfigurationError(f"{path}: cannot be read: {e.strerror}", "check the path", path=str(path)) from e
    try:
        image = cv2.imdecode(data, flags) if data.size else None
    except cv2.error:  # claims to be a picture of an impossible size
        image = None
    if image is None:
        raise ConfigurationError(f"{path}: is no picture that can be read (PNG or JPEG)", path=str(path))
    return np.asarray(image)


def _read_depth(path: Path) -> NDArray[np.float32]:
    """(H, W) [m]: `.npy` in metres, otherwise a picture of 16 bits in millimetres; 0 is no measurement."""
    if path.suffix == ".npy":
        try:
            raw = np.load(path, allow_pickle=False)
        except (OSError, ValueError) as e:
            raise ConfigurationError(f"{path}: is no array that can be read: {e}", path=str(path)) from e
        metres = raw.astype(np.float32) if raw.ndim == 2 and raw.dtype.kind == "f" else None
    else:
        raw = _read_image(path, cv2.IMREAD_UNCHANGED)
        metres = raw.astype(np.float32) * MILLIMETRES if raw.ndim == 2 and raw.dtype == np.uint16 else None
    if metres is None:
        raise ConfigurationError(
            f"{path}: holds {raw.dtype} of shape {raw.shape}", "give 16-bit millimetres (PNG) or metres (.npy)"
        )
    return np.where(metres > 0, metres, np.nan).astype(np.float32)


def _check_size(path: Path, found: tuple[int, ...], expected: tuple[int, int]) -> None:
    if tuple(found) != expected:
        wanted = f"{expected[1]} x {expected[0]}"
        raise ConfigurationError(
            f"{path}: is {found[1]} x {found[0]} pixels, the camera is calibrated for {wanted}",
            "give a picture as the cell's camera takes it, or a calibration of the camera that took it (--cell)",
        )


def _write_overlay(path: Path, rgb: NDArray[np.uint8]) -> None:
    done, png = cv2.imencode(".png", rgb[:, :, ::-1])
    if not done:
        raise AssertionError("the overlay could not be encoded")
    write_whole(path, png.tobytes())


def _figures(image: Path, perception: Perception, overlay: Path) -> dict[str, Any]:
    state = perception.state
    return {
        "image": str(image),
        "recognised": True,
        "garment": perception.garment,
        "category": state.category,
        "confidence": state.confidence,
        "ambiguous": state.ambiguous,
        "keypoints_m": state.keypoints,
        "overlay": str(overlay),
    }


def _print(perception: Perception, overlay: Path) -> None:
    state = perception.state
    print(f"{state.category} ({perception.garment}), confidence {state.confidence:.2f}")
    print("key points in the table frame [m]:")
    for name, (x, y) in state.keypoints.items():
        print(f"  {name:<20} {x:+.3f} {y:+.3f}")
    print(f"overlay  {overlay}")
