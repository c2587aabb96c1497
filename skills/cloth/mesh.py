"""Triangle mesh of a garment: built from its contour, with one layer or two welded layers.

The boundary is resampled at the edge length; corners keep their place. The interior points form a rotated,
jittered and relaxed hexagonal grid. The triangles are the Delaunay triangles (scipy) inside the contour (shapely).
The mesh is unstructured on purpose: creases would lock onto the rows of a structured grid.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import shapely
from numpy.typing import NDArray
from scipy.spatial import Delaunay

from foldcell.robots.errors import ConfigurationError
from foldcell.robots.ports import Array, frozen
from foldcell.skills.plane import cross, lengths_along

Index = NDArray[np.int32]

CORNER_TURN = np.deg2rad(10.0)  # a contour vertex that turns by more is a corner and keeps its place
SLIGHT_TURN = np.deg2rad(0.5)  # the same for a vertex between two long sides, as in a drawn outline
GRID_TURN = np.deg2rad(11.0)  # angle of the hexagonal grid to material x: no row is parallel to a hem
JITTER = 0.12  # largest random displacement of grid points along each axis, in edge lengths
TRANSITION = 2.0  # over this distance from a fine band, in its edge lengths, the edges become twice as long
HALVED = 1.4  # a border segment is halved if it is longer than this, in edge lengths
SEED = 20110520  # seed of the jitter, fixed so that a mesh depends only on the arguments


@dataclass(frozen=True, eq=False)
class ClothMesh:
    """A garment's mesh in material coordinates: the position of each vertex in the flat garment.

    rest: (n, 2) vertices [m]. layer: (n,) layer of each vertex, 0 on the table, 1 above it; vertices of the welded
    border count as 0. triangles: (m, 3) int32, counter-clockwise in layer 0 and clockwise in layer 1.
    triangle_layer: (m,) layer of each triangle. seam: (k, 2) border edges along which the layers are welded (empty
    for one layer).
    """

    rest: Array
    layer: Index
    triangles: Index
    triangle_layer: Index
    seam: Index

    @cached_property
    def area(self) -> Array:
        """(m,) areas of the triangles at rest [m2]."""
        a, b, c = (self.rest[self.triangles[:, k]] for k in range(3))
        return frozen(0.5 * np.abs(cross(b - a, c - a)))

    @cached_property
    def vertex_area(self) -> Array:
        """(n,) area of each vertex [m2]: a third of the areas of the triangles at the vertex."""
        out = np.zeros(len(self.rest))
        np.add.at(out, self.triangles.ravel(), np.repeat(self.area / 3.0, 3))
        return frozen(out)

    @cached_property
    def edges(self) -> Index:
        """(e, 2) vertices of each edge, lower index first; each edge occurs once."""
        return frozen(np.unique(np.sort(_half_edges(self.triangles), axis=1), axis=0).astype(np.int32))

    @cached_property
    def edge_length(self) -> Array:
        """(e,) lengths of the edges at rest [m]."""
        return frozen(np.linalg.norm(self.rest[self.edges[:, 0]] - self.rest[self.edges[:, 1]], axis=1))

    @cached_property
    def edge_area(self) -> Array:
        """(e,) sum of the areas of the triangles at each edge [m2]."""
        half = np.sort(_half_edges(self.triangles), axis=1)
        _, edge = np.unique(half, axis=0, return_inverse=True)
        return frozen(np.bincount(edge.ravel(), np.tile(self.area, 3)))

    @cached_property
    def hinges(self) -> Index:
        """(h, 4) vertices of each pair of triangles with a shared edge: the two ends of this edge, then the two
        opposite vertices. Only two triangles of the same layer form a hinge, because a welded border is sharp at
        rest and does not bend like a sheet."""
        return frozen(self._hinge_rows[:, :4].copy())

    @cached_property
    def hinge_length(self) -> Array:
        """(h,) rest lengths of the hinges' edges [m]."""
        return frozen(np.linalg.norm(self.rest[self.hinges[:, 1]] - self.rest[self.hinges[:, 0]], axis=1))

    @cached_property
    def hinge_triangles(self) -> Index:
        """(h, 2) the triangles of each hinge."""
        return frozen(self._hinge_rows[:, 4:].copy())

    @cached_property
    def _hinge_rows(self) -> Index:
        _, beside = triangle_sides(self, self.edges)
        layer = self.triangle_layer[beside]
        joined = (beside[:, 1] >= 0) & (layer[:, 0] == layer[:, 1])
        opposite = self.triangles[beside].sum(axis=2) - self.edges.sum(axis=1)[:, None]
        return np.column_stack([self.edges, opposite, beside])[joined].astype(np.int32)

    @cached_property
    def on_rim(self) -> NDArray[np.bool_]:
        """(e,) True for edges at which a layer ends: hems and seams, that is all edges without a hinge."""
        n = np.int64(len(self.rest))
        return frozen(~np.isin(self.edges @ [n, 1], np.sort(self.hinges[:, :2], axis=1) @ [n, 1]))

    @cached_property
    def border(self) -> Index:
        """(b,) vertices on the outline."""
        e, n = np.unique(
            np.sort(_half_edges(self.triangles[self.triangle_layer == 0]), axis=1), axis=0, return_counts=True
        )
        return frozen(np.unique(e[n == 1]).astype(np.int32))

    def lay_flat(self, thickness: float) -> Array:
        """Return (n, 3): positions of the garment laid flat on the table, its layers `thickness` [m] apart."""
        z = thickness * (0.5 + self.layer)
        return np.column_stack([self.rest, z])


