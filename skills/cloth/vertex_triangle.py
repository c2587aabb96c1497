# mypy: allow-untyped-defs, allow-incomplete-defs
"""Narrow phase of vertices against triangles: which pairs touch, on which side, and as which one contact where a
vertex is near several triangles of one sheet.

The side of a pair follows the geometry as long as it is apart and is kept while it is near. A vertex that is not
over the triangle meets the nearest point of its border, from the side that it is remembered on or clearly is on:
else it could slip through over a corner that points at it.

It goes in three steps, since most pairs that are near say the same as another one: which are near (`_find_near`),
which of these say something of their own (`_meet_once`), and what contacts these are (`_make_contacts`).
"""

from __future__ import annotations

import numpy as np
from numba import njit

from skills.cloth.contact import GIVE_UP, LEAST_SHARE, MAX_WAIT, PARKED, PHASE, RELEASE, STRAY
from skills.cloth.vectors import cross, dot, load, store, vector

BORDER = 0.05  # barycentric: so near an edge a vertex is over the border of two triangles
LEAN = 0.5  # a vertex beside a triangle is on a side of it if its way there is so steep (a sine)
ALIKE = 0.9  # cosine between the normals of neighbouring triangles that a vertex over their border meets as one


@njit(nogil=True)
def narrow_vertex_triangle(count, now, thick, span, tri, x, v, w, pairs, last):
    """Sides of the pairs, and those that can touch within `span` [s] as contacts from row 0 on; -> rows, and how
    far the fastest of them may go in this time [m]. last: (n,) scratch, -1."""
    near, farthest = _find_near(count, now, thick, span, tri, x, v, w, pairs, last)
    _meet_once(near, pairs, last)
    return _make_contacts(near, now, thick, x, w, pairs), farthest


@njit(nogil=True, error_model="numpy", fastmath={"contract"})
def _find_near(count, now, thick, span, tri, x, v, w, pairs, last):
    """Rows of pairs that are near: the vertices, the normal on the vertex's side, the height over the plane as
    act_d and the reach as act_w, what the pair bears; -> rows, and how far the fastest of them may go. Those of
    each vertex are chained up from `last`, the one that it is most inside of first."""
    pair, side, due, memory = pairs.vt, pairs.side, pairs.vt_due, pairs.vt_j
    act_i, inside = pairs.act_i, pairs.inside
    release, give_up, nothing = RELEASE * thick, GIVE_UP * thick, vector(0.0, 0.0, 0.0)
    n, farthest = 0, 0.0
    for c in range(count):
        if due[c] > now:
            continue
        i, t = pair[c, 0], pair[c, 1]
        p, q, r = tri[t, 0], tri[t, 1], tri[t, 2]
        if w[i] + w[p] + w[q] + w[r] == 0.0:
            due[c] = PARKED
            continue
        borne = load(memory, c)
        store(memory, c, nothing)
        corner = load(x, p)
        a, b, to = load(x, q) - corner, load(x, r) - corner, load(x, i) - corner
        normal = cross(a, b)
        nn = dot(normal, normal)
        if nn < 1e-20:
            continue
        scale = 1.0 / np.sqrt(nn)
        normal = scale * normal
        d = dot(normal, to)
        # the gap cannot close within the span: the pair is apart, whichever side
        slide = load(v, i) - load(v, p)
        reach = STRAY + span * 1.5 * np.sqrt(dot(slide, slide))
        if abs(d) > release + reach:
            side[c] = 0
            due[c] = _later(now, abs(d) - release, reach)
            continue
        # barycentric coordinates of the projection
        b1, b2 = scale * dot(cross(to, b), normal), scale * dot(cross(a, to), normal)
        b0 = 1.0 - b1 - b2
        within = min(b0, min(b1, b2))
        s = side[c]
        if within < 0.0:
            # beside the triangle, at least so far: the height over an edge is twice the area by its length
            edge = b - a if within == b0 else (b if within == b1 else a)
            away = np.sqrt(d * d + within * within * nn / dot(edge, edge))
            if away > release:
                s = side[c] = 0
            if away > thick + reach:
                due[c] = _later(now, away - release, reach)
                continue
            if s == 0 and abs(d) > LEAN * away:
                s = 1 if d > 0.0 else -1
            if s * d <= 0.0:
                continue
        else:
            if s != 0 and (s * d > release or s * d < -give_up):
                s = side[c] = 0
            if s == 0:
                s = 1 if d > 0.0 else -1
            if s * d > thick + reach:
                continue
        side[c] = s
        act_i[n, 0], act_i[n, 1], act_i[n, 2], act_i[n, 3] = i, p, q, r
        store(pairs.act_n, n, normal if s > 0 else -normal)
        store(pairs.act_m, n, borne)
        pairs.act_c[n], pairs.act_d[n], pairs.act_w[n], inside[n] = c, s * d, reach, within
        first = last[i]
        if first < 0 or within > inside[first]:
            pairs.chain[n], last[i] = first, n
        else:
            pairs.chain[n], pairs.chain[first] = pairs.chain[first], n
        n += 1
        farthest = max(farthest, reach)  # what comes fast may be through by the next narrow phase
    return n, farthest


@njit(nogil=True)
def _later(now, free, reach):
    """When a pair is to be looked at again that has to come nearer by `free`, and may by `reach` in a phase."""
    return now + PHASE * (1 + int(min(max(free - reach, 0.0) / reach, MAX_WAIT)))


