# mypy: allow-untyped-defs, allow-incomplete-defs
"""Narrow phase of vertices against triangles: which pairs touch, and as which one contact where a vertex is near
several triangles of one sheet.

Nearly all of the time goes into fetching what a pair needs, and into guesses about it that turn out wrong. So the
pairs are judged LANES at once (vertex_sides.py), those that touch are noted in short rows, and only those that are
left when each vertex meets each sheet once become contacts.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from skills.cloth.contact import LEAST_SHARE, PARKED, is_due, later
from skills.cloth.corners import common_corner
from skills.cloth.lanes import LANES
from skills.cloth.vectors import load, store, store_singles, vector
from skills.cloth.vertex_sides import (
    AWAY,
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
    TOUCHES,
    VERDICT,
    WITHIN,
    judge_sides,
)

BORDER = 0.05  # barycentric: so near an edge a vertex is over the border of two triangles
AT_BEND = -2  # instead of a better row
ALIKE = 0.9  # cosine between the normals of neighbouring triangles that a vertex over their border meets as one


@njit(nogil=True)
def narrow_vertex_triangle(count, now, pace, h, thick, tri, x, v, w, pairs, last):
    """Sides of the pairs, and those that can touch within `pace` substeps of h [s] as contacts from row 0 on; ->
    rows, and how far the fastest of them may go in this time [m]. last: (n,) scratch, -1."""
    near, farthest = _find_near(
        count, now, pace, h, thick, tri, x, v, w, pairs.vt, pairs.side, pairs.vt_due, pairs.vt_j, pairs.near_c,
        pairs.near_i, pairs.near_n, pairs.near_b, pairs.inside, pairs.chain, pairs.top, last
    )  # fmt: skip
    _meet_once(
        near, pairs.vt, pairs.near_c, pairs.near_i, pairs.near_n, pairs.inside, pairs.chain, pairs.top,
        pairs.better, last
    )  # fmt: skip
    rows = _enter(
        near, thick, w, pairs.better, pairs.inside, pairs.vt_j, pairs.near_c, pairs.near_i, pairs.near_n,
        pairs.near_b, pairs.act_i, pairs.act_b, pairs.act_s, pairs.act_n, pairs.act_m, pairs.act_c, pairs.act_d,
        pairs.act_w
    )  # fmt: skip
    return rows, farthest


@njit(nogil=True, error_model="numpy", fastmath={"contract"}, forceinline=True)
def _find_near(
    count, now, pace, h, thick, tri, x, v, w, pair, side, due, memory, near_c, near_i, near_n, near_b, inside,
    chain, top, last
):  # fmt: skip
    """Sides of all pairs, and the rows of those that can touch; -> rows, and how far the fastest of them may go.
    Those of each vertex are chained up from `last`."""
    work, of = np.zeros(ROWS * LANES, np.float32), np.zeros(LANES, np.int64)
    nothing = vector(0.0, 0.0, 0.0)
    members, tri = pair.view(np.uint32), tri.view(np.uint32)
    n, farthest, c, span = 0, np.float32(0.0), 0, np.float32(pace * h)
    while c < count:
        filled = 0
        while c < count and filled < LANES:
            if is_due(due[c], now, pace):
                i, t = members[c, 0], members[c, 1]
                p, q, r = tri[t, 0], tri[t, 1], tri[t, 2]
                if w[i] + w[p] + w[q] + w[r] == 0.0:
                    due[c] = PARKED
                else:
                    corner = load(x, p)
                    store_singles(work, TO_SECOND * LANES + filled, LANES, load(x, q) - corner)
                    store_singles(work, TO_THIRD * LANES + filled, LANES, load(x, r) - corner)
                    store_singles(work, TO_VERTEX * LANES + filled, LANES, load(x, i) - corner)
                    store_singles(work, SLIDE * LANES + filled, LANES, load(v, i) - load(v, p))
                    work[SIDE * LANES + filled] = side[c]
                    of[filled] = c
                    filled += 1
            c += 1
        judge_sides(work, np.float32(thick), span)
        for k in range(filled):
            o = of[k]
            side[o] = np.int8(work[SIDE * LANES + k])
            verdict, reach = work[VERDICT * LANES + k], work[REACH * LANES + k]
            i, t = members[o, 0], members[o, 1]
            b1, b2 = float(work[SECOND * LANES + k]), float(work[THIRD * LANES + k])
            b0 = 1.0 - b1 - b2
            den = w[i] + b0 * b0 * w[tri[t, 0]] + b1 * b1 * w[tri[t, 1]] + b2 * b2 * w[tri[t, 2]]
            if verdict != TOUCHES or den == 0.0:
                store(memory, o, nothing)
                if verdict == AWAY:
                    due[o] = later(now, pace, work[GAP * LANES + k], reach)
                continue
            near_c[n], near_i[n, 0] = o, i
            for m in range(3):
                near_i[n, m + 1], near_n[n, m] = tri[t, m], work[(NORMAL + m) * LANES + k]
            near_b[n, 0], near_b[n, 1], near_b[n, 2], near_b[n, 3] = b1, b2, work[LEAST * LANES + k], den
            within, before = work[WITHIN * LANES + k], last[i]
            inside[n], chain[n], last[i] = within, before, n
            most = top[before] if before >= 0 else n
            most_inside = within > inside[most] or (within == inside[most] and t < pair[near_c[most], 1])
            top[n] = n if most_inside else most
            n += 1
            farthest = max(farthest, reach)
    return n, farthest


@njit(nogil=True, error_model="numpy", fastmath={"contract"}, forceinline=True)
def _meet_once(n, pair, near_c, near_i, near_n, inside, chain, top, better, last):
    """Of neighbouring triangles in about one plane a vertex over their border meets the one that it is most inside
    of, and no border of those beside it: the rows of these get a `better` one. On the border itself they are the
    same contact, so that none jumps, and which one stays hangs on positions alone. Those beside a triangle that
    is joined to another one at an angle are AT_BEND."""
    for c in range(n):
        better[c] = -1
        most, h = inside[c], top[last[near_i[c, 0]]]
        if most > BORDER or (h == c and most >= 0.0):
            continue
        if h != c and _stands_for(h, c, near_i, near_n, inside):
            better[c] = h
            continue
        best, o = c, last[near_i[c, 0]]
        while o >= 0:
            first = inside[o] == most and pair[near_c[o], 1] < pair[near_c[best], 1]
            more = inside[o] > most or first
            if o != c and (more or (inside[c] < 0.0 and better[c] != AT_BEND)) and _joined(o, c, near_i):
                alike = _alike(o, c, near_n)
                if inside[c] < 0.0 and alike <= ALIKE:
                    better[c] = AT_BEND
                if more and alike > _least_alike(o, c, inside):
                    best, most = o, inside[o]
            o = chain[o]
        if best != c:
            better[c] = best
    for c in range(n):
        last[near_i[c, 0]] = -1


@njit(nogil=True, error_model="numpy", fastmath={"contract"}, forceinline=True)
def _stands_for(o, c, near_i, near_n, inside):
    """Whether a vertex that is more inside of row o's triangle need not meet that of row c."""
    return _joined(o, c, near_i) and _alike(o, c, near_n) > _least_alike(o, c, inside)