@dataclass(frozen=True, eq=False)
class FineBands:
    """Bands of a finer mesh along creases. segments: (c, 2, 2) ends of the creases in material coordinates [m];
    width: distance from a crease up to which the mesh is fine [m]; edge_length: edge length within this distance
    [m]."""

    segments: Array
    width: float
    edge_length: float

    def coarsening(self, xy: Array, most: int) -> Index:
        """Return (n,) how often the edge length may be doubled at xy (n, 2), at most `most` times."""
        lines = shapely.union_all(shapely.linestrings(self.segments))
        away = np.maximum(shapely.distance(lines, shapely.points(xy)) - self.width, 0.0)
        doubled = np.ceil(np.log2(1.0 + away / (TRANSITION * self.edge_length)))
        return np.asarray(np.clip(doubled, 0, most), dtype=np.int32)


def mesh_from_contour(
    contour: Array, edge_length: float, layers: int = 1, rotate: float = 0.0, fine: FineBands | None = None
) -> ClothMesh:
    """Mesh the inside of `contour` (k, 2) [m] with edges of about `edge_length` [m].

    layers: 1, or 2 for two equal sheets welded along the whole outline. rotate: turns the interior grid [rad], for
    another mesh of the same garment. fine: bands with a finer mesh. The edge length elsewhere is then the edge
    length of the bands, doubled as often as it does not exceed `edge_length`. Raises ConfigurationError for a
    contour that is not a simple polygon of finite points, and for one too small for the edge length.
    """
    sizes = _Sizes.of(edge_length, fine)
    outline = _check(contour, sizes.coarsest)
    border = _split_border(_resample(outline, sizes.coarsest), sizes)
    polygon = shapely.Polygon(border)
    inner = _interior(polygon, edge_length, rotate) if fine is None else _graded(polygon, sizes, rotate)
    for _ in range(6):
        points = np.vstack([border, inner])
        tri = _triangulate(points, polygon)
        inner = _relax(points, tri, len(border), polygon, sizes)
    for _ in range(8):
        points = np.vstack([border, inner])
        tri = _triangulate(points, polygon)
        missing = _missing_border(tri, len(border))
        if not len(missing):
            break
        middles = 0.5 * (border[missing] + border[(missing + 1) % len(border)])
        border = np.insert(border, missing + 1, middles, axis=0)
        polygon = shapely.Polygon(border)
    else:
        raise ConfigurationError(
            "the contour is too narrow somewhere to be meshed",
            "use a shorter edge length",
            edge_length=edge_length,
        )
    if layers == 2:
        points, tri = _split_chords(points, tri, len(border), polygon)
    points, tri = _drop_unused(points, tri)
    return _layered(points, tri, layers)


