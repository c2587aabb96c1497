"""`foldcell perceive IMAGE`: what the cell sees in a picture from its camera."""

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
"""Relative difference of sizes that nothing reaches."""
WIDTH, HEIGHT = 1.2, 2.0
"""Of the table in a photograph, and of the camera above it, when nothing is known of either [m]."""


def add_options(parser: argparse.ArgumentParser) -> None:
    parser.set_defaults(run=run)
    parser.add_argument("image", type=Path, metavar="IMAGE", help="colour picture from the cell's camera")
    parser.add_argument("--depth", type=Path, help="its depth: 16-bit PNG in millimetres, or .npy in metres")
    parser.add_argument("--garment", default="auto", metavar="G", help="what is expected, or auto (auto)")
    parser.add_argument("--reference", type=Path, metavar="EMPTY", help="picture of the empty table")
    parser.add_argument("--reference-depth", type=Path, metavar="D", help="depth of the empty table")
    parser.add_argument("--output", type=Path, metavar="PNG", help="the overlay (IMAGE-perceived.png)")
    parser.add_argument(
        "--unit", choices=["m", "px"], default="m", help="px: seen from above by an unknown camera (m)"
    )
    cell_option(parser)
    json_option(parser)


def run(options: argparse.Namespace) -> int:
    """0 with key points, 2 when no garment was recognised."""
    output = options.output or options.image.with_name(f"{options.image.stem}-perceived.png")
    seen, frame = look_at(options, options.garment)
    if seen.failure is not None:
        if options.json:
            print_json({**_refused(options.image, options.unit, seen.failure), "notes": seen.notes})
        else:
            print(f"not recognised: {seen.failure}")
        return 2
    perception = seen.unwrap()
    write_overlay(output, perception, frame)
    if options.json:
        print_json({**_figures(options.image, perception, output, options.unit), "notes": seen.notes})
    else:
        _print(perception, output, options.unit)
    return 0


def look_at(options: argparse.Namespace, garment: str) -> tuple[Outcome[Perception], CameraFrame]:
    """What is seen in the picture `options.image`, with what the options say of it, and the picture. garment: what
    is expected, or auto. Raises ConfigurationError for a file that cannot be used."""
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
    if options.depth is None:  # that there is none is the user's choice, not a broken camera
        thresholds = replace(thresholds, depth_holes=1.0)
    if options.unit == "px":  # nor how large it is
        thresholds = replace(thresholds, size_tolerance=ANY_SIZE)
    expected = None if garment == "auto" else garments[0].name
    return perceive(frame, calibration, table, empty, garments, expected, thresholds), frame


def _check_reference(options: argparse.Namespace) -> None:
    """A picture with depth is compared with an empty table's that has depth, too."""
    if options.reference is None and options.reference_depth is not None:
        raise ConfigurationError("--reference-depth without --reference", "give the empty table's picture as well")
    if None not in (options.reference, options.depth) and options.reference_depth is None:
        raise ConfigurationError(
            "--reference with --depth, but without --reference-depth",
            "give the empty table's depth as well, or leave out --reference or --depth",
        )


def photographed(shape: tuple[int, ...]) -> tuple[CameraCalibration, Table]:
    """A stand-in for a camera of which nothing is known, for a picture (rows, columns): straight above the table,
    the picture as wide as `WIDTH`. What it says in metres means nothing; in pixels it is right."""
    rows, columns = shape[:2]
    focal = HEIGHT * columns / WIDTH
    intrinsics = Intrinsics(columns, rows, focal, focal, (columns - 1) / 2, (rows - 1) / 2)
    T = np.array([[0.0, -1.0, 0.0, 0.0], [-1.0, 0.0, 0.0, 0.0], [0.0, 0.0, -1.0, HEIGHT], [0.0, 0.0, 0.0, 1.0]])
    half = 0.5 * WIDTH * rows / columns
    return CameraCalibration(intrinsics, frozen(T)), Table(0.0, (-half, half), (-0.5 * WIDTH, 0.5 * WIDTH))


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
        raise ConfigurationError(
            f"{path}: is no picture that can be read (PNG or JPEG)", "export or copy it anew", path=str(path)
        )
    return np.asarray(image)


def _read_depth(path: Path) -> NDArray[np.float32]:
    """(H, W) [m]: `.npy` in metres, otherwise a picture of 16 bits in millimetres; 0 is no measurement."""
    if path.suffix == ".npy":
        try:
            raw = np.load(path, allow_pickle=False)
        except (OSError, ValueError, EOFError) as e:
            raise ConfigurationError(f"{path}: is no array that can be read: {e}", path=str(path)) from e
        if not isinstance(raw, np.ndarray):
            raw.close()
            raise ConfigurationError(
                f"{path}: is no single array (an .npz holds several)", "save it with numpy.save", path=str(path)
            )
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
            "give a picture as the cell's camera takes it, a calibration of the camera that took it (--cell), or "
            "--unit px for a camera of which nothing is known",
        )


def write_overlay(path: Path, perception: Perception, frame: CameraFrame) -> None:
    """A picture of what was seen, drawn over what was looked at."""
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
    """Points (..., 2) [m], table frame, as they are, or in the picture's pixels (column, row)."""
    return points if unit == "m" else perception.view.to_image(points)


def _print(perception: Perception, overlay: Path, unit: str) -> None:
    state = perception.state
    print(f"{state.category} ({perception.garment}), confidence {state.confidence:.2f}")
    where = "in the table frame [m]" if unit == "m" else "in the picture [px, column and row]"
    print(f"key points {where}:")
    for name, (x, y) in _keypoints(perception, unit).items():
        print(f"  {name:<20} {x:+.3f} {y:+.3f}" if unit == "m" else f"  {name:<20} {x:8.1f} {y:8.1f}")
    print(f"overlay  {overlay}")
