"""Inspections for tests: results of a fold that lies as predicted, with the changes that a test names, and what
pictures of folds are drawn with."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from foldcell.skills.perception.inspection.claim import Claim
from foldcell.skills.perception.inspection.result import Inspection
from foldcell.skills.perception.rectification.table_view import TableView
from foldcell.skills.vocabulary import Array


def on_table(view: TableView, height: float = 0.0) -> Array:
    """The places (H, W, 2) that the pixels of a view show at a height above the table [m]."""
    return view.to_table(np.dstack(np.mgrid[: view.shape[0], : view.shape[1]][::-1]), height)


def grid_triangles(shape: tuple[int, ...]) -> NDArray[np.int32]:
    """Triangles (m, 3) of a mesh whose vertices lie on a grid of this shape."""
    i = np.arange(np.prod(shape)).reshape(shape)
    a, b, c, d = (k.ravel() for k in (i[:-1, :-1], i[1:, :-1], i[1:, 1:], i[:-1, 1:]))
    return np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)]).astype(np.int32)


def inspection(**changes: Any) -> Inspection:
    good: dict[str, Any] = {
        "iou": 0.96, "iou_aligned": 0.97, "drift": np.zeros(2), "drift_about": np.zeros(2), "drift_m": 0.0,
        "drift_rad": 0.0, "height_m": 0.01, "extra_height_m": 0.0, "piled_area_m2": 0.0, "edge_deviation_m": 0.0,
        "edge_place": np.zeros(2), "missing_layer": 0.1, "edge": None, "left_behind": {}, "diagnosis": None,
        "confidence": 0.9, "contour": np.zeros((3, 2)), "mask": None, "predicted": None, "height": None,
        "view": None, "rgb": None,
    }  # fmt: skip
    return Inspection(**{**good, **changes})


def a_claim(**changes: Any) -> Claim:
    """A claim that holds, with the changes that a test names."""
    good: dict[str, Any] = {
        "shape": True, "flat": True, "reliability": 0.98, "height_m": 0.012, "height_limit_m": 0.020,
        "crease_height_m": 0.022, "crease_height_limit_m": 0.032, "camera_bias_m": 0.0025,
        "bending_length_m": 0.015, "target_iou": 0.97, "drift_m": 0.004, "drift_rad": 0.01,
        "says": "folded as planned, 12 mm high (at most 20 mm)",
    }  # fmt: skip
    return Claim(**{**good, **changes})
