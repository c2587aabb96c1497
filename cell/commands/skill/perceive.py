"""`foldcell perceive IMAGE`: recognises the garment in a picture."""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from cell.commands.options import cell_option, json_option
from cell.commands.output import print_json
from cell.config.cell_settings import load_settings
from cell.config.garments.garment_file import list_garments, load_garment
from cell.hardware.camera import camera_calibration
from cell.support.files.whole_file import write_whole
from robots.errors import ConfigurationError, Failure
from robots.ports import Array, CameraFrame, Intrinsics, frozen
from skills.perception.overlay import draw_on_camera
from skills.perception.perceive import Perception, perceive
from skills.vocabulary import CameraCalibration, Outcome, Table

__all__ = ["ANY_SIZE", "add_options", "look_at", "photographed", "read_frame", "run", "write_overlay"]

MILLIMETRES = 1e-3
ANY_SIZE = 1e3
"""A relative tolerance of the size that no garment exceeds."""
WIDTH, HEIGHT = 1.2, 2.0
"""Assumed width of a photographed table, and height of an unknown camera above it [m]."""


def add_options(parser: argparse.ArgumentParser) -> None:
    parser.set_defaults(run=run)
    parser.add_argument("image", type=Path, metavar="IMAGE", help="colour picture from the cell's camera")
    parser.add_argument(
        "--depth", type=Path, help="depth of the image: 16-bit PNG in millimetres, or .npy in metres"
    )
    parser.add_argument("--garment", default="auto", metavar="G", help="the expected garment, or auto (auto)")
    parser.add_argument("--reference", type=Path, metavar="EMPTY", help="picture of the empty table")
    parser.add_argument("--reference-depth", type=Path, metavar="D", help="depth of the empty table")
    parser.add_argument("--output", type=Path, metavar="PNG", help="the overlay (IMAGE-perceived.png)")
    parser.add_argument(
        "--unit", choices=["m", "px"], default="m", help="px: photographed from above by an unknown camera (m)"
    )
    cell_option(parser)
    json_option(parser)


def run(options: argparse.Namespace) -> int:
    """Returns 0 if a garment was recognised, 2 if none was. Raises ConfigurationError, StorageError."""
    output = options.output or options.image.with_name(f"{options.image.stem}-perceived.png")
    outcome, frame = look_at(options, options.garment)
    if outcome.failure is not None:
        if options.json:
            print_json({**_refused(options.image, options.unit, outcome.failure), "notes": outcome.notes})
        else:
            print(f"not recognised: {outcome.failure}")
        return 2
    perception = outcome.unwrap()
    write_overlay(output, perception, frame)
    if options.json:
        print_json({**_figures(options.image, perception, output, options.unit), "notes": outcome.notes})
    else:
        _print(perception, output, options.unit)
    return 0


def look_at(options: argparse.Namespace, garment: str) -> tuple[Outcome[Perception], CameraFrame]:
    """Perception of the picture `options.image` with the other options, and the picture. garment: the expected
    garment, or auto. Raises ConfigurationError for a file that cannot be used."""
    _check_reference(options)
    settings = load_settings(options.cell)
    calibration, table = camera_calibration(settings), settings.table
    if options.unit == "px":
        calibration, table = photographed(_read_image(options.image, cv2.IMREAD_COLOR).shape)
    names = list_garments() if garment == "auto" else (garment,)
    garments = [load_garment(name, settings.surface) for name in names]
    frame = read_frame(options.image, options.depth, calibration.intrinsics, 0)
    empty = None
    if options.reference is not None:
        empty = read_frame(options.reference, options.reference_depth, calibration.intrinsics, 1)
    thresholds = settings.perception.settings()
    if options.depth is None:  # missing depth is the user's choice here, not a camera fault
        thresholds = replace(thresholds, depth_holes=1.0)
    if options.unit == "px":  # the size is unknown
        thresholds = replace(thresholds, size_tolerance=ANY_SIZE)
    expected = None if garment == "auto" else garments[0].name
    return perceive(frame, calibration, table, empty, garments, expected, thresholds), frame


def _check_reference(options: argparse.Namespace) -> None:
    """Raises ConfigurationError unless the picture and that of the empty table both have depth, or neither."""
    if options.reference is None and options.reference_depth is not None:
        raise ConfigurationError(
            "--reference-depth without --reference", "give the picture of the empty table too"
        )
    if None not in (options.reference, options.depth) and options.reference_depth is None:
        raise ConfigurationError(
            "--reference with --depth, but without --reference-depth",
            "give the depth of the empty table too, or leave out --reference or --depth",
        )


