# mypy: allow-untyped-defs, allow-incomplete-defs
"""Finds the edges that can touch other edges: rims, and ridges, where the cloth is bent.

An edge between two nearly coplanar triangles needs no contacts with other edges. Consider an edge of length l that
crosses it. Vertex-triangle contacts hold both ends of the crossing edge one thickness above the triangles. If the
triangles are coplanar, the whole crossing edge is therefore one thickness away. If there is an angle a between
them, its middle can come nearer by a l / 4, as the ridge of a roof rises above the line between its eaves. The
edge distance d of contacts is kept up to a = 4 (thickness - d) / l. A contact with such a flat edge would bear no
load, so only pairs of ridges or rims are searched. In a folded shirt, a third of the pairs remain.

Edges are classified in the state predicted for the middle of the search horizon. A cluster with new ridges since
its last search is included in the next search. An edge becomes a ridge at the share SHARE of this largest angle a,
which leaves a margin until the next search. If an edge bends faster than the margin allows, that next search finds
it one frame late. Until then, vertex-triangle contacts keep it apart from other edges.
"""

from __future__ import annotations

import numpy as np

from foldcell.skills.cloth.contact.contacts import edge_distance
from foldcell.skills.cloth.inner import inner
from foldcell.skills.cloth.simd.i32x16 import LANES

SHARE = 0.5  # x allowed angle: from this angle on an edge is a ridge, as the angle may grow until the next search
MOST_ANGLE = 0.5  # [rad] at a larger angle an edge is always a ridge, however thick the cloth is
WIDE = np.uint32(LANES)


def flat_cosine(thickness: float, edge: float) -> float:
    """Return the cosine of the angle between two triangles at which the edge between them becomes a ridge; `edge`:
    mean length of the mesh's edges [m]."""
    return float(np.cos(min(MOST_ANGLE, SHARE * 4.0 * (thickness - edge_distance(thickness)) / edge)))


@inner(error_model="numpy", fastmath={"contract"}, forceinline=True)
def find_ridges(row, edges, beside, geo, flat):
    """Return a bit mask: bit i is set if the edge in lane i of the row is a ridge. beside: (rows, 2, LANES) the
    triangles beside the edges, as cluster x LANES + lane; geo: (clusters, 15, LANES), with normals in rows 6 to 8
    (clusters.py)."""
    bits = np.int32(0)
    for a in range(LANES):
        s, t = beside[row, 0, a], beside[row, 1, a]
        p, i, q, j = s // WIDE, s % WIDE, t // WIDE, t % WIDE
        cos = geo[p, 6, i] * geo[q, 6, j] + geo[p, 7, i] * geo[q, 7, j] + geo[p, 8, i] * geo[q, 8, j]
        bits |= np.int32(1 << a) if cos < flat and edges[row, a] >= 0 else np.int32(0)
    return bits


@inner()
def stay_ridges(n, pair, near, at, ridge):
    """Mark the edges of near pairs as ridges, so that these pairs keep their normals and impulses."""
    for c in range(n):
        if near[c]:
            for m in range(2):
                slot = at[pair[c, m]]
                ridge[slot // LANES] |= np.int32(1 << (slot % LANES))


@inner()
def note_ridges(stale, start, ridge, searched, expired):
    """Record in `searched` (rows,) the ridges with which stale clusters were searched. Mark the other clusters
    that have ridges not yet recorded as `expired`, so that they are included in the next search. An edge that is
    no longer a ridge is removed from the record, so that it counts as new when it bends again."""
    for k in range(len(stale)):
        expired[k] = False
        for row in range(start[k], start[k + 1]):
            if stale[k]:
                searched[row] = ridge[row]
            else:
                expired[k] |= (ridge[row] & ~searched[row]) != 0
                searched[row] &= ridge[row]
