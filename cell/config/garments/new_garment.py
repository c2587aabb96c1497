"""Create the file of a user's garment from a known garment and an observed outline."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from foldcell.cell.config.garments.garment_file import FABRIC_FIELDS, garment_path, load_garment
from foldcell.cell.config.yaml_file import read_yaml
from foldcell.robots.errors import ConfigurationError
from foldcell.robots.ports import Array
from foldcell.skills.fold_plan.plan import plan_folds
from foldcell.skills.garments.garment import Garment, PoseRange

__all__ = ["check_plan", "new_garment_text"]


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
    with tempfile.TemporaryDirectory() as folder:
        trial = Path(folder) / f"{name}.yaml"
        trial.write_text(head + _dumped(data), encoding="utf-8")
        garment = load_garment(trial, surface)
    check_plan(name, garment)
    poses = fitting(garment)
    return head + _dumped(data if poses is None else data | {"poses": _written(poses)})


def check_plan(name: str, garment: Garment) -> None:
    """Check that the folds of the garment can be planned. Raises ConfigurationError if they cannot."""
    planned = plan_folds(garment.flat_state(*garment.poses.middle), garment)
    if planned.failure is not None:
        raise ConfigurationError(
            f"{name}: its folds cannot be planned: {planned.failure.what}", planned.failure.hint
        )


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
