# mypy: allow-untyped-defs, allow-incomplete-defs
"""Resolves lasting intersections by intersection contour minimisation (Volino & Magnenat-Thalmann 2006, Resolving
Surface Collisions through Intersection Contour Minimization).

Contacts hold every pair on its remembered side. Where neighbouring pairs remember different sides, the cloth is
locked in an intersection that no contact undoes. Two sheets intersect along a contour. If an edge passes through a
triangle (a crossing), there is a direction in which the edge has to move relative to the triangle so that the
contour gets shorter. Neighbouring crossings are given a common direction. The sides of the pairs involved are set
according to this direction, and the contacts then separate the sheets. The edge and the triangle are also moved
apart a little along this direction, since there may be no pair between them. The method does not need to know an
inside or outside of the cloth.

Cloth without intersections is not changed. Crossings that contacts undo within some frames, like most crossings of
a fast pinch, are left to the contacts, which have more information. Cloth that fell asleep with an intersection
keeps it until the cloth wakes.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from foldcell.skills.cloth.inner import inner
from foldcell.skills.cloth.intersections.crossings import crosses
from foldcell.skills.cloth.simd.aligned_arrays import Table, named_arrays, zeros
from foldcell.skills.cloth.simd.vec3 import cross, dot, load

STEP = 0.1  # x thickness: how far an examination moves the edge and the triangle of a crossing apart
PATIENCE = 3  # number of examinations for which a crossing is left to the contacts
SLANT = 0.2  # lower bound, in the gradient, of the sine of the angle between an edge and its triangle
GLANCE = 4  # frames between examinations while there are no crossings; otherwise every frame is examined
REACH = 1.5  # x thickness: if a vertex is nearer than this to a triangle, its edges are examined
FAINT = 0.05  # directions shorter than this are ignored, since flat parts that cross have no direction
MOST = 512  # largest number of crossings that are resolved together; other crossings wait


_INTERSECTIONS: Table = {
    "found": (np.int64, 1),
    "cross": (np.int32, MOST, 2),
    "age": (np.int32, "n"),
    "old": (np.int32, MOST, 2),
    "way": (float, MOST, 3),
    "wish": (float, "n", 3),
}
Intersections = named_arrays("Intersections", _INTERSECTIONS, __name__)
"""Results of the examinations. found: (1,) number of crossings at the last examination (MOST at most); cross:
(MOST, 2) edges and the triangles that they pass through; the first found[0] rows are valid. age: (n,) number
of consecutive examinations at which a vertex was part of a crossing. Scratch: old: (MOST, 2) crossings that
are being resolved; way: (MOST, 3) directions in which their edges should move relative to the triangles, table
frame, without unit; wish: (n, 3) sums of unit directions at the vertices."""


def no_intersections(vertices: int) -> Any:
    return Intersections(**zeros(_INTERSECTIONS, n=vertices))


@inner()
def resolve_intersections(body, pairs, intersections, n_vt, n_ee, soon, x, w, thickness):
    """Find crossings among the pairs that are due by the substep `soon`, and resolve those that have lasted for
    some examinations. x: (n, 4) positions; w: (n,) inverse masses, 0 for sleeping vertices; thickness [m]."""
    n = _find(
        soon, n_vt, pairs.vt.view(np.uint32), pairs.vt_due, n_ee, pairs.ee.view(np.uint32), pairs.near,
        body.tri.view(np.uint32), body.edge.view(np.uint32), body.edge_tri, body.ring_start,
        body.ring.view(np.uint32), body.ring_edge.view(np.uint32), x, REACH * thickness, intersections.cross
    )  # fmt: skip
    if n == 0 and intersections.found[0] == 0:
        return
    intersections.found[0] = n
    _grow_older(n, intersections.cross, body.edge, body.tri, intersections.age)
    old, way, edge, tri = intersections.old, intersections.way, body.edge, body.tri
    m = 0
    for c in range(n):
        e, t = intersections.cross[c, 0], intersections.cross[c, 1]
        if _oldest(edge[e], tri[t], intersections.age) > PATIENCE:
            old[m, 0], old[m, 1] = e, t
            shorten(x, edge[e], body.edge_tri[e], tri, t, way[m])
            m += 1
    _agree(m, old, edge, tri, way, intersections.wish)
    for c in range(m):
        e, t = old[c, 0], old[c, 1]
        if way[c, 0] ** 2 + way[c, 1] ** 2 + way[c, 2] ** 2 > FAINT**2:
            _put_vertices(n_vt, pairs.vt, pairs.side, pairs.vt_j, edge[e], t, tri, x, way[c])
            _put_edges(n_ee, pairs.ee, pairs.near, pairs.normal, pairs.ee_j, e, body.tri_edge[t], way[c])
            _pull(x, w, edge[e], tri[t], STEP * thickness, way[c])


@inner(error_model="numpy", fastmath={"contract"})
def _agree(n, cross, edge, tri, way, wish):
    """Give neighbouring crossings a common direction: the sum of the directions of all crossings with a common
    vertex. A direction is subtracted if the vertex belongs to the edge of one crossing and to the triangle of the
    other."""
    for c in range(n):
        e, t = cross[c, 0], cross[c, 1]
        for d in range(3):
            for m in range(2):
                wish[edge[e, m], d] = 0.0
            for m in range(3):
                wish[tri[t, m], d] = 0.0
    for c in range(n):
        e, t = cross[c, 0], cross[c, 1]
        size = np.sqrt(way[c, 0] * way[c, 0] + way[c, 1] * way[c, 1] + way[c, 2] * way[c, 2])
        if size < FAINT:
            continue
        for d in range(3):
            g = way[c, d] / size
            for m in range(2):
                wish[edge[e, m], d] += g
            for m in range(3):
                wish[tri[t, m], d] -= g
    for c in range(n):
        e, t = cross[c, 0], cross[c, 1]
        for d in range(3):
            i, j, p, q, r = edge[e, 0], edge[e, 1], tri[t, 0], tri[t, 1], tri[t, 2]
            way[c, d] = wish[i, d] + wish[j, d] - wish[p, d] - wish[q, d] - wish[r, d]


@inner(error_model="numpy", fastmath={"contract"})
def _find(soon, n_vt, vt, vt_due, n_ee, ee, near, tri, edge, edge_tri, start, ring, ring_edge, x, reach, found):
    """Find crossings: of the edges at a vertex with a triangle near the vertex, and of each edge of a near pair
    with the triangles beside the other edge. Returns their number."""
    n, one = 0, np.uint64(1)
    for c in range(np.uint64(n_vt)):
        if vt_due[c] > soon:
            continue
        i, t = vt[c, 0], vt[c, 1]
        corner = load(x, tri[t, 0])
        normal = cross(load(x, tri[t, 1]) - corner, load(x, tri[t, 2]) - corner)
        d = dot(normal, load(x, i) - corner)
        if d * d > reach * reach * dot(normal, normal):
            continue
        for a in range(np.uint64(start[i]), np.uint64(start[i + one])):
            if d * dot(normal, load(x, ring[a]) - corner) <= 0.0:
                n = _add(n, ring_edge[a], t, edge, tri, x, found)
    for c in range(n_ee):
        if not near[c]:
            continue
        for m in range(2):
            e, f = ee[c, m], ee[c, 1 - m]
            for k in range(2):
                if edge_tri[f, k] >= 0:
                    n = _add(n, e, edge_tri[f, k], edge, tri, x, found)
    return n


@inner()
def _add(n, e, t, edge, tri, x, cross):
    i, j = edge[e, 0], edge[e, 1]
    p, q, r = tri[t, 0], tri[t, 1], tri[t, 2]
    if n == len(cross) or i in (p, q, r) or j in (p, q, r):
        return n
    if not crosses(x, i, j, p, q, r):
        return n
    for c in range(n):
        if cross[c, 0] == e and cross[c, 1] == t:
            return n
    cross[n, 0], cross[n, 1] = e, t
    return n + 1


@inner()
def _grow_older(n, cross, edge, tri, age):
    """Increment the age of the vertices of crossings, and set the age of all other vertices to 0."""
    for c in range(n):
        e, t = cross[c, 0], cross[c, 1]
        for m in range(5):
            v = edge[e, m] if m < 2 else tri[t, m - 2]
            if age[v] >= 0:
                age[v] = -age[v] - 1
    for v in range(len(age)):
        age[v] = -age[v] if age[v] < 0 else 0


@inner()
def _oldest(edge, tri, age):
    return max(max(age[edge[0]], age[edge[1]]), max(age[tri[0]], max(age[tri[1]], age[tri[2]])))


@inner(error_model="numpy", fastmath={"contract"})
def _put_vertices(n, pair, side, memory, edge, t, tri, x, way):
    """Set the side of both ends of the edge to the side of triangle t towards which the edge should move."""
    normal = np.empty(3)
    _normal(x, tri[t, 0], tri[t, 1], tri[t, 2], normal)
    up = way[0] * normal[0] + way[1] * normal[1] + way[2] * normal[2]
    right = 1 if up > 0.0 else -1
    for c in range(n):
        if pair[c, 1] == t and (pair[c, 0] == edge[0] or pair[c, 0] == edge[1]) and side[c] != right:
            side[c] = right
            memory[c, 0] = memory[c, 1] = memory[c, 2] = 0.0


@inner(error_model="numpy", fastmath={"contract"})
def _pull(x, w, edge, tri, step, way):
    """Move the middles of the edge (2,) and the triangle (3,) apart by `step` [m]. Velocities and the centre of
    mass do not change."""
    total, size = 0.0, 0.0
    for m in range(2):
        total += 0.25 * w[edge[m]]
    for m in range(3):
        total += w[tri[m]] / 9.0
        size += way[m] * way[m]
    if total == 0.0 or size < 1e-12:
        return
    far = step / (np.sqrt(size) * total)
    for m in range(5):
        v = edge[m] if m < 2 else tri[m - 2]
        share = 0.5 * w[v] * far if m < 2 else -w[v] * far / 3.0
        for d in range(3):
            x[v, d] += share * way[d]


@inner(error_model="numpy", fastmath={"contract"})
def _put_edges(n, pair, near, normal, memory, e, sides, way):
    """In the pairs of edge e with the triangle's edges, `sides` (3,), set the side to the one towards which e
    should move."""
    for c in range(n):
        if not near[c]:
            continue
        first = pair[c, 0] == e
        other = pair[c, 1] if first else pair[c, 0]
        if not (first or pair[c, 1] == e) or (other != sides[0] and other != sides[1] and other != sides[2]):
            continue
        lean = normal[c, 0] * way[0] + normal[c, 1] * way[1] + normal[c, 2] * way[2]
        if (lean < 0.0) == first:
            for m in range(3):
                normal[c, m] = -normal[c, m]
                memory[c, m] = 0.0


@inner(error_model="numpy", fastmath={"contract"})
def shorten(x, edge, beside, tri, t, way):
    """Write to `way` (3,) the direction in which an edge (2,) has to move against triangle t to shorten the
    contour: the sum over the triangles `beside` the edge (2,; -1: none). R - (E.R)/(E.N) N is the direction of
    steepest descent of the contour's length for the point of this crossing, where E is the direction of the edge,
    N the normal of triangle t, and R the direction, away from the edge, of the contour in a triangle beside the
    edge. As in the publication, the part along the normal, which separates edge and triangle, counts twice."""
    p, q, r = tri[t, 0], tri[t, 1], tri[t, 2]
    normal, along, inward, out = np.empty(3), np.empty(3), np.empty(3), np.empty(3)
    _normal(x, p, q, r, normal)
    length = 0.0
    for m in range(3):
        along[m] = x[edge[1], m] - x[edge[0], m]
        length += along[m] * along[m]
    lean = 0.0
    for m in range(3):
        along[m] /= np.sqrt(length)
        lean += along[m] * normal[m]
    lean = max(lean, SLANT) if lean >= 0.0 else min(lean, -SLANT)
    way[:] = 0.0
    for k in range(2):
        if beside[k] < 0:
            continue
        third = tri[beside[k], 0] + tri[beside[k], 1] + tri[beside[k], 2] - edge[0] - edge[1]
        _normal(x, edge[0], edge[1], third, inward)
        rx = normal[1] * inward[2] - normal[2] * inward[1]
        ry = normal[2] * inward[0] - normal[0] * inward[2]
        rz = normal[0] * inward[1] - normal[1] * inward[0]
        size = np.sqrt(rx * rx + ry * ry + rz * rz)
        if size < 1e-6:
            continue
        depth = 0.0  # position of the third corner along the edge
        for m in range(3):
            out[m] = x[third, m] - x[edge[0], m]
            depth += out[m] * along[m]
        for m in range(3):
            out[m] -= depth * along[m]
        if rx * out[0] + ry * out[1] + rz * out[2] < 0.0:
            size = -size
        rx, ry, rz = rx / size, ry / size, rz / size
        slope = 2.0 * (along[0] * rx + along[1] * ry + along[2] * rz) / lean
        way[0] += rx - slope * normal[0]
        way[1] += ry - slope * normal[1]
        way[2] += rz - slope * normal[2]


@inner(error_model="numpy", fastmath={"contract"})
def _normal(x, p, q, r, out):
    """Write the unit normal of triangle p, q, r to `out` (3,)."""
    ux, uy, uz = x[q, 0] - x[p, 0], x[q, 1] - x[p, 1], x[q, 2] - x[p, 2]
    vx, vy, vz = x[r, 0] - x[p, 0], x[r, 1] - x[p, 1], x[r, 2] - x[p, 2]
    out[0], out[1], out[2] = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
    size = np.sqrt(out[0] * out[0] + out[1] * out[1] + out[2] * out[2]) + 1e-30
    for m in range(3):
        out[m] /= size
