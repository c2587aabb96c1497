# mypy: allow-untyped-defs, allow-incomplete-defs
"""Narrow phase of vertices against triangles: finds which pairs touch, and keeps one contact where a vertex is
near several triangles of one sheet.

Fetching the data of pairs and mispredicted branches take nearly all of the time. Therefore LANES pairs are
evaluated together (vertex_sides.py), and those that touch are stored in short rows, one per pair. The rows are
then reduced until each vertex meets each sheet once; only the remaining rows become contacts.
"""

from __future__ import annotations

import numpy as np

from foldcell.skills.cloth.contact.contacts import LEAST_SHARE, PARKED, is_due
from foldcell.skills.cloth.contact.corners import common_corner
from foldcell.skills.cloth.contact.vertex_sides import (
    AWAY,
    BORDER,
    GAP,
    LEAST,
    NORMAL,
    REACH,
    ROWS,
    SECOND,
    SIDE,
    SLIDE,
    THIRD,
    TO_SECOND,
    TO_THIRD,
    TO_VERTEX,
    VERDICT,
    WAIT,
    WITHIN,
    judge_sides,
)
from foldcell.skills.cloth.inner import inner
from foldcell.skills.cloth.simd.f64x8 import blocks
from foldcell.skills.cloth.simd.i32x16 import LANES
from foldcell.skills.cloth.simd.vec3 import load, store, store_singles, vector

AT_BEND = -2  # value in `better` of a row that is at a bend and has no better row (`_meet_once`)
ONE, FULL, ZERO = np.uint64(1), np.uint64(LANES), np.float32(0.0)
OVER = np.nextafter(np.float32(BORDER), ZERO)  # the largest float32 below BORDER
# A vertex over the border of two neighbouring triangles meets them as one if the cosine between their normals
# exceeds this.
ALIKE = np.float32(0.9)
NEARLY = 0.5  # x thickness: no row is replaced by a row that is farther by more than this (layers joined at a hem)
NEVER = np.float32(2.0)  # more than any cosine
# Columns of a row, which fills one cache line: indices of the triangle, its corners and the vertex, then the
# contact (vertex_sides.py): normal, WITHIN, GAP, LEAST and the weights of the second and third corner.
TRIANGLE, CORNERS, VERTEX = 0, 1, 4
DIRECTION, INSIDE, APART, AIM, AT_SECOND, AT_THIRD = 5, 8, 9, 10, 11, 12


@inner()
def narrow_vertex_triangle(count, now, pace, h, thick, tri, x, v, w, pairs, top):
    """Update the sides of the pairs, and write those that can touch within `pace` substeps of h [s] as contacts
    from row 0 on. Returns the number of contacts, and the largest distance that a near pair may move in this time
    [m]. top: (n,) scratch, filled with -1."""
    near, ids = pairs.near_row, pairs.near_row.view(np.uint32)
    n, bearing, farthest = _find_near(
        count, now, pace, h, thick, tri, x, v, w, pairs.vt, pairs.side, pairs.vt_due, pairs.vt_j, pairs.some,
        near, ids, pairs.near_c, pairs.bearing
    )  # fmt: skip
    _join(n, near, ids, pairs.rank, pairs.ring, top)
    _meet_once(
        n, np.float32(NEARLY * thick), near, ids, pairs.rank, pairs.ring, pairs.better, pairs.some, top,
        pairs.second
    )  # fmt: skip
    _pass_on(bearing, pairs.bearing, pairs.better, pairs.near_c, pairs.vt_j)
    rows = _enter(
        n, thick, w, pairs.better, pairs.some, pairs.vt_j, near, ids, pairs.near_c, pairs.contact_vertices,
        pairs.contact_weights, pairs.contact_mobilities, pairs.contact_normals, pairs.contact_impulses,
        pairs.contact_pairs, pairs.contact_distances, pairs.contact_masses
    )  # fmt: skip
    return np.int64(rows), farthest


