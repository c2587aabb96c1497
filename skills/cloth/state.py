"""The arrays that the compiled loop works on; the caller owns them."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from foldcell.robots.ports import Array
from foldcell.skills.cloth.crease_set import MODES, CreaseLaw
from foldcell.skills.cloth.elasticity import BendingFriction
from foldcell.skills.cloth.simd.aligned_arrays import LINE_BYTES, Table, named_arrays, zeros

HANDS = 2
MAX_HELD = 128  # largest number of held points
LINE = LINE_BYTES // 4  # number of float32 numbers in a cache line

# Indices of State.counts. First the lengths of lists: vertex-triangle pairs, edge-edge pairs, contacts, packed
# edges, packed hinges, awake vertices.
VT, EE, ACTIVE, EDGES, HINGES, AWAKE = range(6)
# SEARCHED, FITTED, PACKED: flags, 1 if the lists of pairs, the geometry of the clusters or the packed lists
# (sleep.py) are up to date. FRAME, SUBSTEP: where the loop continues; NOW: number of substeps so far; NEXT:
# substep of the next narrow phase. SEARCHES: number of searches so far. ACTIVE_VT: number of vertex-triangle
# contacts. WATCHED: length of State.watched. MOVABLE: number of awake vertices and of vertices in their fringe.
# PACE: number of substeps for which the contacts of the next narrow phase are used. BEGUN: 1 if sleep was updated
# in this frame.
SEARCHED, FITTED, PACKED, FRAME, SUBSTEP, NOW, SEARCHES, ACTIVE_VT, WATCHED, NEXT, MOVABLE = range(6, 17)
PACE, BEGUN = 17, 18


class Body(NamedTuple):
    """The constant data: inverse masses, constraints, triangles, neighbours. ring, ring_edge: for vertex i,
    entries ring_start[i] to ring_start[i + 1] - 1 are its neighbours and the edges to them.

    edge_tri: (e, 2) triangles beside an edge, -1 where there is none; tri_edge: (t, 3) edges of each triangle.
    rim: (e,) True for edges of hems and seams. spring: (e, 2) the edges in colour batches (elasticity.py);
    batch_start: the start of each batch, then the end of the last one. The next three arrays have the order of
    spring: inverse_square: (e,) inverse squared rest lengths [1/m2], edge_inverse: (e,) 1 / (w_i + w_j +
    compliance / h^2), damping: (e,) share of the relative speed that `damp_edges` removes. hinge_inverse: (h,) the
    same as edge_inverse for hinges, with w K^2 in place of w and with the bending damping; stiffen: (h,) see
    `bend_stiffening`.
    """

    w: Array
    edge: NDArray[np.int32]
    edge_tri: NDArray[np.int32]
    rim: NDArray[np.bool_]
    spring: NDArray[np.uint32]
    batch_start: NDArray[np.int64]
    inverse_square: Array
    edge_inverse: Array
    damping: Array
    hinge: NDArray[np.int32]
    weight: Array
    hinge_inverse: Array
    stiffen: Array
    bending_friction: BendingFriction
    crease_law: CreaseLaw
    tri: NDArray[np.int32]
    tri_edge: NDArray[np.int32]
    ring_start: NDArray[np.int32]
    ring: NDArray[np.int32]
    ring_edge: NDArray[np.int32]
    clusters: Any


class SolverParameters(NamedTuple):
    """Numbers that stay the same during a run. h: substep [s]; phase: substeps from one narrow phase to the next
    (contacts.py); flat: cosine of the angle from which an edge is a ridge (ridges.py); sharpest: limit of
    sin^2(angle / 2) up to which hinges stiffen (elasticity.py)."""

    h: float
    substeps: int
    phase: int
    flat: float
    sharpest: float
    gx: float
    gy: float
    gz: float
    thickness: float
    mu_static: float
    mu_dynamic: float
    mu_layers: float
    max_speed: float
    drag: float
    bend_gamma: float
    sleep_distance: float
    sleep_frames: int
    table: bool
    hold_compliance: float


_STATE: Table = {
    "x": (float, "n", 4),
    "xp": (float, "n", 4),
    "v": (float, "n", 4),
    "u": (float, "n", 4),
    "ref": (float, "n", 3),
    "last": (float, "n", 3),
    "base": (np.float32, 3, "corners"),
    "course": (np.float32, 3, "corners"),
    "slack": (np.float32, "clusters"),
    "born": (np.int32, "clusters"),
    "moving": (np.bool_, "clusters"),
    "expired": (np.bool_, "clusters"),
    "ridge_searched": (np.int32, "edge_rows"),
    "watched": (np.int32, "clusters"),
    "turned": (np.bool_, "n"),
    "wa": (float, "n"),
    "free": (float, "n"),
    "press": (float, "n", 4),
    "quiet": (np.int32, "n"),
    "kept": (np.int32, "n"),
    "still": (np.bool_, "n"),
    "awake": (np.bool_, "n"),
    "stirred": (np.bool_, "n"),
    "top_row": (np.int32, "n"),
    "near": (np.bool_, "n"),
    "awake_list": (np.int32, "n"),
    "low": (np.int32, "n"),
    "floor": (float, "n"),
    "table_friction": (float, "n"),
    "counts": (np.int64, 19),
    "edge": (np.uint32, "edges", 2),
    "batch_start": (np.int64, "bounds"),
    "inverse_square": (float, "edges"),
    "wi": (float, "edges"),
    "wj": (float, "edges"),
    "rate": (float, "edges"),
    "hinge": (np.uint32, "hinges", 4),
    "weight": (float, "hinges", 4),
    "part": (float, "hinges", 4),
    "stiffen": (float, "hinges"),
    "bend_ratio": (float, "hinges"),
    "which": (np.int32, "hinges"),
    "slip": (float, "rubbing"),
    "held": (float, "rubbing_1"),
    "axis": (float, "rubbing", 6),
    "foot": (float, "rubbing", 2),
    "turn": (float, "rubbing"),
    "friction_inverse": (float, "rubbing"),
    "moment": (float, "rubbing"),
    "pressure": (float, "pressed"),
    "set_parts": (float, "creased", MODES),
    "set_rest": (float, "creased"),
    "side": (float, "creased"),
    "target": (float, "creased", 3),
}
State = named_arrays("State", _STATE, __name__)
"""The data that the loop changes.

