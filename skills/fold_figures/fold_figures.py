"""Measures a folded garment as it lies: overlap with its target, heights, and layers."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from foldcell.skills.fold_figures.folded_mesh import FoldedMesh, fold_mesh
from foldcell.skills.fold_figures.table_raster import TableRaster
from foldcell.skills.vocabulary import Array, FoldLine

__all__ = ["CREASE_MARGIN", "FoldFigures", "measure_cut_fold", "measure_fold"]

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
