"""Create the file of a user's garment from a known garment and an observed outline."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from foldcell.cell.config.garments.garment_file import FABRIC_FIELDS, garment_path, load_garment, parse_garment
from foldcell.cell.config.yaml_file import read_yaml
from foldcell.robots.ports import Array
from foldcell.skills.garments.garment import Garment, PoseRange


def new_garment_text(
    like: str,
    name: str,
    title: str,
    template: Array,
    origin: str,
    surface: str,
    fitting: Callable[[Garment], PoseRange | None],
) -> str:
    """Return the text of a garment file with the folds and the fabric of the garment `like`, and the key points
    `template` (k, 2) [m]. fitting: returns the poses at which the cell can fold a garment; if None, the file keeps
    those of `like`.

    All fabric values are marked as assumed, because they belong to another garment. origin: a line that states the
    origin of the outline. Raises ConfigurationError if the folds cannot be planned on this outline.
    """
    data = dict(read_yaml(garment_path(like), "garment file").data)
    fabric = {k: v for k, v in data.get("material", {}).items() if k not in ("measured", "hang_drop")}
    fabric |= {
        "stretch_fraction": round(load_garment(like, surface).material.stretch_fraction, 5),  # stretch of a strip
        "assumed": list(FABRIC_FIELDS),
    }
    points = {n: [round(float(v), 4) for v in p] for n, p in zip(data["keypoints"], template, strict=True)}
    data |= {"title": title, "keypoints": points, "material": fabric}
    head = f"# {origin}\n# Folds and fabric are those of {like}: measure the fabric (foldcell calibrate).\n"
    poses = fitting(parse_garment(Path(f"{name}.yaml"), head + _dumped(data), surface))
    return head + _dumped(data if poses is None else data | {"poses": _written(poses)})


def _written(poses: PoseRange) -> dict[str, list[float]]:
    """Return the poses as a garment file states them: lengths [m], and the angle in degrees."""
    return {
        "x": [round(v, 3) for v in poses.x],
        "y": [round(v, 3) for v in poses.y],
        "angle_deg": [round(float(np.rad2deg(v)), 1) for v in poses.angle],
    }


def _dumped(data: Mapping[str, Any]) -> str:
    """Return YAML text with points and short lists on one line, as in the shipped files."""
    return yaml.safe_dump(dict(data), sort_keys=False, allow_unicode=True, default_flow_style=None, width=115)
