# mypy: allow-untyped-defs, allow-incomplete-defs
"""Maintains the lists of pairs that may touch: decides when clusters are searched again, and transfers sides and
impulses from old pairs to new ones."""

from __future__ import annotations

import numpy as np

from foldcell.skills.cloth.broad_phase.cluster_bounds import fit_clusters, fit_ridges
from foldcell.skills.cloth.broad_phase.cluster_search import search_pairs
from foldcell.skills.cloth.contact.contacts import PARKED
from foldcell.skills.cloth.contact.ridges import note_ridges, stay_ridges
from foldcell.skills.cloth.inner import inner
from foldcell.skills.cloth.simd.vec3 import load, store
from foldcell.skills.cloth.state import EE, FITTED, NOW, PACE, SEARCHED, SEARCHES, VT, WATCHED

SLACK = 0.001  # [m] distance by which a corner may stray from its course before its cluster is searched again
# x thickness: slack of a cluster at rest. It is so small that, in cloth thicker than about 1.8 mm, the edges of
# two layers that lie on each other are not listed as pairs (edge_distance in contacts.py)
CALM_SLACK = 0.15
# x slack: a cluster that strayed farther than this is included in the next search, but does not cause a search
STALE_SHARE = 0.4
HORIZON = 6  # number of phases (contacts.py) for which the pairs of a search are valid
NONE, ONE = np.uint64(0), np.uint64(1)
GOLDEN = np.uint64(0x9E3779B97F4A7C15)  # 2^64 divided by the golden ratio, for hashing
ROOMY = 8  # places in the hash table per pair, so that few pairs collide
# [phases] a moving cluster is included in the next search if its predicted motion (cluster_bounds.py) is older
RENEW = 4


@inner()
def needs_search(body, parameters, state):
    """Return whether pairs may be missing from the lists, so that a search is necessary."""
    count = state.counts
    must = _expire(
        count[NOW],
        count[PACE],
        parameters.phase,
        parameters.h,
        count[WATCHED],
        state.watched,
        body.clusters.corner,
        body.clusters.corner_start,
        state.x,
        state.base,
        state.course,
        state.slack,
        state.born,
        state.moving,
        state.expired,
    )
    return must or count[SEARCHED] == 0


@inner(error_model="numpy", fastmath={"contract"})
def _expire(now, pace, phase, h, n, watched, corner, start, x, base, course, slack, born, moving, expired):
    """Return whether a cluster left its predicted course, or whether its course runs out within the next `pace`
    substeps, for which contacts are made now. Mark the clusters for which this is true, or nearly true
    (STALE_SHARE, RENEW), in `expired`."""
    must = False
    for row in range(n):
        k = np.uint64(watched[row])
        age = now - born[k]
        after = np.float32(age * h)
        most = np.float32(0.0)
        for c in range(np.uint64(start[k]), np.uint64(start[k + 1])):
            i = np.uint64(corner[c])
            dx = np.float32(x[i, 0]) - base[0, c] - after * course[0, c]
            dy = np.float32(x[i, 1]) - base[1, c] - after * course[1, c]
            dz = np.float32(x[i, 2]) - base[2, c] - after * course[2, c]
            most = max(most, dx * dx + dy * dy + dz * dz)
        strayed = np.sqrt(most) / slack[k]
        expired[k] = expired[k] or strayed > STALE_SHARE or (moving[k] and age >= RENEW * phase)
        must = must or strayed > 1.0 or (moving[k] and age + pace > HORIZON * phase)
    return must


@inner()
def search(body, parameters, state, pairs):
    """Search the pairs of stale clusters again; pairs that are near keep their side. Returns False if a list is
    too small; in this case, no pair has changed."""
    count, clusters = state.counts, body.clusters
    now, ahead = count[NOW], 0.5 * HORIZON * parameters.phase * parameters.h
    _foresee(
        now,
        min(SLACK, CALM_SLACK * parameters.thickness),
        clusters.corner,
        clusters.corner_start,
        state.x,
        state.v,
        state.awake,
        state.still,
        state.turned,
        state.expired,
        state.base,
        state.course,
        state.slack,
        state.born,
        state.moving,
        clusters.stale,
    )
    fit_clusters(
        clusters,
        state.base,
        state.course,
        state.slack,
        state.born,
        state.moving,
        now,
        parameters.h,
        ahead,
        count[FITTED] == 0,
        np.float32(parameters.flat),
    )
    bent, ridge = clusters.bent, clusters.ridge
    for k in range(len(ridge)):  # quicker to compile than an assignment to the slice
        ridge[k] = bent[k]
    stay_ridges(count[EE], pairs.ee, pairs.near, clusters.at_edge, ridge)
    fit_ridges(clusters, state.course, state.slack)
    n_vt, n_ee = search_pairs(clusters, parameters.thickness, ahead, pairs.new_vt, pairs.new_ee)
    if not _have_room(n_vt, count[VT], pairs.vt, clusters.stale, clusters.of_vertex, clusters.of_tri):
        return False
    if not _have_room(n_ee, count[EE], pairs.ee, clusters.stale, clusters.of_edge, clusters.of_edge):
        return False
    stale, scratch, free, key, row = clusters.stale, pairs.contact_vertices, pairs.near_c, pairs.key, pairs.row
    of_vertex, of_tri = clusters.of_vertex.view(np.uint32), clusters.of_tri.view(np.uint32)
    of_edge = clusters.of_edge.view(np.uint32)
    count[VT] = _renew(
        count[VT], now, stale, of_vertex, of_tri, pairs.vt.view(np.uint32), pairs.side, pairs.vt_due, pairs.vt_j,
        np.empty((0, 4)), n_vt, pairs.new_vt, np.int64(len(body.tri)), scratch, pairs.kept, pairs.kept_normal,
        free, key, row
    )  # fmt: skip
    count[EE] = _renew(
        count[EE], now, stale, of_edge, of_edge, pairs.ee.view(np.uint32), pairs.near, pairs.ee_due, pairs.ee_j,
        pairs.normal, n_ee, pairs.new_ee, np.int64(len(body.edge)), scratch, pairs.kept, pairs.kept_normal,
        free, key, row
    )  # fmt: skip
    note_ridges(clusters.stale, clusters.edge_start, clusters.ridge, state.ridge_searched, state.expired)
    state.turned[:] = False
    count[SEARCHED] = count[FITTED] = 1
    count[SEARCHES] += 1
    return True