@njit(nogil=True, error_model="numpy", fastmath={"contract"})
def _meet_once(n, pairs, last):
    """Of neighbouring triangles in about one plane a vertex over their border meets the one that it is most inside
    of, and no border of those beside it; this one bears what the others bore. better: (n,) the row that does, or
    -1. On the border itself they are the same contact, so that none jumps, and which one stays hangs on positions
    alone."""
    act_i, inside, better = pairs.act_i, pairs.inside, pairs.better
    for c in range(n):
        better[c] = -1
        if inside[c] > BORDER:
            continue
        o, normal = last[act_i[c, 0]], load(pairs.act_n, c)
        while o >= 0 and better[c] < 0:
            deeper = inside[o] > inside[c] or (inside[o] == inside[c] and _comes_first(pairs, o, c))
            if deeper and _joined(act_i, c, o):
                # over one of them: a border that it slides towards must not stand in its way
                over = inside[c] < -BORDER <= inside[o]
                if dot(normal, load(pairs.act_n, o)) > (0.0 if over else ALIKE):
                    better[c] = o
            o = pairs.chain[o]
    for c in range(n):
        last[act_i[c, 0]] = -1
        if better[c] >= 0:
            o = better[c]
            while better[o] >= 0:
                o = better[o]
            store(pairs.act_m, o, load(pairs.act_m, o) + load(pairs.act_m, c))


@njit(nogil=True)
def _comes_first(pairs, o, c):
    """Whether row o has a triangle of lower number than row c."""
    return pairs.vt[pairs.act_c[o], 1] < pairs.vt[pairs.act_c[c], 1]


@njit(nogil=True)
def _joined(act_i, c, o):
    """Whether the triangles of two rows have a common vertex."""
    p, q, r = act_i[c, 1], act_i[c, 2], act_i[c, 3]
    s, t, u = act_i[o, 1], act_i[o, 2], act_i[o, 3]
    return (
        (p == s) | (p == t) | (p == u) | (q == s) | (q == t) | (q == u) | (r == s) | (r == t) | (r == u)
    )


@njit(nogil=True, error_model="numpy", fastmath={"contract"})
def _make_contacts(near, now, thick, x, w, pairs):
    """The rows that nothing is better than, as contacts from row 0 on; -> rows."""
    act_i, act_b, side, due = pairs.act_i, pairs.act_b, pairs.side, pairs.vt_due
    n = 0
    for k in range(near):
        if pairs.better[k] >= 0:
            continue
        c, height, reach = pairs.act_c[k], pairs.act_d[k], pairs.act_w[k]
        i, p, q, r = act_i[k, 0], act_i[k, 1], act_i[k, 2], act_i[k, 3]
        place, at_p, at_q, at_r = load(x, i), load(x, p), load(x, q), load(x, r)
        normal, aim = load(pairs.act_n, k), thick
        if pairs.inside[k] < 0.0:
            b0, b1, b2 = _on_border(place, at_p, at_q, at_r)
            way = place - b0 * at_p - b1 * at_q - b2 * at_r
            away = np.sqrt(dot(way, way))
            if away > RELEASE * thick:
                side[c] = 0
            if away > thick + reach:
                due[c] = _later(now, away - RELEASE * thick, reach)
                continue
            if away < thick:
                normal = (1.0 / away) * way
            elif pairs.inside[k] < -BORDER:  # it may slide on over the triangle, but sink no deeper
                aim = min(thick, height)
        else:
            a, b, to = at_q - at_p, at_r - at_p, place - at_p
            scale = 1.0 / dot(cross(a, b), normal)
            b1, b2 = scale * dot(cross(to, b), normal), scale * dot(cross(a, to), normal)
            b0 = 1.0 - b1 - b2
        den = w[i] + b0 * b0 * w[p] + b1 * b1 * w[q] + b2 * b2 * w[r]
        if den == 0.0:
            continue
        den = max(den, LEAST_SHARE * max(max(w[i], w[p]), max(w[q], w[r])))
        act_i[n, 0], act_i[n, 1], act_i[n, 2], act_i[n, 3] = i, p, q, r
        act_b[n, 0], act_b[n, 1], act_b[n, 2], act_b[n, 3] = 1.0, -b0, -b1, -b2
        store(pairs.act_n, n, normal)
        store(pairs.act_m, n, load(pairs.act_m, k))
        pairs.act_d[n], pairs.act_w[n], pairs.act_c[n] = aim, 1.0 / den, c
        n += 1
    return n


@njit(nogil=True, error_model="numpy", fastmath={"contract"})
def _on_border(i, p, q, r):
    """Weights of the corners at the point of a triangle's border that is nearest to i."""
    a, a2 = _along(i, p, q)
    b, b2 = _along(i, q, r)
    c, c2 = _along(i, r, p)
    if a2 <= b2 and a2 <= c2:
        return 1.0 - a, a, 0.0
    if b2 <= c2:
        return 0.0, 1.0 - b, b
    return c, 0.0, 1.0 - c


@njit(nogil=True, error_model="numpy", fastmath={"contract"})
def _along(i, p, q):
    """Where on segment p-q the point nearest to i is, from 0 to 1, and its squared distance."""
    along, to = q - p, i - p
    t = min(max(dot(along, to) / (dot(along, along) + 1e-30), 0.0), 1.0)
    rest = to - t * along
    return t, dot(rest, rest)
