# mypy: allow-untyped-defs, allow-incomplete-defs
"""Sleep of vertices at rest, which then cost nothing: decides which vertices wake and fall asleep, and lists the
awake ones.

A vertex that falls asleep must not move the vertices that stay awake. In each substep, all moving vertices first
fall by g h^2, and the sweeps lift them again. If a sleeping vertex stayed in place during the sweeps, it would
carry up to half the weight of its neighbours, and the creases beside newly sleeping vertices would start to swing.
Therefore the fringe, which is the sleeping vertices within FRINGE rings of awake ones, takes part in the elastic
sweeps; its positions are restored afterwards.
"""

from __future__ import annotations

import numpy as np

from foldcell.skills.cloth.contact.capsules import squared_distance
from foldcell.skills.cloth.inner import inner
from foldcell.skills.cloth.simd.f64x4 import gather_f64x4
from foldcell.skills.cloth.simd.vec3 import load, members, store
from foldcell.skills.cloth.state import ACTIVE, AWAKE, EDGES, HINGES, MOVABLE, PACKED, SEARCHED, WATCHED

STILL = 2.5e-4  # [m] vertices that moved less than this in a frame are not predicted to move
# x sleep_frames: a vertex that stayed near its reference point for at least this time counts as quiet, even if it
# gains speed. It swings; it is not beginning to fall.
SWINGS = 3
FRINGE = 2  # width of the fringe of sleeping vertices around awake ones, in rings of neighbours
NEAR_CAPSULE = 0.02  # [m] cloth nearer to a moving capsule is awake


@inner()
def update_sleep(body, parameters, state, pairs, holds, cap_p0, cap_p1, cap_r, f):
    """Decide at the beginning of frame f which vertices are awake. Vertices that moved stay awake. They wake two
    rings of neighbours and the vertices that they touch. Quiet vertices fall asleep."""
    count = state.counts
    stirred, near = state.stirred, state.near
    stirred[:] = False
    _find_moving(
        state.awake_list,
        count[AWAKE],
        state.x,
        state.ref,
        state.last,
        state.quiet,
        state.kept,
        state.still,
        parameters.sleep_distance,
        parameters.sleep_frames,
        stirred,
    )
    _stir_by_capsules(state.x, stirred, cap_p0, cap_p1, cap_r, f)
    for i in range(len(near)):  # quicker to compile than an assignment to the slice
        near[i] = stirred[i]
    _grow(body.ring_start, body.ring, near, 2)
    _stir_by_contact(count[ACTIVE], pairs.contact_vertices, stirred, near)
    hand, vertex = holds.hand, holds.vertex
    for k in range(len(hand)):
        if hand[k] >= 0:
            for m in range(3):
                near[vertex[k, m]] = True
    changed, woke = _settle(
        parameters.sleep_frames,
        near,
        state.x,
        state.xp,
        state.u,
        state.v,
        state.ref,
        state.last,
        state.turned,
        state.quiet,
        state.kept,
        state.awake,
        state.wa,
        body.w,
    )
    if changed:
        count[PACKED] = 0
    if woke:
        count[SEARCHED] = 0


@inner()
def _find_moving(index, n_awake, x, ref, last, quiet, kept, still, distance, frames, stirred):
    """Mark in `stirred` the awake vertices that are not quiet, and move their reference points to their present
    positions. A vertex is not quiet if it left its reference point, or if it gains speed (its step in this frame
    is longer than its mean step from the reference point), however slow it is. A vertex that has stayed near its
    reference point for a long time only swings: it counts as quiet even if it gains speed."""
    for c in range(n_awake):
        i = index[c]
        away, step = 0.0, 0.0
        for m in range(3):
            away += (x[i, m] - ref[i, m]) ** 2
            step += (x[i, m] - last[i, m]) ** 2
            last[i, m] = x[i, m]
        quiet[i] += 1
        still[i] = step < STILL * STILL
        left = away > distance * distance
        kept[i] = 0 if left else kept[i] + 1
        gathers = quiet[i] >= frames and np.sqrt(step) * frames > 1.5 * np.sqrt(away) + 1e-4
        if left or (gathers and kept[i] < SWINGS * frames):
            stirred[i] = True
            for m in range(3):
                ref[i, m] = x[i, m]


@inner()
def _stir_by_capsules(x, stirred, cap_p0, cap_p1, cap_r, f):
    for k in range(len(cap_r)):
        travel = 0.0
        for m in range(3):
            travel = max(travel, abs(cap_p0[f + 1, k, m] - cap_p0[f, k, m]))
            travel = max(travel, abs(cap_p1[f + 1, k, m] - cap_p1[f, k, m]))
        if travel < 1e-7:
            continue
        reach = cap_r[k] + NEAR_CAPSULE + travel
        for i in range(len(x)):
            if squared_distance(x, i, cap_p0[f + 1, k], cap_p1[f + 1, k]) < reach * reach:
                stirred[i] = True


@inner()
def _stir_by_contact(n, contact_vertices, stirred, near):
    for c in range(n):
        i, j, k, m = contact_vertices[c, 0], contact_vertices[c, 1], contact_vertices[c, 2], contact_vertices[c, 3]
        if stirred[i] or stirred[j] or stirred[k] or stirred[m]:
            near[i] = near[j] = near[k] = near[m] = True