x, xp, v: (n, 4; see simd/vec3.py) positions, positions at the beginning of the substep (shifted along with x
where overlap is released), and velocities; u: scratch. wa: (n,) inverse masses, 0 for sleeping vertices; free:
(n,) the same, but not 0 in the fringe of the awake vertices (sleep.py). awake_list: the awake vertices, then
their fringe.

press: (n, 4) displacements by which the table held each vertex in the last substep, along x, y and upwards;
low: vertices that the table may hold, with their lowest height `floor` and friction coefficient
`table_friction`.

`pack` (sleep.py) fills the following arrays; only the first counts[EDGES] edges and counts[HINGES] hinges are
valid. edge: the packed edges, in colour batches; batch_start: the start of each batch, then the end of the
last one (batches may be empty); inverse_square, rate: inverse_square and damping of these edges (`Body`); wi,
wj: shares of their ends; hinge, weight: the packed hinges; which: indices of these hinges; part: shares of
their vertices; stiffen: see `bend_stiffening`; bend_ratio: see
`measure_bends`.

base, course: (3, corners) each cluster predicts its corners at base + course * (time since the substep
`born`); slack: (m,) distance by which a corner may deviate from this [m]; moving: (m,) True if the course is
not zero; expired: (m,) True if the cluster is included in the next search; ridge_searched: (rows,) bit masks
of the edges that were ridges in the last search of their cluster (ridges.py). watched: clusters with a corner
that is awake or predicted to move.

ref: (n, 3) reference point, the position at which the vertex was last found to move; last: (n, 3) position one
frame ago; quiet: (n,) frames since anything near the vertex moved; kept: (n,) frames since it left its
reference point; turned: (n,) True if it fell asleep or woke since the last search; still: (n,) True if it
hardly moved in the last frame; stirred, near: (n,) scratch of sleep.py; top_row: (n,) scratch, filled with -1.

Only with bending friction, else empty: slip: (h,) the turn towards which friction pulls each hinge; held: (h +
1,) latest load of each friction spring, then a 0; axis, foot, turn, friction_inverse, moment: last measurement
of the packed hinges (`measure_turns`) and their friction moments.

Only with a set of creases (crease_set.py), else empty: pressure: (n,) of bodies that press [Pa]; set_parts:
(h, MODES) the parts of each hinge's set [rad]; set_rest: (h,) signed length of K x at rest [m]; side: (h,)
sign of each turn before it was folded over; target: (h, 3) K x of the packed hinges at rest.
"""


_PAIRS: Table = {
    "vt": (np.int32, "vt", 2),
    "side": (np.int8, "vt"),
    "vt_due": (np.int32, "vt"),
    "vt_j": (float, "vt", 4),
    "ee": (np.int32, "ee", 2),
    "near": (np.bool_, "ee"),
    "normal": (float, "ee", 4),
    "ee_due": (np.int32, "ee"),
    "ee_j": (float, "ee", 4),
    "new_vt": (np.int32, "vt", 2),
    "new_ee": (np.int32, "ee", 2),
    "key": (np.int64, "places"),
    "row": (np.int32, "places"),
    "kept": (float, "m", 4),
    "kept_normal": (float, "m", 4),
    "contact_vertices": (np.uint32, "m", 4),
    "contact_weights": (float, "m", 4),
    "contact_mobilities": (float, "m", 4),
    "contact_normals": (float, "m", 4),
    "contact_distances": (float, "m"),
    "contact_masses": (float, "m"),
    "contact_impulses": (float, "m", 4),
    "contact_pairs": (np.int32, "m"),
    "rank": (np.uint64, "m"),
    "ring": (np.uint32, "m"),
    "second": (np.uint32, "m"),
    "better": (np.int32, "m"),
    "bearing": (np.uint32, "m"),
    "some": (np.uint32, "m"),
    "near_c": (np.int32, "m"),
    "near_row": (np.float32, "m", LINE),
}
Pairs = named_arrays("Pairs", _PAIRS, __name__)
"""Candidate pairs with their remembered sides and impulses, and the contacts of the present narrow phase.

