"""`foldcell garment new IMAGE`: makes the file of a new garment from a photograph of it."""

from __future__ import annotations

import argparse
import re
import time
from collections.abc import Mapping
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

from foldcell.calibration.shear import clip_and_lowest
from foldcell.cell.commands.shared import (
    Commands,
    add_command,
    answer,
    cell_option,
    check_garment_output,
    page_options,
)
from foldcell.cell.commands.skill.perceive import depth_options, doubts, look_at, write_refused
from foldcell.cell.config.cell_settings import CellSettings, load_settings
from foldcell.cell.config.garments.garment_file import load_garment
from foldcell.cell.config.garments.key_points_file import read_checked_key_points
from foldcell.cell.hardware.photograph import Photograph, picture_measure, read_photograph
from foldcell.cell.support.files.encoded_picture import write_png
from foldcell.cell.support.files.whole_file import PNG_MARK, refuse_foreign
from foldcell.robots.errors import ConfigurationError
from foldcell.robots.ports import Array
from foldcell.skills.garments.garment import Garment
from foldcell.skills.garments.picture_measure import PictureMeasure
from foldcell.skills.perception.drawing import draw_on_camera, draw_overlay

HINT = (
    "lay it flat and straight on a plain ground, photograph it from above, give another garment with --like, or "
    "place its key points by hand: on a page (--edit), or in a file (--key-points)"
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
    new.add_argument("--edit", action="store_true", help="serve a page to place or correct the key points by hand")
    page_options(new)
    new.add_argument("--title", help="title of the garment")
    new.add_argument("--output", type=Path, metavar="FILE", help="garment file to write (IMAGE's name, here)")
    new.add_argument("--replace", action="store_true", help="write over a file that exists")
    depth_options(new)
    new.add_argument(
        "--unit", choices=["m", "px"], default="px", help="m: photographed by the cell's own camera (px)"
    )
    cell_option(new)


def run(options: argparse.Namespace) -> int:
    """Find the garment's key points in the photograph, or let a person place them, and write its file. Returns 0
    if the file was written, 2 if no garment like the given one was recognised or the person cancelled.

    Raises ConfigurationError for wrong arguments, StorageError if a file cannot be written.
    """
    settings = load_settings(options.cell)
    like = load_garment(options.like, settings.surface)
    pair = _measured(options, like)
    output = _output(options)
    check_garment_output(output, options.replace)
    if options.edit or options.key_points is not None:
        refuse_foreign(_points_picture(output), PNG_MARK)
    if options.edit:
        return _from_page(options, settings, like, pair, output)
    if options.key_points is not None:
        return _from_key_points(options, settings, like, pair, output)
    overlay = output.with_name(f"{output.stem}-perceived.png")
    refuse_foreign(overlay, PNG_MARK)
    look = look_at(options, options.like)
    if (failure := look.outcome.failure) is not None:
        write_refused(overlay, look)
        hint = failure.hint if look.sought is None else HINT  # key points do not mend a picture
        figures = {
            "image": str(options.image), "recognised": False, "reason": failure.what, "hint": hint,
            "missing": look.missing(options.unit), "overlay": str(overlay),
        }  # fmt: skip
        lines = [
            f"not recognised as {options.like}: {failure.what}\n  {hint}",
            f"overlay  {overlay}   ({look.shows})",
        ]
        return answer(options, figures, lines, 2)
    perception = look.outcome.unwrap()
    write_png(overlay, draw_on_camera(perception, look.frame.rgb))
    points = np.array([perception.state.keypoints[name] for name in like.keypoints])
    template = _write(options, settings, points, pair, f"({_scaled(options, like, pair)})")
    found = {"recognised": True, "confidence": perception.state.confidence, "doubts": doubts(perception)}
    return _say(options, like, template, output, overlay, found)


def _from_key_points(
    options: argparse.Namespace, settings: CellSettings, like: Garment, pair: tuple[int, int] | None, output: Path
) -> int:
    """Make the file from key points that a person has read off the photograph."""
    photograph = read_photograph(options.image, None)
    measure = picture_measure(photograph, settings, pair, options.length)
    pixels, doubts = read_checked_key_points(options.key_points, like, measure)
    overlay, template = _by_hand(options, settings, like, photograph, measure, pixels)
    found = {"recognised": False, "doubts": [f"{doubt.what}: {doubt.hint}" for doubt in doubts]}
    return _say(options, like, template, output, overlay, found)


def _from_page(
    options: argparse.Namespace, settings: CellSettings, like: Garment, pair: tuple[int, int] | None, output: Path
) -> int:
    """Make the file from key points that a person places on a page, and write these to a file, too."""
    from foldcell.cell.commands.garment.edit import edited, write_key_points

    kept = output.with_name(f"{output.stem}-key-points.yaml")
    if kept.exists() and not options.replace and kept != options.key_points:
        hint = f"go on with it (--key-points {kept}), or give --replace to write over it"
        raise ConfigurationError(f"{kept} exists", hint)
    look = look_at(options, options.like)
    photograph = read_photograph(options.image, None)
    measure = picture_measure(photograph, settings, pair, options.length)
    made: list[tuple[Path, Array]] = []

    def save(points: Mapping[str, Array]) -> str:
        pixels = np.array([points[name] for name in like.keypoints])
        made.append(_by_hand(options, settings, like, photograph, measure, pixels))
        write_key_points(kept, dict(zip(like.keypoints, pixels, strict=True)), options.image)
        return str(output)

    if not edited(options, _title(options), like, photograph, measure, look, kept, save):
        figures = {"image": str(options.image), "recognised": look.outcome.ok, "reason": "cancelled", "hint": ""}
        return answer(options, figures, ["cancelled: no garment was written"], 2)
    overlay, template = made[-1]
    found = {"recognised": look.outcome.ok, "key_points_file": str(kept)}
    return _say(options, like, template, output, overlay, found)


def _by_hand(
    options: argparse.Namespace,
    settings: CellSettings,
    like: Garment,
    photograph: Photograph,
    measure: PictureMeasure,
    pixels: Array,
) -> tuple[Path, Array]:
    """Write the garment's file from key points (k, 2) [px], and a picture of them. Returns the picture's path and
    the template (k, 2) [m]."""
    overlay = _points_picture(_output(options))
    named = dict(zip(like.keypoints, pixels, strict=True))
    write_png(overlay, draw_overlay(photograph.rgb, None, pixels, named, f"{_title(options)}, by hand"))
    how = f"by hand ({_scaled(options, like, measure.measured)})"
    return overlay, _write(options, settings, measure.to_laid(pixels), measure.measured, how)


def _points_picture(output: Path) -> Path:
    return output.with_name(f"{output.stem}-key-points.png")


def _write(
    options: argparse.Namespace, settings: CellSettings, points: Array, pair: tuple[int, int] | None, how: str
) -> Array:
    """Write the garment's file. points: key points in the laid pose. how: the way in which they were found, in
    words. Returns its template."""
    # loaded only now, because kinematics take seconds to load, and a picture is refused sooner
    from foldcell.cell.hardware.placement import write_own_garment

    made = f"foldcell {version('foldcell')}, {time.strftime('%Y-%m-%d')}"
    return write_own_garment(
        _output(options), options.like, _title(options), points, pair, options.length,
        f"Outline from {options.image.name} {how}, {made}", settings,
    )  # fmt: skip


def _say(
    options: argparse.Namespace, like: Garment, template: Array, output: Path, overlay: Path, found: dict[str, Any]
) -> int:
    """Print the figures and files of the new garment. found: further entries of the JSON object. Returns 0."""
    size = np.ptp(template, axis=0)
    figures = {
        "image": str(options.image), **found, "file": str(output), "overlay": str(overlay), "size_m": size,
        "keypoints_m": dict(zip(like.keypoints, template.tolist(), strict=True)),
    }  # fmt: skip
    kept = [f"points   {found['key_points_file']}   (--key-points reads it)"] if "key_points_file" in found else []
    lines = [
        f"{_title(options)}: {size[0]:.3f} x {size[1]:.3f} m, {len(like.plan)} folds as {options.like}",
        f"file     {output}",
        f"overlay  {overlay}   (check the positions of the key points)",
        *kept,
        *(f"doubt    {doubt}" for doubt in found.get("doubts", [])),
        f"next     foldcell garment check {output} --draw .   (will its folds go?)",
        "         then measure its fabric: foldcell calibrate",
    ]
    return answer(options, figures, lines)


def _output(options: argparse.Namespace) -> Path:
    # a name in the style of the shipped garment files
    name = re.sub(r"[^a-z0-9]+", "_", options.image.stem.lower()).strip("_")
    return options.output or Path(f"{name or 'garment'}.yaml")


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
