# mypy: allow-untyped-defs, allow-incomplete-defs
"""Narrow phase of vertices against triangles: which pairs touch, on which side, and as which one contact where a
vertex is near several triangles of one sheet.

The side of a pair follows the geometry as long as it is apart and is kept while it is near. A vertex that is not
over the triangle meets the nearest point of its border, from the side that it is remembered on or clearly is on:
else it could slip through over a corner that points at it.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from skills.cloth.contact import GIVE_UP, LEAST_SHARE, PARKED, RELEASE, STRAY, later
from skills.cloth.vectors import cross, dot, load, store, vector

BORDER = 0.05  # barycentric: so near an edge a vertex is over the border of two triangles
LEAN = 0.5  # a vertex beside a triangle is on a side of it if its way there is so steep (a sine)
ALIKE = 0.9  # cosine between the normals of neighbouring triangles that a vertex over their border meets as one


@njit(nogil=True)
def narrow_vertex_triangle(count, now, thick, span, tri, x, v, w, pairs, last):
    """Sides of the pairs, and those that can touch within `span` [s] as contacts from row 0 on; -> rows, and how
    far the fastest of them may go in this time [m]. last: (n,) scratch, -1."""
    near, farthest = _find_near(count, now, thick, span, tri, x, v, w, pairs, last)
    return _meet_once(near, pairs, last), farthest


@njit(nogil=True, error_model="numpy", fastmath={"contract"})
def _find_near(count, now, thick, span, tri, x, v, w, pairs, last):
    """Rows of all pairs that can touch; -> rows, and how far the fastest of them may go. Those of each vertex are
    chained up from `last`."""
    pair, side, due, memory = pairs.vt, pairs.side, pairs.vt_due, pairs.vt_j
    act_i, act_b = pairs.act_i, pairs.act_b
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
            due[c] = later(now, abs(d) - release, reach)
            continue
        # barycentric coordinates of the projection
        b1, b2 = scale * dot(cross(to, b), normal), scale * dot(cross(a, to), normal)
        b0 = 1.0 - b1 - b2
        s, aim, within = side[c], thick, min(b0, min(b1, b2))
        if within < 0.0:
            # beside the triangle, at least so far: the height over an edge is twice the area by its length
            edge = b - a if within == b0 else (b if within == b1 else a)
            away = np.sqrt(d * d + within * within * nn / dot(edge, edge))
            if away > max(release, thick + reach):
                side[c] = 0
                due[c] = later(now, away - release, reach)
                continue
            b1, b2 = _on_border(to, a, b)
            b0 = 1.0 - b1 - b2
            way = to - b1 * a - b2 * b
            away = np.sqrt(dot(way, way))
            if away > release:
                s = side[c] = 0
            if away > thick + reach:
                due[c] = later(now, away - release, reach)
                continue
            if s == 0 and abs(d) > LEAN * away:
                s = 1 if d > 0.0 else -1
            if s * d <= 0.0:
                continue
            if away < thick:
                normal = (1.0 / away) * way
            else:
                if s < 0:
                    normal = -normal
                if within < -BORDER:  # it may slide on over the triangle, but sink no deeper
                    aim = min(thick, s * d)
        else:
            if s != 0 and (s * d > release or s * d < -give_up):
                s = side[c] = 0
            if s == 0:
                s = 1 if d > 0.0 else -1
            if s * d > thick + reach:
                continue
            if s < 0:
                normal = -normal
        side[c] = s  # what comes fast may be through by the next narrow phase
        den = w[i] + b0 * b0 * w[p] + b1 * b1 * w[q] + b2 * b2 * w[r]
        if den == 0.0:
            continue
        den = max(den, LEAST_SHARE * max(max(w[i], w[p]), max(w[q], w[r])))
        act_i[n, 0], act_i[n, 1], act_i[n, 2], act_i[n, 3] = i, p, q, r
        act_b[n, 0], act_b[n, 1], act_b[n, 2], act_b[n, 3] = 1.0, -b0, -b1, -b2
        store(pairs.act_n, n, normal)
        store(pairs.act_m, n, borne)
        pairs.act_c[n], pairs.act_d[n], pairs.act_w[n] = c, aim, 1.0 / den
        pairs.inside[n], pairs.chain[n], last[i] = within, last[i], n
        n += 1
        farthest = max(farthest, reach)
    return n, farthest


@njit(nogil=True, error_model="numpy", fastmath={"contract"})
def _on_border(to, a, b):
    """Of the point of the border of a triangle 0, a, b that is nearest to a point: the weights of a and b."""
    s, s2 = _along(to, a)
    t, t2 = _along(to - a, b - a)
    u, u2 = _along(to, b)
    if s2 <= t2 and s2 <= u2:
        return s, 0.0
    if t2 <= u2:
        return 1.0 - t, t
    return 0.0, u


@njit(nogil=True, error_model="numpy", fastmath={"contract"})
def _along(to, edge):
    """Where on an edge from 0 the point nearest to another one is, from 0 to 1, and its squared distance."""
    t = min(max(dot(edge, to) / (dot(edge, edge) + 1e-30), 0.0), 1.0)
    rest = to - t * edge
    return t, dot(rest, rest)


@njit(nogil=True, error_model="numpy", fastmath={"contract"})
def _meet_once(n, pairs, last):
    """Of neighbouring triangles in about one plane a vertex over their border meets the one that it is most inside
    of, and no border of those beside it; this one bears what the others bore; -> rows. On the border itself they
    are the same contact, so that none jumps, and which one stays hangs on positions alone."""
    act_i, act_b, inside, better = pairs.act_i, pairs.act_b, pairs.inside, pairs.better
    for c in range(n):
        better[c] = -1
        most = inside[c]
        if most > BORDER:
            continue
        o, normal = last[act_i[c, 0]], load(pairs.act_n, c)
        while o >= 0:
            deeper = inside[o]
            if deeper >= most and o != c and (deeper > most or _comes_first(pairs, c, o)) and _joined(act_i, c, o):
                # over one of them: a border that it slides towards must not stand in its way
                over = inside[c] < -BORDER <= deeper
                if dot(normal, load(pairs.act_n, o)) > (0.0 if over else ALIKE):
                    better[c], most = o, deeper
            o = pairs.chain[o]
    for c in range(n):
        last[act_i[c, 0]] = -1
        if better[c] >= 0:
            o = better[c]
            while better[o] >= 0:
                o = better[o]
            store(pairs.act_m, o, load(pairs.act_m, o) + load(pairs.act_m, c))
    kept = 0
    for c in range(n):
        if better[c] >= 0:
            continue
        if kept < c:
            for m in range(4):
                act_i[kept, m], act_b[kept, m] = act_i[c, m], act_b[c, m]
            store(pairs.act_n, kept, load(pairs.act_n, c))
            store(pairs.act_m, kept, load(pairs.act_m, c))
            pairs.act_d[kept], pairs.act_w[kept] = pairs.act_d[c], pairs.act_w[c]
            pairs.act_c[kept] = pairs.act_c[c]
        kept += 1
    return kept


@njit(nogil=True)
def _comes_first(pairs, c, o):
    """Whether row o has a triangle of lower number than what is the best for row c so far."""
    best = pairs.better[c] if pairs.better[c] >= 0 else c
    return pairs.vt[pairs.act_c[o], 1] < pairs.vt[pairs.act_c[best], 1]


@njit(nogil=True)
def _joined(act_i, c, o):
    """Whether the triangles of two rows have a common vertex."""
    p, q, r = act_i[c, 1], act_i[c, 2], act_i[c, 3]
    s, t, u = act_i[o, 1], act_i[o, 2], act_i[o, 3]
    return (p == s) | (p == t) | (p == u) | (q == s) | (q == t) | (q == u) | (r == s) | (r == t) | (r == u)
