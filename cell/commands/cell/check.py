"""`foldcell cell check`: checks whether table, camera and robot of the settings fit each other, and draws them."""

from __future__ import annotations

import argparse
from pathlib import Path

from foldcell.cell.commands.shared import Commands, add_command, answer, cell_option, table, write_drawing
from foldcell.cell.config.cell_settings import load_settings
from foldcell.cell.config.garments.garment_file import load_garment
from foldcell.cell.hardware.cell_check import cell_findings
from foldcell.cell.hardware.robot_model import load_robot


def add_options(actions: Commands) -> None:
    action = add_command(actions, "check", "check whether table, camera and robot fit each other", _run)
    action.add_argument("--draw", type=Path, metavar="DIR", help="draw the cell as cell.png into this folder")
    action.add_argument("--garment", metavar="GARMENT", help="name or file of a garment to draw on the table")
    cell_option(action)


def _run(options: argparse.Namespace) -> int:
    """Returns 0 if everything fits, 2 if not. Raises ConfigurationError for settings that cannot be used."""
    settings = load_settings(options.cell)
    garment = load_garment(options.garment, settings.surface) if options.garment else None
    findings = list(cell_findings(settings))
    good, drawing = all(finding.good for finding in findings), None
    if options.draw is not None:
        from foldcell.cell.hardware.cell_drawing import draw_cell

        words = [f"{'good' if f.good else 'BAD '}  {f.name}: {f.found}" for f in findings if f.name != "model"]
        pose = None if garment is None else garment.poses.middle
        picture = draw_cell(settings, load_robot(settings), garment, pose, words)
        drawing = write_drawing(options.draw, "cell", picture)
    rows = [(f.name, "good" if f.good else "BAD", f.found, f.key) for f in findings]
    drawn = [] if drawing is None else [f"drawn in {drawing}"]
    figures = {"good": good, "findings": [vars(f) for f in findings], "drawing": drawing}
    return answer(options, figures, [*table(("check", "", "found", "key"), rows), *drawn], 0 if good else 2)
