"""Folding as geometry: computes the exact isometry that a sequence of fold lines makes of a flat sheet.

Each fold mirrors all layers on the moving side of its line and puts them on top of the other side, upside down.
Points are given in material coordinates, so the same functions map key points, meshes and outlines.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np
import shapely
from numpy.typing import NDArray

from foldcell.skills.vocabulary import Array, FoldLine, Material, frozen

if TYPE_CHECKING:  # the render process needs no mesh, and importing it takes a second
    from foldcell.skills.cloth.mesh import ClothMesh

COVERED = 0.25
"""The open pads take a layer if it covers at least this share of their footprint."""
SPACING = 0.004
"""Distance between points on a crease [m]."""
TOUCH = 1e-6
"""A point up to this distance outside the sheet's edge counts as on the sheet [m], because reflections have
rounding errors."""


@dataclass(frozen=True, eq=False)
class FoldedPoints:
    """Points after the folds. positions: (n, 2) [m]. layers: (n,) int, number of layers beneath each point."""

    positions: Array
    layers: NDArray[np.int64]


def fold_xy(lines: Sequence[FoldLine], xy: Array) -> Array:
    """Fold material points (..., 2) along the lines, in order, and return their positions (..., 2) [m]."""
    return _trace(lines, xy)[0]


def fold_points(
    lines: Sequence[FoldLine],
    xy: Array,
    outline: Array | None = None,
    sheet: NDArray | None = None,
    sheets: int = 1,
) -> FoldedPoints:
    """Compute the positions of material points (n, 2) after the folds, and the number of layers beneath each.

    outline: (k, 2) polygon of the flat garment (default: the convex hull of the points). Layers are counted only
    within this polygon; a sleeve that is folded to a place beside the body therefore lies at the height of the
    table. sheets: number of layers of the flat garment. sheet: (n,) the layer of each point, 0 at the table.
    """
    xy = np.asarray(xy, dtype=float)
    sheet = np.zeros(len(xy), dtype=int) if sheet is None else np.asarray(sheet, dtype=int)
    polygon = shapely.MultiPoint(xy).convex_hull if outline is None else _polygon(outline)
    positions, moved = _trace(lines, xy)
    layers = np.zeros(len(xy), dtype=np.int64)
    pieces = _pieces(lines, polygon)
    keys = [tuple(by_line[i] for by_line in moved) for i in range(len(xy))]
    for own in set(keys):
        here = np.array([k == own for k in keys])
        for other, region in pieces.items():
            if _order(other) < _order(own):
                layers[here] += sheets * shapely.intersects_xy(region, *positions[here].T)
        upside_down = sum(own) % 2 == 1
        layers[here] += (sheets - 1 - sheet[here]) if upside_down else sheet[here]
    return FoldedPoints(frozen(positions), frozen(layers))


def layers_at(lines: Sequence[FoldLine], outline: Array, xy: Array, sheets: int = 1) -> int:
    """Number of layers of cloth at xy (2,) after the folds. outline: (k, 2) of the flat garment."""
    pieces = _pieces(lines, _polygon(outline))
    return sheets * sum(bool(shapely.intersects_xy(region, *xy)) for region in pieces.values())


def layers_under(lines: Sequence[FoldLine], outline: Array, footprint: Array, sheets: int = 1) -> int:
    """Count the layers that cover at least COVERED of the open pads' footprint (4, 2) [m].

    A single point would be less reliable near an edge, whose position is known to a few millimetres only.
    """
    pads = shapely.Polygon(footprint)
    pieces = _pieces(lines, _polygon(outline))
    under = [shapely.intersection(region, pads).area for region in pieces.values()]
    return sheets * sum(area >= COVERED * pads.area for area in under)


def silhouette(lines: Sequence[FoldLine], outline: Array) -> Array:
    """Return the outline (m, 2) of the folded garment seen from above. outline: (k, 2) of the flat garment."""
    region = shapely.union_all(list(_pieces(lines, _polygon(outline)).values())).simplify(2 * TOUCH)
    return np.array(max(shapely.get_parts(region), key=lambda g: g.area).exterior.coords)[:-1]


def nearest_moving(
    line: FoldLine, earlier: Sequence[FoldLine], outline: Array, xy: Array, beyond: float, inside: float
) -> Array:
    """Return xy (2,) if it lies on the part of the folded garment that moves over the line, at least `beyond` from
    the line. Otherwise, return the nearest place (2,) there that is also at least `inside` from the part's edge;
    xy, if there is none. outline: (k, 2) of the flat garment."""
    folded = shapely.union_all(list(_pieces(earlier, _polygon(outline)).values()))
    shifted = FoldLine(line.point + beyond * line.normal, line.direction)
    moving = _cut(folded, _half_plane(shifted, 4.0 * (1.0 + float(np.abs(folded.bounds).max()))))[1]
    if shapely.intersects_xy(moving, *xy):
        return xy
    inner = moving.buffer(-inside)
    return xy if inner.is_empty else shapely.get_coordinates(shapely.shortest_line(inner, shapely.Point(xy)))[0]


def target_vertices(mesh: ClothMesh, lines: Sequence[FoldLine], material: Material) -> Array:
    """Return the vertices (n, 3) of the ideal folded shape of a mesh: the isometry of its rest coordinates.

    Vertices lie in the middle of their layer, as in the simulation: z = (k + 1/2) x thickness for the k-th layer,
    counted from 0 at the table.
    """
    sheets = int(mesh.layer.max()) + 1
    folded = fold_points(lines, mesh.rest, outline_of(mesh), mesh.layer, sheets)
    return np.column_stack([folded.positions, (folded.layers + 0.5) * material.thickness])


def crease_segments(lines: Sequence[FoldLine], outline: Array) -> Array:
    """Return (c, 2, 2): the ends of the creases that the folds make, in the flat sheet's coordinates [m].

    A fold of several layers makes one crease in each layer. outline: (k, 2) of the flat garment."""
    found: list[Array] = []
    for i, line in enumerate(lines):
        reach = 4.0 * (1.0 + float(np.abs(outline).max()))
        cut = shapely.LineString([line.point - reach * line.direction, line.point + reach * line.direction])
        for history, region in _pieces(lines[:i], _polygon(outline)).items():
            for part in shapely.get_parts(region.intersection(cut)):
                if part.length > 2.0 * TOUCH:
                    ends = shapely.get_coordinates(part)[[0, -1]]
                    found.append(_unfolded(lines[:i], history, ends))
    return np.array(found).reshape(-1, 2, 2)


def folded_creases(lines: Sequence[FoldLine], outline: Array) -> Array:
    """Return (k, 2): points of all creases in the folded garment, at most SPACING apart along each crease [m].

    A later fold can fold an earlier crease, so a crease is sampled in the flat garment and its points are folded.
    outline: (n, 2) of the flat garment."""
    points = [np.zeros((0, 2))]
    for a, b in crease_segments(lines, outline):
        share = np.linspace(0.0, 1.0, 2 + int(np.linalg.norm(b - a) / SPACING))[:, None]
        points.append((1.0 - share) * a + share * b)
    return fold_xy(lines, np.concatenate(points))


def _unfolded(lines: Sequence[FoldLine], moved: Sequence[bool], xy: Array) -> Array:
    """Return the coordinates in the flat sheet of places xy (n, 2) on one piece of the folded sheet. moved: for
    each fold, whether it moved this piece."""
    for line, by_it in zip(reversed(lines), reversed(moved), strict=True):
        xy = line.reflect(xy) if by_it else xy
    return xy


def outline_of(mesh: ClothMesh) -> Array:
    """Return the silhouette (k, 2) of a mesh in rest coordinates."""
    triangles = np.asarray(mesh.rest, float)[mesh.triangles]
    return _outline(triangles.tobytes()).copy()


@lru_cache(maxsize=16)
def _outline(triangles: bytes) -> Array:
    """Return the silhouette (k, 2) of triangles (m, 3, 2). It is cached, because a search needs it in every
    simulation."""
    silhouette = shapely.union_all(shapely.polygons(np.frombuffer(triangles).reshape(-1, 3, 2)))
    parts = shapely.get_parts(silhouette)
    return np.array(max(parts, key=lambda g: g.area).exterior.coords)[:-1]


def _polygon(outline: Array) -> shapely.Geometry:
    return shapely.make_valid(shapely.Polygon(outline))


def _trace(lines: Sequence[FoldLine], xy: Array) -> tuple[Array, list[NDArray[np.bool_]]]:
    """Return the positions (..., 2) after the folds, and for each fold whether it moved each point (...)."""
    p, moved = np.array(xy, dtype=float), []
    for line in lines:
        moved.append(line.signed_distance(p) > 0)
        p = np.where(moved[-1][..., None], line.reflect(p), p)
    return p, moved


def _pieces(lines: Sequence[FoldLine], outline: shapely.Geometry) -> dict[tuple[bool, ...], shapely.Geometry]:
    """Divide the sheet at the fold lines. The key of a piece is its history: for each fold, whether the fold moved
    it. The value is its region after the folds, grown by TOUCH."""
    pieces: dict[tuple[bool, ...], shapely.Geometry] = {(): outline}
    reach = 4.0 * (1.0 + float(np.abs(outline.bounds).max()))
    for line in lines:
        half = _half_plane(line, reach)
        split: dict[tuple[bool, ...], shapely.Geometry] = {}
        for history, region in pieces.items():
            stays, moves = _cut(region, half)
            if stays.area > TOUCH**2:
                split[(*history, False)] = stays
            if moves.area > TOUCH**2:
                split[(*history, True)] = shapely.transform(moves, line.reflect)
        pieces = split
    return {history: region.buffer(TOUCH, join_style="mitre") for history, region in pieces.items()}


def _cut(region: shapely.Geometry, half: shapely.Geometry) -> tuple[shapely.Geometry, shapely.Geometry]:
    """Cut a region into the parts outside and inside a half-plane.

    If a fold line runs through corners of the garment, a region can contain lines and points besides areas.
    Shapely may fail to cut such a region. The cut then uses only its areas.
    """
    try:
        return region.difference(half), region.intersection(half)
    except shapely.errors.GEOSException:
        flat = [part for part in shapely.get_parts(region) if part.area > 0.0]
        areas = shapely.union_all(shapely.make_valid(np.array(flat)))
        return areas.difference(half), areas.intersection(half)


def _half_plane(line: FoldLine, reach: float) -> shapely.Polygon:
    along, across = reach * line.direction, reach * line.normal
    p = line.point
    return shapely.Polygon([p - along, p + along, p + along + across, p - along + across])


def _order(moved: tuple[bool, ...]) -> int:
    """Compute the position of a piece in the stack from the folds that moved it (one bool per fold). A fold puts
    the moving pieces on top of the others, in reversed order."""
    order, top = 0, 0
    for i, m in enumerate(moved):
        order = 2 * top + 1 - order if m else order
        top = 2 ** (i + 1) - 1
    return order
