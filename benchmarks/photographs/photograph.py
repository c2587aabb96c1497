"""A drawn photograph with what is true in it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from benchmarks.photographs.canvas import Canvas
from benchmarks.photographs.lens import Camera
from benchmarks.photographs.noise import Field
from benchmarks.photographs.outline import Points


@dataclass(frozen=True, eq=False)
class Garment:
    """What lies on the table [m]. template: the shipped garment that its owner would name. keypoints: none where
    the picture has to be refused."""

    template: str
    category: str
    outline: Points
    keypoints: dict[str, Points]


@dataclass(frozen=True, eq=False)
class Photograph:
    """picture: (rows, columns, 3) uint8, red first. mask: the cloth on the canvas. stated:
    whether the perception may be told the garment."""

    seed: int
    picture: np.ndarray
    garment: Garment
    camera: Camera
    stated: bool
    details: dict[str, Any]
    canvas: Canvas
    mask: Field

    @property
    def truth(self) -> dict[str, Any]:
        names = list(self.garment.keypoints)
        table = np.array([self.garment.keypoints[name] for name in names]).reshape(-1, 2)
        return {
            "seed": self.seed,
            "category": self.garment.category,
            "garment": self.garment.template,
            "keypoints_m": dict(zip(names, table.tolist(), strict=True)),
            "keypoints_px": dict(zip(names, self.camera.pixels(table).tolist(), strict=True)),
            "table_to_undistorted_pixels": self.camera.homography.tolist(),
            "distortion_k1": self.camera.k1,
            "stated": self.stated,
            **self.details,
        }
