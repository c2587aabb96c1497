"""`foldcell garment new IMAGE`: makes the file of a new garment from a photograph of it."""

from __future__ import annotations

import argparse
import re
import time
from importlib.metadata import version
from pathlib import Path

import numpy as np

from calibration.shear import clip_and_lowest
from cell.commands.options import Commands, add_command, cell_option, json_option
from cell.commands.output import print_json
from cell.commands.skill.perceive import look_at, write_overlay, write_refused
from cell.config.cell_settings import load_settings
from cell.config.garments.garment_file import load_garment
from cell.config.garments.new_garment import new_garment_text
from cell.hardware.placement import fitting_poses
from cell.hardware.robot_model import load_robot
from cell.support.files.whole_file import write_whole
from robots.errors import ConfigurationError
from skills.garments.fitted import fitted_template
from skills.garments.garment import Garment

__all__ = ["add_options", "run"]

HINT = "lay it flat and straight on a plain ground, photograph it from above, or give another garment with --like"
SHORTEST, LONGEST = 0.05, 3.0
"""Shortest and longest allowed --length [m]."""


def add_options(actions: Commands) -> None:
    new = add_command(actions, "new", "make the file of a new garment from a photograph of it", run)
    new.add_argument("image", type=Path, metavar="IMAGE", help="photograph from above of the garment, lying flat")
    new.add_argument("--like", required=True, metavar="GARMENT", help="name or file of one with the same folds")
    new.add_argument("--length", type=float, metavar="M", help="metres measured on it between two key points")
    new.add_argument("--between", metavar="A,B", help="these key points (the two farthest apart along the cloth)")
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
    surface = settings.surface
    like = load_garment(options.like, surface)
    pair = _measured(options, like)
    output = options.output or Path(f"{_name(options.image.stem)}.yaml")
    if output.exists() and not options.replace:
        raise ConfigurationError(f"{output} exists", "give another --output, or --replace to write over it")
    if output.suffix not in (".yaml", ".yml"):
        raise ConfigurationError(f"{output}: a garment file ends in .yaml", "give another --output")
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
    points = np.array([perception.state.keypoints[name] for name in like.keypoints])
    template = fitted_template(points, like.template, pair, options.length)
    title = options.title or output.stem.replace("_", " ").capitalize()
    made = f"foldcell {version('foldcell')}, {time.strftime('%Y-%m-%d')}"
    origin = f"Outline from {options.image.name} ({_scaled(options, like, pair)}), {made}"
    model = load_robot(settings)
    text = new_garment_text(
        options.like, output.stem, title, template, origin, surface,
        lambda garment: fitting_poses(garment, settings, model),
    )  # fmt: skip
    write_whole(output, text)
    write_overlay(overlay, perception, look.frame)
    size = np.ptp(template, axis=0)
    if options.json:
        print_json({
            "image": str(options.image), "recognised": True, "file": str(output), "overlay": str(overlay),
            "size_m": size, "confidence": perception.state.confidence,
            "keypoints_m": dict(zip(like.keypoints, template.tolist(), strict=True)),
        })  # fmt: skip
        return 0
    print(f"{title}: {size[0]:.3f} x {size[1]:.3f} m, {len(like.plan)} folds as {options.like}")
    print(f"file     {output}")
    print(f"overlay  {overlay}   (check the positions of the key points)")
    print(f"next     foldcell garment check {output} --draw .   then measure its fabric: foldcell calibrate")
    return 0


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
