"""The ground truth of a simulated cell, for scorers, the ground truth recorder and scripted faults only."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from foldcell.cell.simulation.faults import Fault
from foldcell.robots.ports import Intrinsics, Side
from foldcell.skills.vocabulary import Array, Material

if TYPE_CHECKING:  # the render process needs no solver, and importing it takes a second
    from foldcell.cell.simulation.garment.cloth_body import BodyTraits
    from foldcell.skills.cloth.mesh import ClothMesh


@dataclass(frozen=True, eq=False)
class GarmentTruth:
    """The garment on the table. Lengths [m], table frame.

    vertices: (n, 3) present positions. material: (n, 2) the flat rest shape in the pose in which it was laid.
    keypoints: name -> (2,) true key points of that shape. pose: x, y [m], angle [rad]. fabric: the true material.
    mesh: its rest shape is in the garment's own frame. traits: further properties of the cloth; solver: 'xpbd' or
    'mujoco'.
    """

    name: str
    vertices: Array
    material: Array
    keypoints: Mapping[str, Array]
    pose: tuple[float, float, float]
    fabric: Material
    layers: int
    mesh: ClothMesh
    traits: BodyTraits
    solver: str

    @property
    def triangles(self) -> NDArray[np.int32]:
        """The triangles (m, 3) of the mesh."""
        return self.mesh.triangles

    @property
    def thickness(self) -> float:
        """Thickness of one layer [m]."""
        return self.fabric.thickness


@dataclass(frozen=True, eq=False)
class Truth:
    """The truth at cell time `stamp` [s]. garment: None before a garment is laid. tools: tool centre points (3,),
    table frame [m]. held: whether a hand holds cloth. faults: (cell time, fault) of past faults. T_table_camera:
    (4, 4). table_height: height of the top in the base frame [m]. intrinsics: the camera's true intrinsics
    [px]."""

    stamp: float
    garment: GarmentTruth | None
    tools: Mapping[Side, Array]
    held: Mapping[Side, bool]
    faults: tuple[tuple[float, Fault], ...]
    T_table_camera: Array
    table_height: float
    intrinsics: Intrinsics
