"""Model of a pinch: finds the cloth that two closing pads grasp. This cloth is a line of material, about which the
other cloth can turn.

The pads close along the tool's y axis over `stroke` and draw cloth from anywhere in the stroke to the middle,
where they hold it along the tool's x axis over `width`. They take every layer between the fingertips (the tool
centre point) and the upper end of the pads, `depth` above the fingertips. A hand that is lowered less takes fewer
layers. `stroke`, `width` and `depth` are fields of `PadGeometry`. Layers are not selected in any other way, with
one exception: in the prediction of a repair, the hands take only the cloth of a `Patch`, because real hands let go
if they feel other layers.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from foldcell.robots.ports import Array

if TYPE_CHECKING:  # the render process needs no mesh, and importing it takes a second
    from foldcell.skills.cloth.mesh import ClothMesh

PRESSED = 0.8  # share of the distance between layers that remains between the pads


@dataclass(frozen=True)
class PadGeometry:
    """Geometry and friction of the two pads: width along the tool's x, stroke (opening before closing) along its
    y, depth along -z [m].

    friction: Coulomb coefficient of pad on cloth; the two pads bear 2 * friction * grip force before the cloth
    slips out. samples: number of held points per layer along the width. compliance: of one held point [m/N].
    """

    width: float = 0.020
    stroke: float = 0.030
    depth: float = 0.015
    friction: float = 0.8
    samples: int = 5
    compliance: float = 1e-4


@dataclass(frozen=True, eq=False)
class Patch:
    """A part of the garment: the cloth that lay at most `radius` [m] from `centre` (2,) when the vertices of the
    mesh lay at `lay` (n, 2), seen from above, table frame [m]."""

    lay: Array
    centre: Array
    radius: float

    def contains(self, vertex: NDArray[np.int32], bary: Array) -> NDArray[np.bool_]:
        """Whether points belong to the patch (k,). vertex, bary: (k, 3) vertices of the triangle around each
        point, and its barycentric coordinates."""
        lay = np.einsum("kc,kci->ki", bary, self.lay[vertex])
        return np.asarray(np.linalg.norm(lay - self.centre, axis=1) <= self.radius)


@dataclass(frozen=True)
class PinchReport:
    """Result of a pinch. held_points: number of held points, 0 if the pads closed on nothing; layers: largest
    number of layers at one place along the width."""

    held_points: int
    layers: int


@dataclass(frozen=True, eq=False)
class PinchedPoints:
    """Points of the cloth between the pads. vertex, bary: (m, 3) vertices of the triangle around each point, and
    its barycentric coordinates; offset: (m, 3) positions of the points in the tool frame when the pads met them
    [m]; layers: largest number of held layers at one place along the width."""

    vertex: NDArray[np.int32]
    bary: Array
    offset: Array
    layers: int

    @property
    def height(self) -> Array:
        """(m,) tool z at which the points are held [m]. It differs from the z of `offset`, because the pads press
        the layers onto each other. The stack can then turn about the held line (held_cloth.py)."""
        middle = float(self.offset[:, 2].mean()) if len(self.offset) else 0.0
        return middle + PRESSED * (self.offset[:, 2] - middle)

    @property
    def report(self) -> PinchReport:
        return PinchReport(len(self.offset), self.layers)


def find_pinched(
    mesh: ClothMesh,
    positions: Array,
    position: Array,
    rotation: Array,
    pads: PadGeometry,
    thickness: float,
    patch: Patch | None = None,
) -> PinchedPoints:
    """Find the material points between the pads of a tool at `position` (3,), `rotation` (3, 3) R_table_tool.
    patch: the only cloth that the pads take; None: any."""
    q = (positions - position) @ rotation
    lo, hi = q[mesh.triangles].min(axis=1), q[mesh.triangles].max(axis=1)
    half = np.array([0.5 * pads.width, 0.5 * pads.stroke])
    near = (lo[:, :2] <= half).all(axis=1) & (hi[:, :2] >= -half).all(axis=1)
    near &= (hi[:, 2] >= -pads.depth) & (lo[:, 2] <= 0.5 * thickness)
    found: list[tuple[int, Array, Array]] = []
    layers = 0
    for x in np.linspace(-half[0], half[0], pads.samples):
        taken = _along_stroke(mesh, q, np.flatnonzero(near), float(x), half[1], pads.depth, 0.5 * thickness, patch)
        layers = max(layers, len(taken))
        found += taken
    if not found:
        return PinchedPoints(np.zeros((0, 3), np.int32), np.zeros((0, 3)), np.zeros((0, 3)), 0)
    tri, bary, offset = zip(*found, strict=True)
    return PinchedPoints(mesh.triangles[list(tri)], np.array(bary), np.array(offset), layers)


def _along_stroke(
    mesh: ClothMesh,
    q: Array,
    near: NDArray[np.intp],
    x: float,
    reach: float,
    depth: float,
    below: float,
    patch: Patch | None,
) -> list[tuple[int, Array, Array]]:
    """Cut the cloth with the plane x = `x` of the tool frame. Find, for each layer in this plane, the point
    nearest to the middle of the stroke. Returns (triangle, bary, offset) for each layer."""
    candidates = []
    for t in near:
        p = q[mesh.triangles[t]]
        ends = []
        for k in range(3):
            a, b = p[k], p[(k + 1) % 3]
            if (a[0] - x) * (b[0] - x) < 0.0:
                s = (x - a[0]) / (b[0] - a[0])
                bary = np.zeros(3)
                bary[k], bary[(k + 1) % 3] = 1.0 - s, s
                ends.append(bary)
        if len(ends) != 2:
            continue
        y0, y1 = ends[0] @ p[:, 1], ends[1] @ p[:, 1]
        s = float(np.clip(-y0 / (y1 - y0), 0.0, 1.0)) if y1 != y0 else 0.5
        bary = (1.0 - s) * ends[0] + s * ends[1]
        point = bary @ p
        meant = patch is None or patch.contains(mesh.triangles[[t]], bary[None])[0]
        if abs(point[1]) <= reach and -depth <= point[2] <= below and meant:
            candidates.append((abs(float(point[1])), float(point[2]), int(t), bary, point))
    taken: list[tuple[int, Array, Array]] = []
    rest: list[tuple[int, Array]] = []
    for _, _, t, bary, point in sorted(candidates, key=lambda c: c[:3]):
        material, layer = bary @ mesh.rest[mesh.triangles[t]], int(mesh.triangle_layer[t])
        again = any(
            layer == other_layer
            and np.linalg.norm(material - other) <= 1.5 * np.linalg.norm(point - offset) + 0.003
            for (other_layer, other), (_, _, offset) in zip(rest, taken, strict=True)
        )
        if not again:
            taken.append((t, bary, point))
            rest.append((layer, material))
    return taken
