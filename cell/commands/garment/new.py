"""`foldcell garment new IMAGE`: makes the file of a new garment from a photograph of it."""

from __future__ import annotations

import argparse
import re
import time
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

from calibration.shear import clip_and_lowest
from cell.commands.options import Commands, add_command, cell_option, json_option
from cell.commands.output import print_json
from cell.commands.skill.perceive import look_at, write_overlay, write_picture, write_refused
from cell.config.cell_settings import CellSettings, load_settings
from cell.config.garments.garment_file import load_garment
from cell.config.garments.key_points_file import read_key_points
from cell.support.files.picture_file import read_picture
from robots.errors import ConfigurationError
from robots.ports import Array
from skills.garments.garment import Garment
from skills.perception.overlay import draw_overlay

__all__ = ["add_options", "run"]

HINT = (
    "lay it flat and straight on a plain ground, photograph it from above, give another garment with --like, or "
    "give its key points in pixels with --key-points"
)
SHORTEST, LONGEST = 0.05, 3.0
"""Shortest and longest allowed --length [m]."""


def add_options(actions: Commands) -> None:
    new = add_command(actions, "new", "make the file of a new garment from a photograph of it", run)
    new.add_argument("image", type=Path, metavar="IMAGE", help="photograph from above of the garment, lying flat")
    new.add_argument("--like", required=True, metavar="GARMENT", help="name or file of one with the same folds")
    new.add_argument("--length", type=float, metavar="M", help="metres measured on it between two key points")
    new.add_argument("--between", metavar="A,B", help="these key points (the two farthest apart along the cloth)")
    new.add_argument(
        "--key-points",
        type=Path,
        metavar="FILE",
        help="key points read off the IMAGE by hand: YAML or JSON, name: [column, row]",
    )
    new.add_argument("--title", help="title of the garment")
    new.add_argument("--output", type=Path, metavar="FILE", help="garment file to write (IMAGE's name, here)")
    new.add_argument("--replace", action="store_true", help="write over a file that exists")
    new.add_argument("--depth", type=Path, help="depth of the image: 16-bit PNG in millimetres, or .npy in metres")
    new.add_argument("--reference", type=Path, metavar="EMPTY", help="picture of the empty table")
    new.add_argument("--reference-depth", type=Path, metavar="D", help="depth of the empty table")
    new.add_argument(
        "--unit", choices=["m", "px"], default="px", help="m: photographed by the cell's own camera (px)"
    )
    cell_option(new)
    json_option(new)


def run(options: argparse.Namespace) -> int:
    """Recognise the garment in the photograph and write its file. Returns 0 if the file was written, 2 if no
    garment like the given one was recognised.

    Raises ConfigurationError for wrong arguments, StorageError if a file cannot be written.
    """
    settings = load_settings(options.cell)
    like = load_garment(options.like, settings.surface)
    pair = _measured(options, like)
    output = _output(options)
    if output.exists() and not options.replace:
        raise ConfigurationError(f"{output} exists", "give another --output, or --replace to write over it")
    if output.suffix not in (".yaml", ".yml"):
        raise ConfigurationError(f"{output}: a garment file ends in .yaml", "give another --output")
    if options.key_points is not None:
        return _from_key_points(options, settings, like, pair, output)
    look = look_at(options, options.like)
    overlay = output.with_name(f"{output.stem}-perceived.png")
    if (failure := look.outcome.failure) is not None:
        write_refused(overlay, look)
        if options.json:
            print_json({
                "image": str(options.image), "recognised": False, "reason": failure.what, "hint": HINT,
                "overlay": str(overlay),
            })  # fmt: skip
        else:
            print(f"not recognised as {options.like}: {failure.what}\n  {HINT}")
            print(f"overlay  {overlay}   (what was taken for the garment)")
        return 2
    perception = look.outcome.unwrap()
    write_overlay(overlay, perception, look.frame)
    points = np.array([perception.state.keypoints[name] for name in like.keypoints])
    template = _write(options, settings, points, pair, f"({_scaled(options, like, pair)})")
    found = {"recognised": True, "confidence": perception.state.confidence}
    return _say(options, like, template, output, overlay, found)


