"""Return the figures and draw the picture of a garment, for the commands that show it."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from cell.support.files.whole_file import write_whole
from robots.errors import ConfigurationError
from skills.garments.garment import Garment

__all__ = ["draw_option", "drawn", "figures", "size"]


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
    `folder` is None. Raises ConfigurationError if the folder does not exist, StorageError if the file cannot be
    written."""
    if folder is None:
        return None
    if not folder.is_dir():
        raise ConfigurationError(
            f"{folder}: there is no such folder", "create it, or give another one with --draw"
        )
    import cv2

    from cell.config.garments.drawing import draw_garment

    done, png = cv2.imencode(".png", draw_garment(garment)[:, :, ::-1])
    if not done:
        raise AssertionError("a drawing could not be encoded")
    path = folder / f"{garment.name}.png"
    write_whole(path, png.tobytes())
    return str(path)