vt, ee: (k, 2) pairs of a vertex and a triangle, and pairs of two edges; side: (k,) remembered side of the
vertex, 1 or -1, 0 for none; near: (k,) whether two edges are near; normal: (k, 4) their remembered normal;
vt_due, ee_due: (k,) substep from which a pair has to be examined; vt_j, ee_j: (k, 4; see simd/vec3.py) impulse
of the pair [kg m]. For each contact: contact_vertices: (m, 4) its vertices; contact_weights: (m, 4) their
weights; contact_mobilities: (m, 4) weights times inverse masses wa; contact_normals: (m, 4); contact_impulses:
(m, 4) recent mean impulse; contact_distances: (m,) distance to maintain [m]; contact_masses: (m,) effective
mass, the inverse of the contact's inverse mass; contact_pairs: (m,) index of its pair.

Scratch: near_c: in the narrow phase, the pairs of a vertex and a triangle that can touch; in a search, the
free places in the lists of pairs. near_row: (m, LINE) a row with the geometry of each pair that can touch
(vertex_triangle.py). For each such row: rank: how far inside its triangle the vertex is; ring: the next row of
the same vertex; second: for the top row of a vertex, the row of the second highest rank; better: the row that
replaces it. bearing: rows with an impulse; some: rows or pairs to be examined; new_vt, new_ee: pairs found by
a search; key, row: hash table; kept, kept_normal: impulses and normals of old pairs.
"""


_HOLDS: Table = {
    "vertex": (np.int32, MAX_HELD, 3),
    "bary": (float, MAX_HELD, 3),
    "offset": (float, MAX_HELD, 3),
    "height": (float, MAX_HELD),
    "hand": (np.int32, MAX_HELD),
    "age": (float, HANDS),
    "impulse": (float, HANDS, 3),
    "force": (float, HANDS, 3),
    "limit": (float, HANDS),
    "points": (np.int64, HANDS),
}
Holds = named_arrays("Holds", _HOLDS, __name__)
"""Pinched material points. vertex, bary: (m, 3) vertices of the triangle around each point, and its
barycentric coordinates; offset: (m, 3) position in the tool frame when the pads met it [m]; height: (m,) tool
z at which it is held [m]; hand: (m,) the hand that holds it, -1 for unused rows.

age: (2,) time since each hand closed [s]. impulse: (2, 3) impulse on the hand, summed over the present frame
[kg m]; force: (2, 3) mean force on the hand over the last frame [N]. limit: (2,) force above which the cloth
slips out of the pinch [N]. points: (2,) number of held points.
"""


def new_state(
    n: int, edges: int, bounds: int, hinges: int, friction_hinges: int, clusters: Any, set_hinges: int = 0
) -> Any:
    """Make the `State` of n vertices, all awake; the positions are not yet set. bounds: length of batch_start.
    friction_hinges: number of hinges with bending friction, either 0 or all hinges. set_hinges: number of hinges
    with a plastic set (crease_set.py), either 0 or all hinges."""
    state = State(
        **zeros(
            _STATE, n=n, corners=len(clusters.corner), clusters=len(clusters.tri), edge_rows=len(clusters.rim),
            edges=edges, bounds=bounds, hinges=hinges, rubbing=friction_hinges, rubbing_1=friction_hinges + 1,
            pressed=n if set_hinges else 0, creased=set_hinges,
        )
    )  # fmt: skip
    state.expired[:] = state.awake[:] = True
    state.top_row[:] = -1
    return state


def new_pairs(vt: int, ee: int) -> Any:
    """Make empty `Pairs` with room for `vt` pairs of a vertex and a triangle and `ee` pairs of edges."""
    m = vt + ee
    return Pairs(**zeros(_PAIRS, vt=vt, ee=ee, m=m, places=1 << (2 * m).bit_length()))


def new_holds() -> Any:
    """Make `Holds` without held points."""
    holds = Holds(**zeros(_HOLDS))
    holds.hand[:] = -1
    return holds
