"""What is really so in a simulated cell: for the scorer and the record of truth, and for nobody else."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cell.simulation.faults import Fault
from robots.ports import Intrinsics, Side
from skills.vocabulary import Array, Material

__all__ = ["GarmentTruth", "Truth"]


@dataclass(frozen=True, eq=False)
class GarmentTruth:
    """The garment that was laid. Everything in the table frame.

    vertices: (n, 3) now. triangles: (m, 3). material: (n, 2) the flat rest shape in the pose in which it was laid.
    keypoints: name -> (2,) where that shape has the garment file's key points. pose: x, y [m], angle [rad].
    """

    name: str
    vertices: Array
    triangles: NDArray[np.int32]
    material: Array
    keypoints: Mapping[str, Array]
    pose: tuple[float, float, float]
    fabric: Material
    layers: int

    @property
    def thickness(self) -> float:
        """Of one layer [m]."""
        return self.fabric.thickness


@dataclass(frozen=True, eq=False)
class Truth:
    """garment: None while none was laid. tools: where each tool centre point is (3,), table frame. held: whether
    a hand has cloth. faults: (cell time, fault) of those that happened. T_table_camera: (4, 4). table_height: of
    the top in the base frame [m]. intrinsics: of the camera's lens."""

    stamp: float
    garment: GarmentTruth | None
    tools: Mapping[Side, Array]
    held: Mapping[Side, bool]
    faults: tuple[tuple[float, Fault], ...]
    T_table_camera: Array
    table_height: float
    intrinsics: Intrinsics
