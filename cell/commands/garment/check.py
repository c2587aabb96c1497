"""`foldcell garment check`: checks garment files."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

import numpy as np

from foldcell.cell.commands.garment.garment_drawing import draw_option, drawn
from foldcell.cell.commands.shared import (
    Commands,
    add_command,
    answer,
    cell_option,
    logs_option,
    refuse_drawing,
    write_drawing,
)
from foldcell.cell.config.cell_settings import CellSettings, load_settings
from foldcell.cell.config.garments.garment_file import load_garment
from foldcell.cell.hardware.cell_check import refuse_unfit_cell
from foldcell.cell.hardware.placement import (
    PlacedFold,
    fitting_pose,
    placed_folds,
    pose_that_folds,
    refuse_too_large,
)
from foldcell.cell.hardware.robot_model import load_robot
from foldcell.robots.errors import ConfigurationError
from foldcell.skills.garments.garment import Garment


def add_options(actions: Commands) -> None:
    action = add_command(actions, "check", "check garment files, predict their folds, and draw them", _run)
    action.add_argument("garments", nargs="+", metavar="FILE", help="files or names")
    draw_option(action)
    how = action.add_mutually_exclusive_group()
    how.add_argument(
        "--no-predictions", action="store_true", help="leave out the simulation of the folds, which takes a minute"
    )
    how.add_argument(
        "--optimise", action="store_true", help="optimise each fold as a run does, also if a stored arc is good"
    )
    logs_option(action)
    cell_option(action)


def _run(options: argparse.Namespace) -> int:
    """Check every file: it can be read, its plan can be made on this cell's table, and its folds are predicted to
    succeed. Returns 64 if a file cannot be used, else 2 if a fold of one is predicted to fail, else 0."""
    settings, checked = load_settings(options.cell), list[dict[str, Any]]()
    stems = [Path(name).stem for name in options.garments]
    if options.draw is not None and len(set(stems)) < len(stems):
        raise ConfigurationError(
            f"{', '.join(options.garments)}: two have one name, and so would their drawings",
            "check them one after the other, with two folders (--draw)",
        )
    refuse_unfit_cell(settings)
    for name in options.garments:
        try:
            checked.append(_checked(name, options, settings))
        except ConfigurationError as e:
            checked.append({"file": name, "good": False, "error": e.what, "hint": e.hint})
            _say(options, str(e) if str(e).startswith(name) else f"{name}: {e}")
    code = 0 if all(found["good"] for found in checked) else 2
    return answer(options, {"checked": checked}, (), 64 if any("error" in found for found in checked) else code)


def _checked(name: str, options: argparse.Namespace, settings: CellSettings) -> dict[str, Any]:
    """Check one file, and say what was found. Returns the figures for --json. Raises ConfigurationError for a file
    that cannot be used."""
    garment = load_garment(name, settings.surface)
    if options.draw is not None:
        for kind in ("drawing", "on-table", "predicted"):
            refuse_drawing(options.draw, f"{garment.name}-{kind}")
    drawing = drawn(garment, options.draw)
    placed = _drawn_on_table(garment, settings, options.draw)
    folds = _folds_on_table(name, garment, settings)
    pictures = [path for path in (drawing, placed) if path]
    # loaded only now, because perception takes a second to load, and a file is refused sooner
    from foldcell.cell.hardware.own_picture import own_picture_refused

    refused = own_picture_refused(garment, settings)
    words, good, predicted = list[str](), True, None
    if not options.no_predictions:
        # loaded only now, because the simulation takes seconds to load, and a file is refused sooner
        from foldcell.cell.commands.garment.prediction import draw_prediction, figures, lines, predict

        found = predict(options, garment, settings, folds)
        shown = draw_prediction(options, garment, settings, found)
        pictures += [shown] if shown else []
        words, good, predicted = lines(found), found.good, figures(found, shown)
    good = good and refused is None
    verdict = f"{'good' if good else 'will not go'}, {len(folds)} folds"
    _say(options, f"{name}: {verdict}" + (f", drawn in {', '.join(pictures)}" if pictures else ""))
    if refused is not None:
        _say(options, f"  not recognised in a drawing of itself on the table: {refused.what}\n    {refused.hint}")
    for fold in folds:
        if fold.why:
            _say(options, f"  {fold.name} is folded as {fold.variant}: {fold.why}")
    for line in words:
        _say(options, f"  {line}")
    return {
        "file": name, "good": good, "drawing": drawing, "on_table": placed, "unrecognised": refused,
        "variants": {fold.name: fold.variant for fold in folds}, "prediction": predicted,
    }  # fmt: skip


def _drawn_on_table(garment: Garment, settings: CellSettings, folder: Path | None) -> str | None:
    """Draw the garment on the cell's table as a PNG into the folder, and return its path; None without a
    folder."""
    if folder is None:
        return None
    from foldcell.cell.hardware.cell_drawing import draw_cell

    picture = draw_cell(settings, load_robot(settings), garment, garment.poses.middle)
    return write_drawing(folder, f"{garment.name}-on-table", picture)


def _folds_on_table(name: str, garment: Garment, settings: CellSettings) -> list[PlacedFold]:
    """Return how the arms make each fold at the garment's own pose. Raises ConfigurationError if the garment is
    too large, or if a fold cannot be made there."""
    refuse_too_large(garment, settings)
    model, pose = load_robot(settings), garment.poses.middle
    if fitting_pose(garment, settings) != pose:
        raise _not_there(name, "the garment is not wholly on the table and in the picture", garment, settings)
    folds = placed_folds(garment, settings, model, pose)
    for fold in folds:
        if not fold.variant:
            raise _not_there(name, f"fold {fold.name}: {fold.why}", garment, settings)
    return folds


def _not_there(name: str, why: str, garment: Garment, settings: CellSettings) -> ConfigurationError:
    x, y, angle = garment.poses.middle
    at = f"poses, in their middle (x {x:.2f}, y {y:.2f}, angle_deg {np.rad2deg(angle):.0f})"
    pose = pose_that_folds(garment, settings, load_robot(settings))
    hint = "no other pose on this table was found; make the garment smaller, or add a variant of the fold"
    if pose is not None:
        hint = f"it can be folded at x {pose[0]:.2f}, y {pose[1]:.2f}, angle_deg {np.rad2deg(pose[2]):.0f}"
    return ConfigurationError(f"{name}: {at}: {why}", hint)


def _say(options: argparse.Namespace, text: str) -> None:
    if not options.json:
        print(text)