@njit(nogil=True, forceinline=True)
def _joined(o, c, near_i):
    """Whether the triangles of two rows have a common vertex."""
    return common_corner(near_i, c, o)


@njit(nogil=True, error_model="numpy", fastmath={"contract"}, forceinline=True)
def _alike(o, c, near_n):
    """Cosine between the normals of two rows."""
    return near_n[c, 0] * near_n[o, 0] + near_n[c, 1] * near_n[o, 1] + near_n[c, 2] * near_n[o, 2]


@njit(nogil=True, forceinline=True)
def _least_alike(o, c, inside):
    """How alike row o has to be to stand for row c: over one of them, a border that the vertex slides towards must
    not stand in its way."""
    return 0.0 if inside[c] < -BORDER <= inside[o] else ALIKE


@njit(nogil=True, error_model="numpy", fastmath={"contract"}, forceinline=True)
def _enter(
    near, thick, w, better, inside, memory, near_c, near_i, near_n, near_b, act_i, act_b, act_s, act_n, act_m,
    act_c, act_d, act_w
):  # fmt: skip
    """Contacts of those that have no better one; it bears what they bore. -> rows

    Beside a border a vertex is held up as over it, so that hems rest on hems. But at a bend the plane of one
    triangle passes nearer to what lies over the other than cloth is thick. There it must push nothing: vertices
    were thrown up, fell back, and hopped so for ever."""
    nothing = vector(0.0, 0.0, 0.0)
    for c in range(near):
        if better[c] >= 0:
            o = better[c]
            while better[o] >= 0:
                o = better[o]
            store(memory, near_c[o], load(memory, near_c[o]) + load(memory, near_c[c]))
            store(memory, near_c[c], nothing)
    n = 0
    for c in range(near):
        if better[c] >= 0:
            continue
        i, p, q, r = near_i[c, 0], near_i[c, 1], near_i[c, 2], near_i[c, 3]
        b1, b2, least, den = near_b[c, 0], near_b[c, 1], near_b[c, 2], near_b[c, 3]
        aim = least if inside[c] < -BORDER or better[c] == AT_BEND else thick
        den = max(den, LEAST_SHARE * max(max(w[i], w[p]), max(w[q], w[r])))
        act_i[n, 0], act_i[n, 1], act_i[n, 2], act_i[n, 3] = i, p, q, r
        b0 = 1.0 - b1 - b2
        act_b[n, 0], act_b[n, 1], act_b[n, 2], act_b[n, 3] = 1.0, -b0, -b1, -b2
        act_s[n, 0], act_s[n, 1], act_s[n, 2], act_s[n, 3] = w[i], -b0 * w[p], -b1 * w[q], -b2 * w[r]
        store(act_n, n, vector(float(near_n[c, 0]), float(near_n[c, 1]), float(near_n[c, 2])))
        store(act_m, n, load(memory, near_c[c]))
        store(memory, near_c[c], nothing)
        act_c[n], act_d[n], act_w[n] = near_c[c], aim, 1.0 / den
        n += 1
    return n