def _from_key_points(
    options: argparse.Namespace, settings: CellSettings, like: Garment, pair: tuple[int, int] | None, output: Path
) -> int:
    """Make the file from key points that a person has read off the photograph, and draw them into it."""
    from cell.hardware.own_garment import as_laid

    if pair is None:
        raise ConfigurationError("--key-points with --unit m", "key points are in pixels: give --length instead")
    picture = read_picture(options.image)
    points = read_key_points(options.key_points, like, picture.shape[1], picture.shape[0])
    overlay = output.with_name(f"{output.stem}-key-points.png")
    named = dict(zip(like.keypoints, points, strict=True))
    write_picture(overlay, draw_overlay(picture, None, points, named, f"{_title(options)}, by hand"))
    template = _write(options, settings, as_laid(points), pair, f"by hand ({_scaled(options, like, pair)})")
    return _say(options, like, template, output, overlay, {"recognised": False})


def _write(
    options: argparse.Namespace, settings: CellSettings, points: Array, pair: tuple[int, int] | None, how: str
) -> Array:
    """Write the garment's file. points: as laid; how: they were found. Returns its template."""
    # loaded only now, because kinematics take seconds to load, and a picture is refused sooner
    from cell.hardware.own_garment import write_own_garment

    made = f"foldcell {version('foldcell')}, {time.strftime('%Y-%m-%d')}"
    return write_own_garment(
        _output(options), options.like, _title(options), points, pair, options.length,
        f"Outline from {options.image.name} {how}, {made}", settings,
    )  # fmt: skip


def _say(
    options: argparse.Namespace, like: Garment, template: Array, output: Path, overlay: Path, found: dict[str, Any]
) -> int:
    """Print what was made. found: what the recognition says, for the JSON object. Returns 0."""
    size = np.ptp(template, axis=0)
    if options.json:
        print_json({
            "image": str(options.image), **found, "file": str(output), "overlay": str(overlay), "size_m": size,
            "keypoints_m": dict(zip(like.keypoints, template.tolist(), strict=True)),
        })  # fmt: skip
        return 0
    print(f"{_title(options)}: {size[0]:.3f} x {size[1]:.3f} m, {len(like.plan)} folds as {options.like}")
    print(f"file     {output}")
    print(f"overlay  {overlay}   (check the positions of the key points)")
    print(f"next     foldcell garment check {output} --draw .   then measure its fabric: foldcell calibrate")
    return 0


def _output(options: argparse.Namespace) -> Path:
    return options.output or Path(f"{_name(options.image.stem)}.yaml")


def _title(options: argparse.Namespace) -> str:
    return options.title or _output(options).stem.replace("_", " ").capitalize()


def _measured(options: argparse.Namespace, like: Garment) -> tuple[int, int] | None:
    """Return the indices of the two key points between which the operator measured --length; None for the cell's
    camera, which measures sizes itself."""
    if options.unit == "m":
        if options.length is not None or options.between is not None:
            raise ConfigurationError(
                "the cell's camera knows the garment's size", "leave --length and --between out, or give --unit px"
            )
        return None
    pair = clip_and_lowest(like.template, like.keypoints)
    if options.between is not None:
        names = options.between.split(",")
        unknown = [name for name in names if name not in like.keypoints]
        if unknown or len(set(names)) != 2:
            raise ConfigurationError(
                f"--between {options.between}: two key points of {options.like} are expected, as A,B",
                f"it has {', '.join(like.keypoints)}",
            )
        pair = (like.keypoints.index(names[0]), like.keypoints.index(names[1]))
    between = f"{like.keypoints[pair[0]]} and {like.keypoints[pair[1]]}"
    if options.length is None:
        raise ConfigurationError(
            "a photograph does not show how large the garment is",
            f"measure it from {between} and give --length in metres (or other points: --between A,B)",
        )
    if not SHORTEST <= options.length <= LONGEST:
        raise ConfigurationError(
            f"--length {options.length:g} is no length of a garment", f"give {SHORTEST:g} to {LONGEST:g} metres"
        )
    return pair


def _scaled(options: argparse.Namespace, like: Garment, pair: tuple[int, int] | None) -> str:
    if pair is None:
        return "the cell's camera"
    return f"{like.keypoints[pair[0]]} to {like.keypoints[pair[1]]}: {options.length:g} m"


def _name(stem: str) -> str:
    """Return a file name in the style of the shipped garment files."""
    return re.sub(r"[^a-z0-9]+", "_", stem.lower()).strip("_") or "garment"