@inner()
def _grow(start, ring, near, rings):
    """Mark the neighbours of the marked vertices, `rings` times."""
    one, marked = np.uint64(1), np.empty(len(near) + 1, np.uint32)
    begin, end = np.uint64(0), np.uint64(0)
    for i in range(np.uint64(len(near))):
        marked[end] = i
        end += np.uint64(near[i])
    for _ in range(rings):  # only around the vertices marked last, since the others have no unmarked neighbours
        last = end
        for c in range(begin, last):
            own = np.uint64(marked[c])
            for a in range(np.uint64(start[own]), np.uint64(start[own + one])):
                j = np.uint64(ring[a])
                marked[end] = j
                end += np.uint64(not near[j])
                near[j] = True
        begin = last


@inner()
def _settle(sleep_frames, near, x, xp, u, v, ref, last, turned, quiet, kept, awake, wa, w):
    """Wake the vertices marked in `near`, and put to sleep those that were quiet for `sleep_frames`. Returns
    (changed, woke): changed is true if any vertex woke or fell asleep."""
    changed = woke = False
    for i in range(len(x)):
        if near[i]:
            quiet[i] = 0
            if awake[i] or w[i] == 0.0:
                continue
            awake[i], wa[i], turned[i], kept[i] = True, w[i], True, 0
            changed = woke = True
            for m in range(3):
                ref[i, m] = last[i, m] = xp[i, m] = x[i, m]
                v[i, m] = 0.0
        elif awake[i] and quiet[i] >= sleep_frames:
            awake[i], wa[i], turned[i] = False, 0.0, True
            changed = True
            for m in range(3):
                xp[i, m] = u[i, m] = x[i, m]
                v[i, m] = 0.0
    return changed, woke


@inner()
def pack(body, state):
    """List the awake vertices, followed by their fringe. Also list the constraints that contain any of these
    vertices, with the shares of their ends (the packed edges and hinges). Vertices of the fringe count with their
    mass like awake ones: the motion of a vertex must not change when its neighbour falls asleep."""
    count, free, near, w = state.counts, state.free, state.near, body.w
    awake, awake_list = state.awake, state.awake_list
    for i in range(len(near)):
        near[i] = awake[i]
    _grow(body.ring_start, body.ring, near, FRINGE)
    n = 0
    for i in range(len(free)):
        free[i] = w[i] if near[i] else 0.0
        if awake[i]:
            awake_list[n] = i
            n += 1
    count[AWAKE] = n
    for i in range(len(free)):
        if free[i] > 0.0 and not awake[i]:
            awake_list[n] = i
            n += 1
    count[MOVABLE] = n
    count[EDGES] = _pack_edges(
        body.spring, body.batch_start, body.edge_inverse, body.inverse_square, body.damping, free, state.edge,
        state.batch_start, state.inverse_square, state.wi, state.wj, state.rate
    )  # fmt: skip
    count[HINGES] = _pack_hinges(
        body.hinge.view(np.uint32), body.hinge_inverse, body.weight, body.stiffen, free, state.which, state.hinge,
        state.weight, state.part, state.stiffen
    )  # fmt: skip
    count[WATCHED] = _watch(
        body.clusters.corner, body.clusters.corner_start, state.awake, state.moving, state.watched
    )
    count[PACKED] = 1


@inner()
def _pack_edges(
    edge, batch_start, inverse, inverse_square, damping, free, to_edge, to_batch_start, to_inverse_square, to_wi,
    to_wj, to_rate
):  # fmt: skip
    """List the edges that have a free end, in their colour batches. Returns their number."""
    single, n, which = np.uint64(1), np.uint64(0), np.empty(len(edge), np.uint32)
    for row in range(single, np.uint64(len(batch_start))):
        for e in range(np.uint64(batch_start[row - single]), np.uint64(batch_start[row])):  # branch-free
            which[n] = e
            n += np.uint64(free[edge[e, 0]] + free[edge[e, 1]] > 0.0)
        to_batch_start[row] = n
    for k in range(n):
        one = np.uint64(which[k])
        i, j = edge[one, 0], edge[one, 1]
        to_edge[k, 0], to_edge[k, 1] = i, j
        to_inverse_square[k], to_rate[k] = inverse_square[one], damping[one]
        to_wi[k], to_wj[k] = free[i] * inverse[one], free[j] * inverse[one]
    return n


@inner()
def _pack_hinges(hinge, inverse, weight, stiffen, free, which, to_hinge, to_weight, to_part, to_stiffen):
    """List the hinges that have a free vertex; which: their indices. Returns their number."""
    n = np.uint64(0)
    for e in range(np.uint64(len(hinge))):
        some = free[hinge[e, 0]] + free[hinge[e, 1]] + free[hinge[e, 2]] + free[hinge[e, 3]]
        which[n] = e
        n += np.uint64(some > 0.0)
    for k in range(n):
        one = np.uint64(which[k])
        i, own = members(hinge, one), load(weight, one)
        to_hinge[k, 0], to_hinge[k, 1], to_hinge[k, 2], to_hinge[k, 3] = i
        store(to_weight, k, own)
        to_stiffen[k] = stiffen[one]
        store(to_part, k, inverse[one] * (gather_f64x4(free, i) * own))
    return n


@inner()
def _watch(corner, start, awake, moving, watched):
    """List the clusters with a corner that is awake or predicted to move. Returns their number."""
    n = 0
    for k in range(len(moving)):
        some = moving[k]
        for c in range(start[k], start[k + 1]):
            some = some or awake[corner[c]]
        if some:
            watched[n] = k
            n += 1
    return n
