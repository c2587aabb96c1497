"""Return the figures and draw the picture of a garment, for the commands that show it."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from foldcell.cell.commands.shared import write_drawing
from foldcell.skills.garments.garment import Garment


def draw_option(action: argparse.ArgumentParser) -> None:
    action.add_argument("--draw", type=Path, metavar="DIR", help="draw outline and folds as PNG into this folder")


def size(garment: Garment) -> str:
    return "{:.2f} x {:.2f}".format(*garment.size_m)


def figures(garment: Garment) -> dict[str, Any]:
    return {
        "name": garment.name,
        "title": garment.title,
        "category": garment.category,
        "layers": garment.layers,
        "size_m": garment.size_m,
        "keypoints_m": dict(zip(garment.keypoints, garment.template.tolist(), strict=True)),
        "material": garment.material,
        "surface": garment.surface,
        "folds": [step.name for step in garment.plan],
        "poses": garment.poses,
    }


def drawn(garment: Garment, folder: Path | None) -> str | None:
    """Write a PNG of outline, key points, fold lines and grasps into `folder`. Returns its path, or None if
    `folder` is None. Raises like `write_drawing`."""
    if folder is None:
        return None
    from foldcell.cell.config.garments.drawing import draw_garment

    return write_drawing(folder, f"{garment.name}-drawing", draw_garment(garment))
