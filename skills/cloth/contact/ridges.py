# mypy: allow-untyped-defs, allow-incomplete-defs
"""Which edges can touch other edges: rims, and ridges, where the cloth is bent.

An edge between two triangles in about one plane is no feature of the surface. Contacts of vertices and triangles
keep the ends of an edge that crosses it a thickness above these triangles, and what is straight between them is
about as far away. With an angle a between the triangles, and a crossing edge of length l, it can be nearer by
a l / 4 (a roof's ridge over the middle of its eaves): up to a = 4 (thickness - d) / l the two stay apart by the
distance d of a contact of edges. So both edges of a pair have to be ridges or rims; where one
is flat the contact can bear nothing. Of the pairs of a folded shirt a third is left.

Bent is what is so in the middle of the time that a search looks ahead. A cluster in which other edges have become
ridges since it was searched goes along with the search after that. An edge that bends faster than the margin
allows counts from then on, a frame later; vertices and triangles keep it apart meanwhile.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from skills.cloth.contact.contacts import edge_distance
from skills.cloth.simd.f32x16 import LANES

__all__ = ["EVERY_EDGE", "find_ridges", "flat_cosine", "note_ridges", "stay_ridges"]

SHARE = 0.5  # of the angle that may be is that of a ridge: it can grow until the next search
MOST_ANGLE = 0.5  # [rad] beyond it an edge is a ridge however thick the cloth is for its mesh
EVERY_EDGE = np.float32(2.0)  # in place of the cosine: all are ridges
WIDE = np.uint32(LANES)


def flat_cosine(thickness: float, edge: float) -> float:
    """Cosine of the angle between two triangles at which the edge between them becomes a ridge; `edge`: mean
    length of the mesh's edges [m]."""
    return float(np.cos(min(MOST_ANGLE, SHARE * 4.0 * (thickness - edge_distance(thickness)) / edge)))


@njit(nogil=True, error_model="numpy", fastmath={"contract"}, forceinline=True)
def find_ridges(row, edges, beside, geo, flat):
    """Which edges in a row are ridges: a bit for each. beside: (rows, 2, LANES) the triangles beside the edges, as
    cluster x LANES + place; geo: (clusters, 15, LANES), with normals in rows 6 to 8 (clusters.py)."""
    bits = np.int32(0)
    for a in range(LANES):
        s, t = beside[row, 0, a], beside[row, 1, a]
        p, i, q, j = s // WIDE, s % WIDE, t // WIDE, t % WIDE
        cos = geo[p, 6, i] * geo[q, 6, j] + geo[p, 7, i] * geo[q, 7, j] + geo[p, 8, i] * geo[q, 8, j]
        bits |= np.int32(1 << a) if cos < flat and edges[row, a] >= 0 else np.int32(0)
    return bits


@njit(nogil=True)
def stay_ridges(n, pair, near, at, ridge):
    """Edges that are near to each other stay ridges, so that their pairs keep what they remember."""
    for c in range(n):
        if near[c]:
            for m in range(2):
                slot = at[pair[c, m]]
                ridge[slot // LANES] |= np.int32(1 << (slot % LANES))


@njit(nogil=True)
def note_ridges(stale, start, ridge, searched, expired):
    """Puts down the ridges with which stale clusters were searched (rows,), and marks the others that have more
    ridges than that: they are to go along with the next search. What is no ridge now is left out of this search:
    it counts as new when it bends again."""
    for k in range(len(stale)):
        expired[k] = False
        for row in range(start[k], start[k + 1]):
            if stale[k]:
                searched[row] = ridge[row]
            else:
                expired[k] |= (ridge[row] & ~searched[row]) != 0
                searched[row] &= ridge[row]