def photographed(shape: tuple[int, ...]) -> tuple[CameraCalibration, Table]:
    """Calibration and table for an unknown camera and a picture of `shape` (rows, columns): the camera is straight
    above the table, and the picture is `WIDTH` wide. Results in pixels are right, those in metres have no
    meaning."""
    rows, columns = shape[:2]
    focal = HEIGHT * columns / WIDTH
    intrinsics = Intrinsics(columns, rows, focal, focal, (columns - 1) / 2, (rows - 1) / 2)
    T = np.array([[0.0, -1.0, 0.0, 0.0], [-1.0, 0.0, 0.0, 0.0], [0.0, 0.0, -1.0, HEIGHT], [0.0, 0.0, 0.0, 1.0]])
    half = 0.5 * WIDTH * rows / columns
    return CameraCalibration(intrinsics, frozen(T)), Table(0.0, (-half, half), (-0.5 * WIDTH, 0.5 * WIDTH))


def read_frame(image: Path, depth: Path | None, intrinsics: Intrinsics, sequence: int) -> CameraFrame:
    """Read a camera frame from files. Raises ConfigurationError if one cannot be read or has another size."""
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
    except cv2.error:  # the file states an impossible size
        image = None
    if image is None:
        raise ConfigurationError(
            f"{path}: is no readable picture (PNG or JPEG)", "export or copy it again", path=str(path)
        )
    return np.asarray(image)


def _read_depth(path: Path) -> NDArray[np.float32]:
    """(H, W) [m] from `.npy` in metres or a 16-bit picture in millimetres; 0 means no measurement."""
    if path.suffix == ".npy":
        try:
            raw = np.load(path, allow_pickle=False)
        except (OSError, ValueError, EOFError) as e:
            raise ConfigurationError(f"{path}: is no readable array: {e}", path=str(path)) from e
        if not isinstance(raw, np.ndarray):
            raw.close()
            raise ConfigurationError(
                f"{path}: is no single array (an .npz contains several)", "save it with numpy.save", path=str(path)
            )
        metres = raw.astype(np.float32) if raw.ndim == 2 and raw.dtype.kind == "f" else None
    else:
        raw = _read_image(path, cv2.IMREAD_UNCHANGED)
        metres = raw.astype(np.float32) * MILLIMETRES if raw.ndim == 2 and raw.dtype == np.uint16 else None
    if metres is None:
        raise ConfigurationError(
            f"{path}: contains {raw.dtype} of shape {raw.shape}", "give 16-bit millimetres (PNG) or metres (.npy)"
        )
    return np.where(metres > 0, metres, np.nan).astype(np.float32)


def _check_size(path: Path, found: tuple[int, ...], expected: tuple[int, int]) -> None:
    if tuple(found) != expected:
        wanted = f"{expected[1]} x {expected[0]}"
        raise ConfigurationError(
            f"{path}: is {found[1]} x {found[0]} pixels, the camera is calibrated for {wanted}",
            "give a picture of the cell's camera, settings with the calibration of another camera (--cell), or "
            "--unit px for an unknown camera",
        )


def write_overlay(path: Path, perception: Perception, frame: CameraFrame) -> None:
    """Write the picture with the recognised garment drawn over it. Raises StorageError."""
    done, png = cv2.imencode(".png", draw_on_camera(perception, frame.rgb)[:, :, ::-1])
    if not done:
        raise AssertionError("the overlay could not be encoded")
    write_whole(path, png.tobytes())


def _refused(image: Path, unit: str, failure: Failure) -> dict[str, Any]:
    return {
        "image": str(image), "recognised": False, "accepted": False, "reason": str(failure.kind),
        "category": None, "confidence": 0.0, "keypoints": {}, "contour": [], "unit": unit, "failure": failure,
    }  # fmt: skip


def _figures(image: Path, perception: Perception, overlay: Path, unit: str) -> dict[str, Any]:
    state = perception.state
    metres = {"keypoints_m": state.keypoints} if unit == "m" else {}
    return {
        "image": str(image),
        "recognised": True,
        "accepted": True,
        "reason": None,
        "garment": perception.garment,
        "category": state.category,
        "confidence": state.confidence,
        "ambiguous": state.ambiguous,
        "unit": unit,
        "keypoints": _keypoints(perception, unit),
        "contour": _in_unit(perception, state.contour, unit),
        **metres,
        "overlay": str(overlay),
    }


def _keypoints(perception: Perception, unit: str) -> dict[str, Array]:
    return {name: _in_unit(perception, p, unit) for name, p in perception.state.keypoints.items()}


def _in_unit(perception: Perception, points: Array, unit: str) -> Array:
    """Points (..., 2) in the table frame [m], or for unit px in pixels of the picture (column, row)."""
    return points if unit == "m" else perception.view.to_image(points)


def _print(perception: Perception, overlay: Path, unit: str) -> None:
    state = perception.state
    print(f"{state.category} ({perception.garment}), confidence {state.confidence:.2f}")
    where = "in the table frame [m]" if unit == "m" else "in the picture [px, column and row]"
    print(f"key points {where}:")
    for name, (x, y) in _keypoints(perception, unit).items():
        print(f"  {name:<20} {x:+.3f} {y:+.3f}" if unit == "m" else f"  {name:<20} {x:8.1f} {y:8.1f}")
    print(f"overlay  {overlay}")