@inner(error_model="numpy", fastmath={"contract"}, forceinline=True)
def _find_near(
    count, now, pace, h, thick, tri, x, v, w, pair, side, due, memory, asked, near, ids, near_c, bearing
):  # fmt: skip
    """Update the sides of the pairs that are due, and store rows for the pairs that can touch. Returns the number
    of rows, the number of rows with an impulse, and the largest distance that such a pair may move [m]. asked:
    scratch, the pairs examined now."""
    work, of, hit = (
        blocks(ROWS, 1).view(np.float32).reshape(ROWS * LANES),
        np.zeros(LANES, np.uint64),
        np.zeros(LANES, np.uint64),
    )
    work[:] = ZERO
    pair, tri, borne = pair.view(np.uint32), tri.view(np.uint32), memory.view(np.int64)
    farthest, n, bear, c = np.float32(0.0), np.uint64(0), np.uint64(0), np.uint64(0)
    end = find_due(count, now, pace, due, asked)
    while c < end:
        filled = np.uint64(0)
        while c < end and filled < FULL:
            o = np.uint64(asked[c])
            i, t = pair[o, 0], pair[o, 1]
            p, q, r = tri[t, 0], tri[t, 1], tri[t, 2]
            if w[i] + w[p] + w[q] + w[r] == 0.0:
                due[o] = PARKED
            else:
                corner = load(x, p)
                store_singles(work, np.uint64(TO_SECOND * LANES) + filled, LANES, load(x, q) - corner)
                store_singles(work, np.uint64(TO_THIRD * LANES) + filled, LANES, load(x, r) - corner)
                store_singles(work, np.uint64(TO_VERTEX * LANES) + filled, LANES, load(x, i) - corner)
                store_singles(work, np.uint64(SLIDE * LANES) + filled, LANES, load(v, i) - load(v, p))
                work[np.uint64(SIDE * LANES) + filled] = side[o]
                of[filled] = o
                filled += ONE
            c += ONE
        judge_sides(work, np.float32(thick), np.float32(pace * h))
        hits = np.uint64(0)
        for k in range(filled):  # branch-free
            o = of[k]
            side[o] = np.int8(work[np.uint64(SIDE * LANES) + k])
            due[o] = now + pace * int(work[np.uint64(WAIT * LANES) + k])
            touches = work[np.uint64(VERDICT * LANES) + k] > AWAY
            store(memory, o, (1.0 if touches else 0.0) * load(memory, o))
            hit[hits] = k
            hits += np.uint64(touches)
        n, bear, farthest = _put_down(
            hits, hit, of, work, n, bear, farthest, tri, w, pair, memory, borne, near, ids, near_c, bearing
        )
    return n, bear, farthest


@inner(error_model="numpy", fastmath={"contract"}, forceinline=True)
def _put_down(
    hits, hit, of, work, n, bear, farthest, tri, w, pair, memory, borne, near, ids, near_c, bearing
):  # fmt: skip
    """Append the touching pairs as rows from n on, except pairs in which nothing can move. hit[:hits]: the lanes
    of the touching pairs in `work` and `of`. borne: the bits of `memory`."""
    for m in range(hits):
        k = hit[m]
        o = of[k]
        i, t = pair[o, 0], pair[o, 1]
        p, q, r = tri[t, 0], tri[t, 1], tri[t, 2]
        b1, b2 = work[np.uint64(SECOND * LANES) + k], work[np.uint64(THIRD * LANES) + k]
        if w[i] == 0.0 and _inverse_mass(i, p, q, r, float(b1), float(b2), w) == 0.0:
            store(memory, o, vector(0.0, 0.0, 0.0))
            continue
        near_c[n] = o
        ids[n, TRIANGLE], ids[n, CORNERS], ids[n, CORNERS + 1], ids[n, CORNERS + 2] = t, p, q, r
        ids[n, VERTEX] = i
        for d in range(3):
            near[n, DIRECTION + d] = work[np.uint64((NORMAL + d) * LANES) + k]
        near[n, INSIDE], near[n, APART] = work[np.uint64(WITHIN * LANES) + k], work[np.uint64(GAP * LANES) + k]
        near[n, AIM], near[n, AT_SECOND], near[n, AT_THIRD] = work[np.uint64(LEAST * LANES) + k], b1, b2
        bearing[bear] = n
        bear += np.uint64((borne[o, 0] | borne[o, 1] | borne[o, 2]) != 0)
        n += ONE
        farthest = max(farthest, work[np.uint64(REACH * LANES) + k])
    return n, bear, farthest


@inner(error_model="numpy", fastmath={"contract"}, forceinline=True)
def _inverse_mass(i, p, q, r, b1, b2, w):
    """Return the inverse mass of vertex i against the point of a triangle with weights b1, b2 of the second and
    third corner."""
    b0 = 1.0 - b1 - b2
    return w[i] + b0 * b0 * w[p] + b1 * b1 * w[q] + b2 * b2 * w[r]


