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

from skills.cloth.contact import LEAST_SHARE, PARKED, is_due
from skills.cloth.corners import common_corner
from skills.cloth.lanes import LANES
from skills.cloth.vectors import load, store, store_singles, vector
from skills.cloth.vertex_sides import (
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
    TOUCHES,
    VERDICT,
    WAIT,
    WITHIN,
    judge_sides,
)

AT_BEND = -2  # instead of a better row
ONE, FULL = np.uint64(1), np.uint64(LANES)
ALIKE = 0.9  # cosine between the normals of neighbouring triangles that a vertex over their border meets as one
NEARLY = 0.5  # x thickness: but not for one that is nearer by more, as where layers are joined at a hem
NEVER = 2.0  # more than any cosine


@njit(nogil=True)
def narrow_vertex_triangle(count, now, pace, h, thick, tri, x, v, w, pairs, last):
    """Sides of the pairs, and those that can touch within `pace` substeps of h [s] as contacts from row 0 on; ->
    rows, and how far the fastest of them may go in this time [m]. last: (n,) scratch, -1."""
    near, farthest = _find_near(
        count, now, pace, h, thick, tri, x, v, w, pairs.vt, pairs.side, pairs.vt_due, pairs.vt_j, pairs.better,
        pairs.near_c, pairs.near_i, pairs.near_n, pairs.near_b, pairs.gap, pairs.inside, pairs.chain, pairs.top,
        last
    )  # fmt: skip
    _meet_once(
        near, np.float32(NEARLY * thick), pairs.vt, pairs.near_c, pairs.near_i, pairs.near_n, pairs.gap,
        pairs.inside, pairs.chain, pairs.top, pairs.better, last
    )  # fmt: skip
    rows = _enter(
        near, thick, w, pairs.better, pairs.inside, pairs.vt_j, pairs.near_c, pairs.near_i, pairs.near_n,
        pairs.near_b, pairs.act_i, pairs.act_b, pairs.act_s, pairs.act_n, pairs.act_m, pairs.act_c, pairs.act_d,
        pairs.act_w
    )  # fmt: skip
    return np.int64(rows), farthest


@njit(nogil=True, error_model="numpy", fastmath={"contract"}, forceinline=True)
def _find_near(
    count, now, pace, h, thick, tri, x, v, w, pair, side, due, memory, asked, near_c, near_i, near_n, near_b,
    gap, inside, chain, top, last
):  # fmt: skip
    """Sides of all pairs, and the rows of those that can touch; -> rows, and how far the fastest of them may go.
    Those of each vertex are chained up from `last`. asked: scratch, the pairs that are looked at now."""
    work, of, hit = np.zeros(ROWS * LANES, np.float32), np.zeros(LANES, np.uint64), np.zeros(LANES, np.uint64)
    pair, tri = pair.view(np.uint32), tri.view(np.uint32)
    farthest, n, c = np.float32(0.0), np.uint64(0), np.uint64(0)
    end = _find_due(count, now, pace, due, asked)
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
        for k in range(filled):  # without a guess about which of them touch
            o = of[k]
            side[o] = np.int8(work[np.uint64(SIDE * LANES) + k])
            due[o] = now + pace * int(work[np.uint64(WAIT * LANES) + k])
            touches = work[np.uint64(VERDICT * LANES) + k] == TOUCHES
            store(memory, o, (1.0 if touches else 0.0) * load(memory, o))
            hit[hits] = k
            hits += np.uint64(touches)
        n, farthest = _put_down(
            hits, hit, of, work, n, farthest, tri, w, pair, memory, near_c, near_i, near_n, near_b, gap, inside,
            chain, top, last
        )  # fmt: skip
    return n, farthest


@njit(nogil=True, error_model="numpy", fastmath={"contract"}, forceinline=True)
def _put_down(
    hits, hit, of, work, n, farthest, tri, w, pair, memory, near_c, near_i, near_n, near_b, gap, inside, chain,
    top, last
):  # fmt: skip
    """Rows from n on of those that touch, but for what nothing can move: hit[:hits], places in `work` and `of`."""
    for m in range(hits):
        k = hit[m]
        o = of[k]
        i, t = pair[o, 0], pair[o, 1]
        p, q, r = tri[t, 0], tri[t, 1], tri[t, 2]
        b1, b2 = float(work[np.uint64(SECOND * LANES) + k]), float(work[np.uint64(THIRD * LANES) + k])
        b0 = 1.0 - b1 - b2
        den = w[i] + b0 * b0 * w[p] + b1 * b1 * w[q] + b2 * b2 * w[r]
        if den == 0.0:
            store(memory, o, vector(0.0, 0.0, 0.0))
            continue
        near_c[n], near_i[n, 0], near_i[n, 1], near_i[n, 2], near_i[n, 3] = o, i, p, q, r
        for d in range(3):
            near_n[n, d] = work[np.uint64((NORMAL + d) * LANES) + k]
        near_b[n, 0], near_b[n, 1], near_b[n, 3] = b1, b2, den
        near_b[n, 2], gap[n] = work[np.uint64(LEAST * LANES) + k], work[np.uint64(GAP * LANES) + k]
        within, before = work[np.uint64(WITHIN * LANES) + k], last[i]
        inside[n], chain[n], last[i] = within, before, n
        most = np.uint64(top[np.uint64(before)]) if before >= 0 else n
        most_inside = within > inside[most] or (within == inside[most] and t < pair[np.uint64(near_c[most]), 1])
        top[n] = n if most_inside else most
        n += ONE
        farthest = max(farthest, work[np.uint64(REACH * LANES) + k])
    return n, farthest