@dataclass(frozen=True)
class _Sizes:
    """Edge lengths over the garment: `finest` doubled up to `most` times."""

    finest: float
    most: int
    fine: FineBands | None

    @classmethod
    def of(cls, edge_length: float, fine: FineBands | None) -> _Sizes:
        if fine is None or len(fine.segments) == 0 or fine.edge_length >= edge_length:
            return cls(edge_length, 0, None)
        return cls(fine.edge_length, int(np.log2(edge_length / fine.edge_length) + 1e-9), fine)

    @property
    def coarsest(self) -> float:
        return self.finest * 2.0**self.most

    def at(self, xy: Array) -> Array:
        """Return (n,) edge lengths at xy (n, 2) [m]."""
        if self.fine is None:
            return np.full(len(xy), self.finest)
        return np.asarray(self.finest * 2.0 ** self.fine.coarsening(xy, self.most), dtype=np.float64)


def edge_finder(edge: Index, n: int) -> Callable[[NDArray[np.integer], NDArray[np.integer]], Index]:
    """Return a function that returns the indices in `edge` (e, 2) of the edges between vertices i and j, both
    arrays of one shape. n: number of vertices."""
    keys = np.sort(edge, axis=1) @ [n, 1]
    order = np.argsort(keys)

    def between(i: NDArray[np.integer], j: NDArray[np.integer]) -> Index:
        at = np.searchsorted(keys, np.minimum(i, j).astype(np.int64) * n + np.maximum(i, j), sorter=order)
        return order[at].astype(np.int32)

    return between


