"""Inspection results for tests: a fold that lies as predicted, with the changes that a test names."""

from __future__ import annotations

from typing import Any

import numpy as np

from skills.perception.inspection.result import Inspection

__all__ = ["inspection"]


def inspection(**changes: Any) -> Inspection:
    good: dict[str, Any] = {
        "iou": 0.96, "iou_aligned": 0.97, "drift": np.zeros(2), "drift_about": np.zeros(2), "drift_m": 0.0,
        "drift_rad": 0.0, "height_m": 0.01, "extra_height_m": 0.0, "piled_area_m2": 0.0, "edge_deviation_m": 0.0,
        "edge_place": np.zeros(2), "missing_layer": 0.1, "edge": None, "left_behind": {}, "diagnosis": None,
        "confidence": 0.9, "contour": np.zeros((3, 2)), "mask": None, "predicted": None, "height": None,
        "view": None, "rgb": None,
    }  # fmt: skip
    return Inspection(**{**good, **changes})