@njit(nogil=True, forceinline=True)
def _find_due(count, now, pace, due, asked):
    """Which of the pairs are to be looked at now; -> their number."""
    n = np.uint64(0)
    for c in range(np.uint64(count)):
        asked[n] = c
        n += np.uint64(is_due(due[c], now, pace))
    return n


@njit(nogil=True, error_model="numpy", fastmath={"contract"}, forceinline=True)
def _meet_once(n, nearly, pair, near_c, near_i, near_n, gap, inside, chain, top, better, last):
    """Of neighbouring triangles in about one plane a vertex over their border meets the one that it is most inside
    of, and no border of those beside it: the rows of these get a `better` one, but where it is over both none that
    is farther away by more than `nearly` [m]. On the border itself they are the same contact, so that none jumps,
    and which one stays hangs on positions alone. Those beside a triangle that is joined to another one at an angle
    are AT_BEND."""
    for c in range(n):
        better[c] = -1
        own = inside[c]
        h = np.uint64(top[np.uint64(last[np.uint64(near_i[c, 0])])])
        if own > BORDER or (h == c and own >= 0.0):
            continue
        if h != c and _stands_for(h, c, nearly, near_i, near_n, gap, inside):
            better[c] = h
            continue
        best, most, of_best, at_bend = np.uint64(c), own, pair[np.uint64(near_c[c]), 1], False
        link = last[np.uint64(near_i[c, 0])]
        while link >= 0:  # without a guess about each
            o = np.uint64(link)
            joined, alike = _joined(o, c, near_i) & (o != c), _alike(o, c, near_n)
            within, of = inside[o], pair[np.uint64(near_c[o]), 1]
            at_bend = at_bend | (joined & (alike <= ALIKE))
            more = (within > most) | ((within == most) & (of < of_best))
            taken = joined & more & (alike > _least_alike(o, c, nearly, gap, inside))
            best, most, of_best = (o if taken else best), (within if taken else most), (of if taken else of_best)
            link = chain[o]
        if best != c:
            better[c] = best
        elif at_bend and own < 0.0:
            better[c] = AT_BEND
    for c in range(n):
        last[np.uint64(near_i[c, 0])] = -1


@njit(nogil=True, error_model="numpy", fastmath={"contract"}, forceinline=True)
def _stands_for(o, c, nearly, near_i, near_n, gap, inside):
    """Whether a vertex that is more inside of row o's triangle need not meet that of row c."""
    return _joined(o, c, near_i) and _alike(o, c, near_n) > _least_alike(o, c, nearly, gap, inside)


@njit(nogil=True, forceinline=True)
def _joined(o, c, near_i):
    """Whether the triangles of two rows have a common vertex."""
    return common_corner(near_i, c, o)


@njit(nogil=True, error_model="numpy", fastmath={"contract"}, forceinline=True)
def _alike(o, c, near_n):
    """Cosine between the normals of two rows."""
    return near_n[c, 0] * near_n[o, 0] + near_n[c, 1] * near_n[o, 1] + near_n[c, 2] * near_n[o, 2]


@njit(nogil=True, forceinline=True)
def _least_alike(o, c, nearly, gap, inside):
    """How alike row o has to be to stand for row c: over one of them, a border that the vertex slides towards must
    not stand in its way, whichever is nearer. Over both, o must not hide c if it is of a layer behind it."""
    over_both = ALIKE if gap[o] <= gap[c] + nearly else NEVER
    return 0.0 if inside[c] < -BORDER <= inside[o] else over_both


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
            o = np.uint64(better[c])
            while better[o] >= 0:
                o = np.uint64(better[o])
            mine, its = np.uint64(near_c[c]), np.uint64(near_c[o])
            store(memory, its, load(memory, its) + load(memory, mine))
            store(memory, mine, nothing)
    n, near_i = np.uint64(0), near_i.view(np.uint32)
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
        pair = np.uint64(near_c[c])
        store(act_m, n, load(memory, pair))
        store(memory, pair, nothing)
        act_c[n], act_d[n], act_w[n] = pair, aim, 1.0 / den
        n += ONE
    return n
