"""Measures a folded garment as it lies: overlap with its target, heights, and layers. They are counted on a raster
of the cloth as seen from above.

Lengths in metres, table frame.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from foldcell.skills.compiled import cached
from foldcell.skills.fold_figures.folded_mesh import FoldedMesh, fold_mesh
from foldcell.skills.vocabulary import Array, FoldLine

PIXEL = 0.001  # of the raster [m]
CREASE_MARGIN = 0.040
"""Distance from a fold line within which cloth counts as beside the crease [m]."""


@dataclass(frozen=True)
class FoldFigures:
    """Figures of a folded garment. iou: overlap with the target seen from above; height: 95th percentile of the
    height away from the creases [m]; crease_height: the same beside the creases [m]; layers: 95th percentile of
    the number of layers of the target away from the creases."""

    iou: float
    height: float
    crease_height: float
    layers: float


def measure_fold(
    vertices: Array,
    triangles: NDArray[np.int32],
    material: Array,
    lines: Sequence[FoldLine],
) -> FoldFigures:
    """Measure a folded garment. vertices: (n, 3) where it lies [m]. material: (n, 2) its flat rest shape [m].
    lines: the lines about which it was folded."""
    folded = fold_mesh(material, triangles, lines, vertices)
    return measure_cut_fold(folded, folded.attributes)


def measure_cut_fold(folded: FoldedMesh, x: Array) -> FoldFigures:
    """Measure a mesh that is cut at the fold lines, with its vertices at x (n, 3) [m]."""
    grid = TableRaster.around(np.vstack([x[:, :2], folded.target]))
    top, _ = grid.render(x, folded.triangles)
    _, count = grid.render(np.column_stack([folded.target, np.zeros(len(x))]), folded.triangles)
    silhouette, wanted = np.isfinite(top), count > 0
    flat = grid.away_from(folded.creases, CREASE_MARGIN)
    return FoldFigures(
        iou=float((silhouette & wanted).sum() / (silhouette | wanted).sum()),
        height=_percentile(top, silhouette, flat),
        crease_height=_percentile(top, silhouette, ~flat),
        layers=_percentile(count, wanted, flat),
    )


def _percentile(image: NDArray[Any], silhouette: NDArray[np.bool_], part: NDArray[np.bool_]) -> float:
    """Return the 95th percentile over a part of the silhouette, or over the whole silhouette if that part is
    empty."""
    where = silhouette & part
    return float(np.percentile(image[where if where.any() else silhouette], 95.0))


@dataclass(frozen=True, eq=False)
class TableRaster:
    """A raster over the table. The centre of pixel (row, column) is at origin + PIXEL * (column, row)."""

    origin: Array
    shape: tuple[int, int]

    @classmethod
    def around(cls, xy: Array) -> TableRaster:
        low, high = xy.min(axis=0), xy.max(axis=0)
        columns, rows = np.ceil((high - low) / PIXEL).astype(int) + 3
        # the shift by half a pixel keeps axis-parallel cloth edges off pixel centres
        return cls(low - 0.5 * PIXEL, (int(rows), int(columns)))

    def pixels(self, xy: Array) -> Array:
        return (xy - self.origin) / PIXEL

    def render(self, xyz: Array, triangles: NDArray[np.int32]) -> tuple[Array, NDArray[np.int32]]:
        """Return the height of the upper surface (-inf without cloth) and the number of triangles at each
        pixel."""
        return rasterise(self.pixels(xyz[:, :2]), xyz[:, 2].copy(), triangles, *self.shape)

    def away_from(self, segments: Array, margin: float) -> NDArray[np.bool_]:
        """Return the mask of the pixels further than `margin` [m] from every segment (c, 2, 2)."""
        free = np.ones(self.shape, dtype=np.uint8)
        ends = np.rint(self.pixels(segments)).astype(np.int32)
        cv2.polylines(free, [*ends], False, (0.0,))
        if free.all():
            return free.astype(bool)
        return cv2.distanceTransform(free, cv2.DIST_L2, cv2.DIST_MASK_PRECISE) * PIXEL > margin


@cached()
def rasterise(
    xy: Array, z: Array, triangles: NDArray[np.int32], rows: int, columns: int
) -> tuple[Array, NDArray[np.int32]]:
    """Return the highest z and the number of triangles at each pixel centre. xy: vertices, in pixels. A pixel on a
    shared edge belongs to one triangle only."""
    top = np.full((rows, columns), -np.inf)
    count = np.zeros((rows, columns), dtype=np.int32)
    for t in range(len(triangles)):
        i, j, k = triangles[t, 0], triangles[t, 1], triangles[t, 2]
        area = (xy[j, 0] - xy[i, 0]) * (xy[k, 1] - xy[i, 1]) - (xy[j, 1] - xy[i, 1]) * (xy[k, 0] - xy[i, 0])
        if area == 0.0:
            continue
        if area < 0.0:
            j, k, area = k, j, -area
        left = max(0, int(np.ceil(min(xy[i, 0], xy[j, 0], xy[k, 0]))))
        right = min(columns - 1, int(np.floor(max(xy[i, 0], xy[j, 0], xy[k, 0]))))
        low = max(0, int(np.ceil(min(xy[i, 1], xy[j, 1], xy[k, 1]))))
        high = min(rows - 1, int(np.floor(max(xy[i, 1], xy[j, 1], xy[k, 1]))))
        for r in range(low, high + 1):
            for c in range(left, right + 1):
                wi = _edge(xy, j, k, c, r)
                wj = _edge(xy, k, i, c, r)
                wk = _edge(xy, i, j, c, r)
                if not (_covers(wi, xy, j, k) and _covers(wj, xy, k, i) and _covers(wk, xy, i, j)):
                    continue
                count[r, c] += 1
                height = (wi * z[i] + wj * z[j] + wk * z[k]) / area
                if height > top[r, c]:
                    top[r, c] = height
    return top, count


@cached(inline="always")
def _edge(xy: Array, a: int, b: int, x: float, y: float) -> float:
    return (xy[b, 0] - xy[a, 0]) * (y - xy[a, 1]) - (xy[b, 1] - xy[a, 1]) * (x - xy[a, 0])


@cached(inline="always")
def _covers(w: float, xy: Array, a: int, b: int) -> bool:
    """Whether the edge function w covers the pixel. A pixel on an edge belongs to one triangle (top-left rule)."""
    if w != 0.0:
        return w > 0.0
    dx, dy = xy[b, 0] - xy[a, 0], xy[b, 1] - xy[a, 1]
    return dy > 0.0 or (dy == 0.0 and dx < 0.0)