@inner(forceinline=True)
def find_due(count, now, pace, due, asked):
    """Write the pairs that have to be examined now to `asked`. Returns their number."""
    n = np.uint64(0)
    for c in range(np.uint64(count)):
        asked[n] = c
        n += np.uint64(is_due(due[c], now, pace))
    return n


@inner(forceinline=True)
def _join(n, near, ids, rank, ring, top):
    """Link the rows of each vertex in a ring, and find the row of the highest rank, `top`. A row ranks higher if
    the vertex is farther inside its triangle; among equal rows, the lower triangle index ranks higher."""
    for c in range(n):  # branch-free
        i, t = np.uint64(ids[c, VERTEX]), ids[c, TRIANGLE]
        rank[c] = (np.uint64(_ordered(near[c, INSIDE])) << np.uint64(32)) | np.uint64(np.uint32(~t))
        ring[c] = c
        h = np.uint64(c) if top[i] < 0 else np.uint64(top[i])
        ring[c] = ring[h]
        ring[h] = c
        top[i] = np.uint64(c) if rank[c] >= rank[h] else h


@inner(forceinline=True)
def _ordered(a):
    """Return an unsigned integer that sorts like the float: its bits with the sign bit inverted, or all inverted
    if it is negative."""
    bits = np.float32(a + ZERO).view(np.int32)  # adding 0 turns -0 into 0
    return np.uint32(bits ^ ((bits >> np.int32(31)) | np.int32(-(2**31))))


@inner(error_model="numpy", fastmath={"contract"}, forceinline=True)
def _meet_once(n, nearly, near, ids, rank, ring, better, asked, top, second):
    """Reduce the rows so that each vertex meets each sheet once. Among neighbouring, nearly coplanar triangles, a
    vertex over their common border meets only the triangle that it is farthest inside, and no border of the
    triangles beside it. The rows of these other triangles get a `better` row. There is one exception: if the
    vertex is over both triangles, a row is not replaced by a row that is farther away by more than `nearly` [m].
    On the border itself both rows describe the same contact; therefore no contact jumps, and the choice depends on
    positions alone. A row is AT_BEND if its vertex is beside its triangle and the triangle is joined to another
    one at an angle.

    The better row is mostly the top row or, for a layer on the other side, the `second` row. If neither of these
    two is the better row, all rows of the vertex are compared. Branch-free. asked, second: scratch.
    """
    end, left = np.uint64(0), np.uint64(0)
    for c in range(n):
        second[c] = c
    for c in range(n):
        within, h = near[c, INSIDE], np.uint64(top[np.uint64(ids[c, VERTEX])])
        s = np.uint64(second[h])
        second[h] = np.uint64(c) if (c != h) & ((s == h) | (rank[c] > rank[s])) else s
        met = (within > OVER) | ((h == c) & (within >= ZERO))
        stands = (rank[h] > rank[c]) & _stands_for(h, c, nearly, near, ids)
        better[c] = np.int64(h) if stands & (not met) else -1
        asked[end] = c
        end += np.uint64(not (met | stands))
    for m in range(end):
        own = np.uint64(asked[m])
        s = np.uint64(second[np.uint64(top[np.uint64(ids[own, VERTEX])])])
        met = (s == own) & (near[own, INSIDE] >= ZERO)
        stands = (rank[s] > rank[own]) & _stands_for(s, own, nearly, near, ids)
        better[own] = np.int64(s) if stands else -1
        asked[left] = own
        left += np.uint64(not (met | stands))
    for m in range(left):
        own = np.uint64(asked[m])
        best, most, at_bend = own, rank[own], False
        o = np.uint64(ring[own])
        while o != own:
            joined, alike = common_corner(ids, own, o), _alike(o, own, near)
            at_bend = at_bend | (joined & (alike <= ALIKE))
            its = rank[o] * np.uint64(joined & (alike > _least_alike(o, own, nearly, near)))
            best, most = (o if its > most else best), max(its, most)
            o = np.uint64(ring[o])
        alone = AT_BEND if at_bend & (near[own, INSIDE] < ZERO) else -1
        better[own] = np.int64(best) if best != own else alone
    for c in range(n):
        top[np.uint64(ids[c, VERTEX])] = -1


