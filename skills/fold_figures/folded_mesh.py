"""The target of a plan: a flat mesh, cut along the fold lines and folded as a perfect isometry.

Lengths in metres, table frame.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from foldcell.skills.plane import cross
from foldcell.skills.vocabulary import Array, FoldLine, frozen

ON_LINE = 1e-7  # a vertex closer to a fold line than this counts as on the line, to avoid slivers [m]


@dataclass(frozen=True, eq=False)
class FoldedMesh:
    """A mesh cut along the fold lines and folded flat.

    attributes: (n', k) attributes of the cut mesh's vertices, interpolated from the given attributes. triangles:
    (m', 3). target: (n', 2) folded positions of the vertices. area: (m',) areas of the triangles in the rest shape
    [m2]. creases: (c, 2, 2) end points of the creases' segments in the target.
    """

    attributes: Array
    triangles: NDArray[np.int32]
    target: Array
    area: Array
    creases: Array


def fold_mesh(
    material: Array, triangles: NDArray[np.int32], lines: Sequence[FoldLine], attributes: Array
) -> FoldedMesh:
    """Cut a flat mesh (n, 2) along fold lines, fold it, and interpolate `attributes` (n, k).

    Each line refers to the garment as it lies before that fold, so a later line also cuts cloth that an earlier
    fold has moved.
    """
    rest_and_more = np.column_stack([material, attributes])
    y = np.array(material, dtype=float)
    corners = np.array(triangles, dtype=np.int32)
    crease_edges: list[NDArray[np.int64]] = []
    for line in lines:
        columns = np.column_stack([rest_and_more, y])
        columns, corners = _cut(columns, corners, line)
        rest_and_more, y = columns[:, :-2], columns[:, -2:]
        distance = _distance(line, y)
        y = np.where((distance > 0.0)[:, None], line.reflect(y), y)
    # creases are found in the finished mesh, because later lines cut the creases of earlier ones
    before = rest_and_more[:, :2]
    for line in lines:
        distance = _distance(line, before)
        crease_edges.append(_creases(corners, distance))
        before = np.where((distance > 0.0)[:, None], line.reflect(before), before)
    edges = np.concatenate(crease_edges) if crease_edges else np.empty((0, 2), dtype=np.int64)
    return FoldedMesh(
        frozen(rest_and_more[:, 2:]),
        frozen(corners),
        frozen(y),
        frozen(np.abs(doubled_area(rest_and_more[:, :2], corners)) / 2.0),
        frozen(y[edges]),
    )


def _distance(line: FoldLine, xy: Array) -> Array:
    d = line.signed_distance(xy)
    return np.where(np.abs(d) < ON_LINE, 0.0, d)


def _cut(columns: Array, triangles: NDArray[np.int32], line: FoldLine) -> tuple[Array, NDArray[np.int32]]:
    """Split the triangles that `line` crosses. The last two columns are the vertices' present positions."""
    d = _distance(line, columns[:, -2:])
    side = np.sign(d[triangles])
    crossed = (side.min(axis=1) < 0) & (side.max(axis=1) > 0)
    if not crossed.any():
        return columns, triangles
    vertices: list[Array] = []
    on_edge: dict[tuple[int, int], int] = {}

    def crossing(i: int, j: int) -> int:
        key = (min(i, j), max(i, j))
        if key not in on_edge:
            on_edge[key] = len(columns) + len(vertices)
            a, b = key
            u = d[a] / (d[a] - d[b])
            vertices.append((1.0 - u) * columns[a] + u * columns[b])
        return on_edge[key]

    pieces: list[tuple[int, int, int]] = []
    for triangle in triangles[crossed]:
        polygons: dict[float, list[int]] = {-1.0: [], 1.0: []}
        for i, j in zip(triangle, np.roll(triangle, -1), strict=True):
            i, j = int(i), int(j)
            for sign, polygon in polygons.items():
                if d[i] * sign >= 0.0:
                    polygon.append(i)
                if d[i] * d[j] < 0.0:
                    polygon.append(crossing(i, j))
        for polygon in polygons.values():
            pieces += [(polygon[0], polygon[k], polygon[k + 1]) for k in range(1, len(polygon) - 1)]
    return (
        np.vstack([columns, vertices]),
        np.vstack([triangles[~crossed], np.array(pieces, dtype=np.int32)]),
    )


def _creases(triangles: NDArray[np.int32], distance: Array) -> NDArray[np.int64]:
    """Return the edges (c, 2) on a fold line that separate moving from staying cloth."""
    side = np.sign(distance[triangles].sum(axis=1))
    edges = np.sort(triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2).astype(np.int64), axis=1)
    on_line = (distance[edges] == 0.0).all(axis=1)
    owner = np.repeat(side, 3)
    moving = {tuple(e) for e in edges[on_line & (owner > 0)]}
    staying = {tuple(e) for e in edges[on_line & (owner < 0)]}
    return np.array(sorted(moving & staying), dtype=np.int64).reshape(-1, 2)


def doubled_area(xy: Array, triangles: NDArray[np.int32]) -> Array:
    """Return twice the signed areas (m,) of the triangles [m2], for vertices xy (n, 2). The area of a triangle
    that lies upside down is negative."""
    a, b, c = np.moveaxis(xy[triangles], 1, 0)
    return cross(b - a, c - a)