@inner()
def _have_room(n_new, n, pair, stale, of_first, of_second):
    """Return whether n_new pairs fit into the list after removal of the pairs of stale clusters from its first n
    pairs."""
    room = len(pair) - n
    if n_new > room:
        for c in range(n):
            room += stale[of_first[pair[c, 0]]] or stale[of_second[pair[c, 1]]]
    return n_new <= room


@inner()
def _foresee(
    now, calm_slack, corner, start, x, v, awake, still, turned, expired, base, course, slack, born, moving, stale
):  # fmt: skip
    """Set new courses for the clusters that expired, that have a corner that woke, or that move and have a corner
    that fell asleep. These clusters become stale."""
    for k in range(len(stale)):
        for c in range(np.uint64(start[k]), np.uint64(start[k + 1])):
            i = np.uint64(corner[c])
            expired[k] = expired[k] or (turned[i] and (awake[i] or moving[k]))
        stale[k] = expired[k]
        if not stale[k]:
            continue
        born[k], moving[k] = now, False
        for c in range(np.uint64(start[k]), np.uint64(start[k + 1])):
            i = np.uint64(corner[c])
            calm = still[i] or not awake[i]
            moving[k] = moving[k] or not calm
            for d in range(3):
                base[d, c] = x[i, d]
                course[d, c] = 0.0 if calm else v[i, d]
        slack[k] = SLACK if moving[k] else calm_slack


@inner()
def _renew(
    count, now, stale, of_first, of_second, pair, mark, due, borne, normal, n_new, new, width, scratch, memory,
    kept_normal, free, key, row
):  # fmt: skip
    """Replace the pairs of stale clusters among the first `count` pairs by the n_new pairs in `new`. Returns the
    new number of pairs.

    mark: the remembered side of each pair (of edges: whether they are near), 0 if nothing is remembered. A new
    pair inherits the mark, the impulse `borne` and the normal of an equal old pair with a mark. Sleeping pairs
    without a mark are removed as well. normal: (k, 4), or empty for pairs without normals. stale: of the clusters
    that own the first and the second primitive of a pair. width: one more than the largest second index of a pair.
    scratch, memory, kept_normal, free, key, row: scratch.
    """
    n, kept, places, normals = np.uint64(count), NONE, NONE, len(normal) > 0
    for c in range(n):  # branch-free
        old = stale[of_first[pair[c, 0]]] | stale[of_second[pair[c, 1]]]
        free[places] = c
        places += np.uint64(old | ((mark[c] == 0) & (due[c] == PARKED)))
    for k in range(places):
        o = np.uint64(free[k])
        scratch[kept, 0], scratch[kept, 1], scratch[kept, 2] = pair[o, 0], pair[o, 1], mark[o]
        store(memory, kept, load(borne, o))
        if normals:
            store(kept_normal, kept, load(normal, o))
        kept += np.uint64(mark[o] != 0)
    shift = _note(scratch, np.int64(kept), width, key, row)
    for c in range(np.uint64(n_new)):
        at = _find(new[c, 0] * width + new[c, 1], key, shift)
        found, r = key[at] >= 0, np.uint64(row[at])
        was = np.int8(scratch[r, 2])  # always read, to avoid a branch
        o = np.uint64(free[c]) if c < places else n
        n += np.uint64(c >= places)
        pair[o, 0], pair[o, 1], due[o] = new[c, 0], new[c, 1], now
        mark[o] = was * np.int8(found)
        store(borne, o, (1.0 if found else 0.0) * load(memory, r))
        if normals:
            store(normal, o, (1.0 if found else 0.0) * load(kept_normal, r))
    for c in range(int(places) - 1, n_new - 1, -1):  # move the last pairs into the places that are still free
        n -= ONE
        o = np.uint64(free[c])
        if o < n:
            pair[o, 0], pair[o, 1], mark[o], due[o] = pair[n, 0], pair[n, 1], mark[n], due[n]
            store(borne, o, load(borne, n))
            if normals:
                store(normal, o, load(normal, n))
    return n


@inner()
def _note(pair, n, width, key, row):
    """Build a hash table (linear probing) that maps the key first * width + second of each of n pairs to its row.
    Returns the shift of the hash function. In places without a key, row is 0."""
    bits = 6
    while (1 << bits) < ROOMY * n and (2 << bits) <= len(key):
        bits += 1
    key[: 1 << bits], row[: 1 << bits] = -1, 0
    shift = np.uint64(64 - bits)
    for c in range(n):
        k = pair[c, 0] * width + pair[c, 1]
        at = _find(k, key, shift)
        key[at], row[at] = k, c
    return shift


@inner(forceinline=True)
def _find(k, key, shift):
    """Return the place of key k in the table, or else the empty place for it (multiplicative hashing, Knuth
    6.4)."""
    at, mask = (np.uint64(k) * GOLDEN) >> shift, (ONE << (np.uint64(64) - shift)) - ONE
    while (key[at] >= 0) & (key[at] != k):  # & instead of and: one branch
        at = (at + ONE) & mask
    return at