@inner(error_model="numpy", fastmath={"contract"}, forceinline=True)
def _stands_for(o, c, nearly, near, ids):
    """Return whether row o replaces row c, so that the vertex, which is farther inside the triangle of row o, need
    not meet the triangle of row c."""
    return common_corner(ids, c, o) & (_alike(o, c, near) > _least_alike(o, c, nearly, near))


@inner(error_model="numpy", fastmath={"contract"}, forceinline=True)
def _alike(o, c, near):
    """Return the cosine between the normals of two rows."""
    return (
        near[c, DIRECTION] * near[o, DIRECTION]
        + near[c, DIRECTION + 1] * near[o, DIRECTION + 1]
        + near[c, DIRECTION + 2] * near[o, DIRECTION + 2]
    )


@inner(forceinline=True)
def _least_alike(o, c, nearly, near):
    """Return the cosine above which row o replaces row c. If the vertex is over one of the triangles only, the
    border of the other triangle must not block the vertex, whichever of the two is nearer. If the vertex is over
    both triangles, o must not replace c when o belongs to a layer behind c."""
    over_both = ALIKE if near[o, APART] <= near[c, APART] + nearly else NEVER
    over_one = (near[c, INSIDE] < -OVER) & (near[o, INSIDE] >= -OVER)
    return ZERO if over_one else over_both


@inner(forceinline=True)
def _pass_on(n, bearing, better, near_c, memory):
    """Add the impulse of each row that has a better row to that better row."""
    for m in range(n):
        c = np.uint64(bearing[m])
        if better[c] >= 0:
            o = np.uint64(better[c])
            while better[o] >= 0:
                o = np.uint64(better[o])
            mine, its = np.uint64(near_c[c]), np.uint64(near_c[o])
            store(memory, its, load(memory, its) + load(memory, mine))
            store(memory, mine, vector(0.0, 0.0, 0.0))


@inner(error_model="numpy", fastmath={"contract"}, forceinline=True)
def _enter(
    count, thick, w, better, left, memory, near, ids, near_c, contact_vertices, contact_weights,
    contact_mobilities, contact_normals, contact_impulses, contact_pairs, contact_distances, contact_masses
):  # fmt: skip
    """Write the contacts of the rows without a better row. Returns their number. left: scratch, these rows.

    Beside a border, a vertex is held up as if it were over the triangle, so that hems rest on hems. At a bend,
    however, the plane of one triangle passes nearer than the thickness to a vertex that is over the other
    triangle. The contact must not push there: vertices would be thrown up, fall back and hop for ever.
    """
    nothing, n = vector(0.0, 0.0, 0.0), np.uint64(0)
    for c in range(count):
        left[n] = c
        n += np.uint64(better[c] < 0)
    for k in range(n):
        one = np.uint64(left[k])
        i, p, q, r = ids[one, VERTEX], ids[one, CORNERS], ids[one, CORNERS + 1], ids[one, CORNERS + 2]
        b1, b2 = float(near[one, AT_SECOND]), float(near[one, AT_THIRD])
        den = _inverse_mass(i, p, q, r, b1, b2, w)
        sinks = (near[one, INSIDE] < -OVER) | (better[one] == AT_BEND)
        contact_distances[k] = float(near[one, AIM]) if sinks else thick
        den = max(den, LEAST_SHARE * max(max(w[i], w[p]), max(w[q], w[r])))
        contact_vertices[k, 0], contact_vertices[k, 1], contact_vertices[k, 2], contact_vertices[k, 3] = i, p, q, r
        b0 = 1.0 - b1 - b2
        contact_weights[k, 0], contact_weights[k, 1], contact_weights[k, 2], contact_weights[k, 3] = (
            1.0,
            -b0,
            -b1,
            -b2,
        )
        contact_mobilities[k, 0], contact_mobilities[k, 1], contact_mobilities[k, 2], contact_mobilities[k, 3] = (
            w[i],
            -b0 * w[p],
            -b1 * w[q],
            -b2 * w[r],
        )
        nx, ny, nz = near[one, DIRECTION], near[one, DIRECTION + 1], near[one, DIRECTION + 2]
        store(contact_normals, k, vector(float(nx), float(ny), float(nz)))
        pair = np.uint64(near_c[one])
        store(contact_impulses, k, load(memory, pair))
        store(memory, pair, nothing)
        contact_pairs[k], contact_masses[k] = pair, 1.0 / den
    return n