def triangle_sides(mesh: ClothMesh, edge: Index) -> tuple[Index, Index]:
    """Return (t, 3) the edges of each triangle, and (e, 2) the triangles beside each edge, the lower index first,
    -1 where there is none."""
    tri = mesh.triangles
    tri_edge = edge_finder(edge, len(mesh.rest))(tri, tri[:, [2, 0, 1]])
    by_edge = np.argsort(tri_edge.ravel(), kind="stable")
    sides = np.bincount(tri_edge.ravel(), minlength=len(edge))  # one or two triangles beside an edge
    first = np.cumsum(sides) - sides
    beside = (by_edge // 3).astype(np.int32)
    edge_tri = np.full((len(edge), 2), -1, np.int32)
    edge_tri[:, 0] = beside[first]
    edge_tri[sides == 2, 1] = beside[first[sides == 2] + 1]
    return tri_edge, edge_tri


def _half_edges(tri: Index) -> Index:
    return np.concatenate([tri[:, [0, 1]], tri[:, [1, 2]], tri[:, [2, 0]]])


def _check(contour: Array, edge_length: float) -> Array:
    """Return the contour simplified, counter-clockwise and open. Raises ConfigurationError with the unsuitable
    values."""
    polygon = shapely.Polygon(contour)
    if not polygon.is_valid:
        raise ConfigurationError(
            f"the contour is not a simple polygon: {shapely.is_valid_reason(polygon)}",
            "it must not cross or touch itself",
        )
    if polygon.area < 2.0 * edge_length**2:
        raise ConfigurationError(
            "the contour is too small for the edge length", "", area_m2=polygon.area, edge_length=edge_length
        )
    simple = shapely.simplify(polygon, 0.04 * edge_length)
    c = np.asarray(simple.exterior.coords)[:-1]
    return c if simple.exterior.is_ccw else c[::-1]


def _resample(outline: Array, edge_length: float) -> Array:
    """Return the outline with about one point per edge length; corners keep their place."""
    back, ahead = outline - np.roll(outline, 1, axis=0), np.roll(outline, -1, axis=0) - outline
    turn = np.abs(np.arctan2(cross(back, ahead), (back * ahead).sum(axis=1)))
    sides = np.minimum(np.linalg.norm(back, axis=1), np.linalg.norm(ahead, axis=1))
    corners = np.flatnonzero((turn > CORNER_TURN) | ((turn > SLIGHT_TURN) & (sides > 1.5 * edge_length)))
    if len(corners) < 3:
        corners = np.unique(np.linspace(0, len(outline), 4, endpoint=False).astype(int))
    kept = [int(corners[0])]
    for i in corners[1:]:  # of corners closer than half an edge length, keep the first
        if np.linalg.norm(outline[i] - outline[kept[-1]]) >= 0.5 * edge_length:
            kept.append(int(i))
    if len(kept) > 3 and np.linalg.norm(outline[kept[-1]] - outline[kept[0]]) < 0.5 * edge_length:
        kept.pop()
    pieces = []
    n = len(outline)
    for a, b in zip(kept, [*kept[1:], kept[0] + n], strict=True):
        run = outline[np.arange(a, b + 1) % n]
        s = lengths_along(run)
        m = max(1, round(s[-1] / edge_length))
        at = np.linspace(0.0, s[-1], m, endpoint=False)
        pieces.append(np.column_stack([np.interp(at, s, run[:, k]) for k in range(2)]))
    return np.vstack(pieces)


def _interior(polygon: shapely.Polygon, edge_length: float, rotate: float) -> Array:
    """Return the points of a rotated, jittered hexagonal grid that are well inside the polygon."""
    x0, y0, x1, y1 = polygon.bounds
    centre, reach = np.array([x0 + x1, y0 + y1]) / 2.0, np.hypot(x1 - x0, y1 - y0) / 2.0 + edge_length
    k = int(np.ceil(reach / (edge_length * 0.85))) + 1
    i, j = np.meshgrid(np.arange(-k, k + 1), np.arange(-k, k + 1))
    grid = np.column_stack([(i + 0.5 * (j % 2)).ravel(), (j * np.sqrt(0.75)).ravel()]) * edge_length
    a = GRID_TURN + rotate
    grid = grid @ np.array([[np.cos(a), np.sin(a)], [-np.sin(a), np.cos(a)]])
    grid += np.random.default_rng(SEED).uniform(-JITTER, JITTER, grid.shape) * edge_length + centre
    return grid[_inside(polygon, grid, 0.62 * edge_length)]


def _graded(polygon: shapely.Polygon, sizes: _Sizes, rotate: float) -> Array:
    """Return the points of a hexagonal grid whose spacing follows `sizes`. Every second point of a row in every
    second row is again a hexagonal grid, of twice the spacing."""
    x0, y0, x1, y1 = polygon.bounds
    centre, reach = np.array([x0 + x1, y0 + y1]) / 2.0, np.hypot(x1 - x0, y1 - y0) / 2.0 + sizes.coarsest
    k = int(np.ceil(1.5 * reach / sizes.finest)) + 1
    i, j = (index.ravel() for index in np.meshgrid(np.arange(-k, k + 1), np.arange(-k, k + 1)))
    grid = np.column_stack([i + 0.5 * j, j * np.sqrt(0.75)]) * sizes.finest
    near = np.linalg.norm(grid, axis=1) <= reach
    i, j, grid = i[near], j[near], grid[near]
    a = GRID_TURN + rotate
    grid = grid @ np.array([[np.cos(a), np.sin(a)], [-np.sin(a), np.cos(a)]]) + centre
    size = sizes.at(grid)
    step = np.rint(size / sizes.finest).astype(int)
    kept = (i % step == 0) & (j % step == 0)
    grid, size = grid[kept], size[kept]
    grid = grid + np.random.default_rng(SEED).uniform(-JITTER, JITTER, grid.shape) * size[:, None]
    return grid[_inside(polygon, grid, 0.62 * size)]


def _split_border(border: Array, sizes: _Sizes) -> Array:
    """Halve the segments of the border (b, 2) that are longer than the edge length at their place."""
    for _ in range(sizes.most):
        ahead = np.roll(border, -1, axis=0)
        middles = 0.5 * (border + ahead)
        long = np.flatnonzero(np.linalg.norm(ahead - border, axis=1) > HALVED * sizes.at(middles))
        border = np.insert(border, long + 1, middles[long], axis=0)
    return border


def _inside(polygon: shapely.Polygon, xy: Array, margin: float | Array) -> NDArray[np.bool_]:
    points = shapely.points(xy)
    return shapely.contains(polygon, points) & (shapely.distance(polygon.exterior, points) >= margin)


def _triangulate(points: Array, polygon: shapely.Polygon) -> Index:
    tri = Delaunay(points).simplices.astype(np.int32)
    p = points[tri]
    area = 0.5 * cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0])
    longest = np.max([((p[:, k] - p[:, k - 1]) ** 2).sum(axis=1) for k in range(3)], axis=0)
    keep = (np.abs(area) > 1e-3 * longest) & shapely.contains(polygon, shapely.points(p.mean(axis=1)))
    tri = tri[keep]
    flip = area[keep] < 0
    tri[flip] = tri[flip][:, ::-1]
    return tri[np.lexsort(tri.T[::-1])]


