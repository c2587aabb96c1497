"""`foldcell garment list`: lists the shipped garments."""

from __future__ import annotations

import argparse

from foldcell.cell.commands.garment.garment_drawing import figures, size
from foldcell.cell.commands.shared import Commands, add_command, answer, cell_option, table
from foldcell.cell.config.cell_settings import load_settings
from foldcell.cell.config.garments.garment_file import list_garments, load_garment


def add_options(actions: Commands) -> None:
    action = add_command(actions, "list", "list the shipped garments with their sizes and folds", _run)
    cell_option(action)


def _run(options: argparse.Namespace) -> int:
    surface = load_settings(options.cell).surface
    garments = [load_garment(name, surface) for name in list_garments()]
    rows = [(g.name, g.title, g.category, size(g), g.layers, len(g.plan)) for g in garments]
    lines = table(("name", "title", "category", "x by y [m]", "layers", "folds"), rows)
    return answer(options, {"garments": [figures(g) for g in garments]}, lines)
