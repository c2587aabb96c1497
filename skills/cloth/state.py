"""The arrays that the compiled loop works on; the caller owns them."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from foldcell.robots.ports import Array
from foldcell.skills.cloth.clusters import Clusters
from foldcell.skills.cloth.crease_set import MODES, CreaseLaw
from foldcell.skills.cloth.elasticity import BendingFriction
from foldcell.skills.cloth.simd.aligned_arrays import LINE_BYTES, aligned_zeros
from foldcell.skills.cloth.simd.vec3 import rows

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
    clusters: Clusters


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


class State(NamedTuple):
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

    x: Array
    xp: Array
    v: Array
    u: Array
    ref: Array
    last: Array
    base: NDArray[np.float32]
    course: NDArray[np.float32]
    slack: NDArray[np.float32]
    born: NDArray[np.int32]
    moving: NDArray[np.bool_]
    expired: NDArray[np.bool_]
    ridge_searched: NDArray[np.int32]
    watched: NDArray[np.int32]
    turned: NDArray[np.bool_]
    wa: Array
    free: Array
    press: Array
    quiet: NDArray[np.int32]
    kept: NDArray[np.int32]
    still: NDArray[np.bool_]
    awake: NDArray[np.bool_]
    stirred: NDArray[np.bool_]
    top_row: NDArray[np.int32]
    near: NDArray[np.bool_]
    awake_list: NDArray[np.int32]
    low: NDArray[np.int32]
    floor: Array
    table_friction: Array
    counts: NDArray[np.int64]
    edge: NDArray[np.uint32]
    batch_start: NDArray[np.int64]
    inverse_square: Array
    wi: Array
    wj: Array
    rate: Array
    hinge: NDArray[np.uint32]
    weight: Array
    part: Array
    stiffen: Array
    bend_ratio: Array
    which: NDArray[np.int32]
    slip: Array
    held: Array
    axis: Array
    foot: Array
    turn: Array
    friction_inverse: Array
    moment: Array
    pressure: Array
    set_parts: Array
    set_rest: Array
    side: Array
    target: Array


class Pairs(NamedTuple):
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

    vt: NDArray[np.int32]
    side: NDArray[np.int8]
    vt_due: NDArray[np.int32]
    vt_j: Array
    ee: NDArray[np.int32]
    near: NDArray[np.bool_]
    normal: Array
    ee_due: NDArray[np.int32]
    ee_j: Array
    new_vt: NDArray[np.int32]
    new_ee: NDArray[np.int32]
    key: NDArray[np.int64]
    row: NDArray[np.int32]
    kept: Array
    kept_normal: Array
    contact_vertices: NDArray[np.uint32]
    contact_weights: Array
    contact_mobilities: Array
    contact_normals: Array
    contact_distances: Array
    contact_masses: Array
    contact_impulses: Array
    contact_pairs: NDArray[np.int32]
    rank: NDArray[np.uint64]
    ring: NDArray[np.uint32]
    second: NDArray[np.uint32]
    better: NDArray[np.int32]
    bearing: NDArray[np.uint32]
    some: NDArray[np.uint32]
    near_c: NDArray[np.int32]
    near_row: NDArray[np.float32]


class Holds(NamedTuple):
    """Pinched material points. vertex, bary: (m, 3) vertices of the triangle around each point, and its
    barycentric coordinates; offset: (m, 3) position in the tool frame when the pads met it [m]; height: (m,) tool
    z at which it is held [m]; hand: (m,) the hand that holds it, -1 for unused rows.

    age: (2,) time since each hand closed [s]. impulse: (2, 3) impulse on the hand, summed over the present frame
    [kg m]; force: (2, 3) mean force on the hand over the last frame [N]. limit: (2,) force above which the cloth
    slips out of the pinch [N]. points: (2,) number of held points.
    """

    vertex: NDArray[np.int32]
    bary: Array
    offset: Array
    height: Array
    hand: NDArray[np.int32]
    age: Array
    impulse: Array
    force: Array
    limit: Array
    points: NDArray[np.int64]


def new_state(
    n: int, edges: int, bounds: int, hinges: int, friction_hinges: int, clusters: Clusters, set_hinges: int = 0
) -> State:
    """Make the state of n vertices, all awake; the positions are not yet set. bounds: length of batch_start.
    friction_hinges: number of hinges with bending friction, either 0 or all hinges. set_hinges: number of hinges
    with a plastic set (crease_set.py), either 0 or all hinges."""
    m, corners = len(clusters.tri), len(clusters.corner)

    def f(*shape: int) -> Array:
        return aligned_zeros(shape)

    return State(
        x=rows(n),
        xp=rows(n),
        v=rows(n),
        u=rows(n),
        ref=f(n, 3),
        last=f(n, 3),
        base=aligned_zeros((3, corners), np.float32),
        course=aligned_zeros((3, corners), np.float32),
        slack=aligned_zeros(m, np.float32),
        born=aligned_zeros(m, np.int32),
        moving=aligned_zeros(m, np.bool_),
        expired=np.ones(m, np.bool_),
        ridge_searched=np.zeros_like(clusters.rim),
        watched=aligned_zeros(m, np.int32),
        turned=aligned_zeros(n, np.bool_),
        wa=f(n),
        free=f(n),
        press=rows(n),
        quiet=aligned_zeros(n, np.int32),
        kept=aligned_zeros(n, np.int32),
        still=aligned_zeros(n, np.bool_),
        awake=np.ones(n, np.bool_),
        stirred=aligned_zeros(n, np.bool_),
        top_row=np.full(n, -1, np.int32),
        near=aligned_zeros(n, np.bool_),
        awake_list=aligned_zeros(n, np.int32),
        low=aligned_zeros(n, np.int32),
        floor=f(n),
        table_friction=f(n),
        counts=aligned_zeros(19, np.int64),
        edge=aligned_zeros((edges, 2), np.uint32),
        batch_start=aligned_zeros(bounds, np.int64),
        inverse_square=f(edges),
        wi=f(edges),
        wj=f(edges),
        rate=f(edges),
        hinge=aligned_zeros((hinges, 4), np.uint32),
        weight=f(hinges, 4),
        part=f(hinges, 4),
        stiffen=f(hinges),
        bend_ratio=f(hinges),
        which=aligned_zeros(hinges, np.int32),
        slip=f(friction_hinges),
        held=f(friction_hinges + 1),
        axis=f(friction_hinges, 6),
        foot=f(friction_hinges, 2),
        turn=f(friction_hinges),
        friction_inverse=f(friction_hinges),
        moment=f(friction_hinges),
        pressure=f(n if set_hinges else 0),
        set_parts=f(set_hinges, MODES),
        set_rest=f(set_hinges),
        side=f(set_hinges),
        target=f(set_hinges, 3),
    )


def new_pairs(vt: int, ee: int) -> Pairs:
    """Make empty lists with room for `vt` pairs of a vertex and a triangle and `ee` pairs of edges."""
    m, table = vt + ee, 1 << (2 * (vt + ee)).bit_length()
    return Pairs(
        vt=aligned_zeros((vt, 2), np.int32),
        side=aligned_zeros(vt, np.int8),
        vt_due=aligned_zeros(vt, np.int32),
        vt_j=rows(vt),
        ee=aligned_zeros((ee, 2), np.int32),
        near=aligned_zeros(ee, np.bool_),
        normal=rows(ee),
        ee_due=aligned_zeros(ee, np.int32),
        ee_j=rows(ee),
        new_vt=aligned_zeros((vt, 2), np.int32),
        new_ee=aligned_zeros((ee, 2), np.int32),
        key=aligned_zeros(table, np.int64),
        row=aligned_zeros(table, np.int32),
        kept=rows(m),
        kept_normal=rows(m),
        contact_vertices=aligned_zeros((m, 4), np.uint32),
        contact_weights=aligned_zeros((m, 4)),
        contact_mobilities=aligned_zeros((m, 4)),
        contact_normals=rows(m),
        contact_distances=aligned_zeros(m),
        contact_masses=aligned_zeros(m),
        contact_impulses=rows(m),
        contact_pairs=aligned_zeros(m, np.int32),
        rank=aligned_zeros(m, np.uint64),
        ring=aligned_zeros(m, np.uint32),
        second=aligned_zeros(m, np.uint32),
        better=aligned_zeros(m, np.int32),
        bearing=aligned_zeros(m, np.uint32),
        some=aligned_zeros(m, np.uint32),
        near_c=aligned_zeros(m, np.int32),
        near_row=aligned_zeros((m, LINE), np.float32),
    )


def new_holds() -> Holds:
    """Make holds without held points."""
    return Holds(
        np.zeros((MAX_HELD, 3), np.int32),
        np.zeros((MAX_HELD, 3)),
        np.zeros((MAX_HELD, 3)),
        np.zeros(MAX_HELD),
        np.full(MAX_HELD, -1, np.int32),
        np.zeros(HANDS),
        np.zeros((HANDS, 3)),
        np.zeros((HANDS, 3)),
        np.zeros(HANDS),
        np.zeros(HANDS, np.int64),
    )
