"""`foldcell perceive IMAGE`: recognises the garment in a picture."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

import cv2

from cell.commands.options import cell_option, json_option
from cell.commands.output import print_json
from cell.config.cell_settings import load_settings
from cell.hardware.photograph import in_unit, perceive_photograph, read_photograph
from cell.support.files.whole_file import write_whole
from robots.errors import ConfigurationError, Failure
from robots.ports import Array, CameraFrame
from skills.perception.overlay import draw_on_camera
from skills.perception.perceive import Perception
from skills.vocabulary import Outcome

__all__ = ["add_options", "look_at", "run", "write_overlay"]


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
    """Recognise the garment and write the overlay. Returns 0 if a garment was recognised, 2 if none was. Raises
    ConfigurationError, StorageError."""
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
    """Recognise the garment in the picture `options.image`. garment: the expected garment, or auto. Returns the
    outcome and the picture as a camera frame. Raises ConfigurationError for a file that cannot be used."""
    _check_reference(options)
    settings = load_settings(options.cell)
    picture, empty = read_photograph(options.image, options.depth), None
    if options.reference is not None:
        empty = read_photograph(options.reference, options.reference_depth)
    return perceive_photograph(picture, empty, garment, options.unit, settings)


def _check_reference(options: argparse.Namespace) -> None:
    """Check that --reference and --reference-depth fit each other. Raises ConfigurationError for --reference-depth
    without --reference, and for --reference with --depth but without --reference-depth."""
    if options.reference is None and options.reference_depth is not None:
        raise ConfigurationError(
            "--reference-depth without --reference", "give the picture of the empty table too"
        )
    if None not in (options.reference, options.depth) and options.reference_depth is None:
        raise ConfigurationError(
            "--reference with --depth, but without --reference-depth",
            "give the depth of the empty table too, or leave out --reference or --depth",
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
        "contour": in_unit(perception, state.contour, unit),
        **metres,
        "overlay": str(overlay),
    }


def _keypoints(perception: Perception, unit: str) -> dict[str, Array]:
    return {name: in_unit(perception, p, unit) for name, p in perception.state.keypoints.items()}


def _print(perception: Perception, overlay: Path, unit: str) -> None:
    state = perception.state
    print(f"{state.category} ({perception.garment}), confidence {state.confidence:.2f}")
    where = "in the table frame [m]" if unit == "m" else "in the picture [px, column and row]"
    print(f"key points {where}:")
    for name, (x, y) in _keypoints(perception, unit).items():
        print(f"  {name:<20} {x:+.3f} {y:+.3f}" if unit == "m" else f"  {name:<20} {x:8.1f} {y:8.1f}")
    print(f"overlay  {overlay}")
