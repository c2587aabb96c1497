"""`foldcell garment check`: checks garment files."""

from __future__ import annotations

import argparse

from cell.commands.garment.garment_drawing import draw_option, drawn
from cell.commands.options import Commands, add_command, cell_option, json_option
from cell.commands.output import print_json
from cell.config.cell_settings import load_settings
from cell.config.garments.garment_file import load_garment
from cell.config.garments.new_garment import check_plan
from robots.errors import ConfigurationError

__all__ = ["add_options"]


def add_options(actions: Commands) -> None:
    action = add_command(actions, "check", "check garment files, and draw them", _run)
    action.add_argument("garments", nargs="+", metavar="FILE", help="files or names")
    draw_option(action)
    cell_option(action)
    json_option(action)


def _run(options: argparse.Namespace) -> int:
    """Check every file, including that its plan can be made. Returns 0 if all files are valid, 64 otherwise."""
    surface, checked, bad = load_settings(options.cell).surface, [], 0
    for name in options.garments:
        try:
            garment = load_garment(name, surface)
            check_plan(name, garment)
            drawing = drawn(garment, options.draw)
            checked.append({"file": name, "good": True, "drawing": drawing})
            _say(
                options, f"{name}: good, {len(garment.plan)} folds" + (f", drawn in {drawing}" if drawing else "")
            )
        except ConfigurationError as e:
            bad += 1
            checked.append({"file": name, "good": False, "error": e.what, "hint": e.hint})
            _say(options, str(e) if str(e).startswith(name) else f"{name}: {e}")
    if options.json:
        print_json({"checked": checked})
    return 64 if bad else 0


def _say(options: argparse.Namespace, text: str) -> None:
    if not options.json:
        print(text)