def _relax(points: Array, tri: Index, n_border: int, polygon: shapely.Polygon, sizes: _Sizes) -> Array:
    """Move the interior points half way to the mean of their neighbours, and remove points too near the border."""
    total, count = np.zeros_like(points), np.zeros(len(points))
    half = _half_edges(tri)
    for a, b in ((0, 1), (1, 0)):
        np.add.at(total, half[:, a], points[half[:, b]])
        np.add.at(count, half[:, a], 1.0)
    inner = points[n_border:]
    moved = np.where(
        count[n_border:, None] > 0,
        0.5 * (inner + total[n_border:] / np.maximum(count[n_border:, None], 1.0)),
        inner,
    )
    return moved[_inside(polygon, moved, 0.5 * sizes.at(moved))]


def _missing_border(tri: Index, n_border: int) -> Index:
    """Return the indices i of border segments i -> i + 1 that are not an edge of a triangle."""
    have = {tuple(e) for e in np.sort(_half_edges(tri), axis=1).tolist()}
    return np.array(
        [i for i in range(n_border) if tuple(sorted((i, (i + 1) % n_border))) not in have], dtype=np.int32
    )


def _split_chords(points: Array, tri: Index, n_border: int, polygon: shapely.Polygon) -> tuple[Array, Index]:
    """Insert vertices in the middle of inner edges that join two border vertices. Two layers that are welded along
    the border would be one sheet at such an edge."""
    for _ in range(4):
        e, count = np.unique(np.sort(_half_edges(tri), axis=1), axis=0, return_counts=True)
        chords = e[(count == 2) & (e < n_border).all(axis=1)]
        if not len(chords):
            break
        points = np.vstack([points, points[chords].mean(axis=1)])
        tri = _triangulate(points, polygon)
    return points, tri


def _drop_unused(points: Array, tri: Index) -> tuple[Array, Index]:
    used, index = np.unique(tri, return_inverse=True)
    return points[used], index.reshape(tri.shape).astype(np.int32)


def _layered(points: Array, tri: Index, layers: int) -> ClothMesh:
    n = len(points)
    e, count = np.unique(np.sort(_half_edges(tri), axis=1), axis=0, return_counts=True)
    seam = e[count == 1].astype(np.int32)
    if layers == 1:
        zero = np.zeros(n, dtype=np.int32)
        return ClothMesh(
            frozen(points), frozen(zero), frozen(tri), frozen(np.zeros(len(tri), np.int32)), frozen(seam[:0])
        )
    border = np.zeros(n, dtype=bool)
    border[seam.ravel()] = True
    above = np.where(border, np.arange(n), n + np.cumsum(~border) - 1).astype(np.int32)
    upper = above[tri][:, ::-1]
    return ClothMesh(
        frozen(np.vstack([points, points[~border]])),
        frozen(np.concatenate([np.zeros(n, np.int32), np.ones(int((~border).sum()), np.int32)])),
        frozen(np.vstack([tri, upper]).astype(np.int32)),
        frozen(np.repeat(np.array([0, 1], np.int32), len(tri))),
        frozen(seam),
    )
