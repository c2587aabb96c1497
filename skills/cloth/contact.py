# mypy: allow-untyped-defs, allow-incomplete-defs
"""Self-contact of cloth: vertex against triangle and edge against edge.

The search for pairs is in patches.py. Narrow phase, every few substeps: which of the pairs are near, on which
side, and with which weights; such a contact is one linear constraint n . sum(b_i x_i) >= thickness until the
next narrow phase. The side of a pair follows the geometry as long as it is apart and is kept while it is
near: a pair that was pressed through is pushed back to where it came from. What comes so fast that it could be
through by the next narrow phase has the next one earlier.

Overlap that is older than the substep is released little by little, so that it makes next to no speed. Friction is
Coulomb's at position level, bounded by all that a contact has borne in the substep.

Every contact remembers, averaged over some substeps, what it bears, and begins with it (warm starting, as in
sequential impulses: Catto 2005). Few sweeps then carry a stack of layers without creep, with true masses: the
table bears the weight of all of them. The average, and not the last impulse, since the impulses and the speeds
would otherwise be two integrators in a ring, which swing.
"""

from __future__ import annotations

import numpy as np
from numba import njit

PHASE = 4  # substeps from one narrow phase to the next,
HASTE = 2  # or so few where something comes fast
RELEASE = 1.25  # x contact distance: beyond it a pair is apart and its side follows the geometry
GIVE_UP = 3.0  # x contact distance: a pair pressed through by more is let go
BORDER = 0.05  # barycentric: so near an edge a vertex is over the border of two triangles
LEAN = 0.5  # a vertex beside a triangle is on a side of it if its way there is so steep (a sine)
NEAR_PARALLEL = 0.02  # sin^2 of the angle between two edges below which their pair is left to the vertices
EDGE_SHARE = 0.5  # edge-edge contact distance, of the thickness
# a contact among vertices of which few may move is as heavy as this share of the lightest: one that can hardly
# act on it would be flung
LEAST_SHARE = 0.25
STRAY = 2.5e-4  # [m] between two narrow phases, that no relative speed foretells
PARKED = 2**30  # due date of a pair that sleeps
MAX_WAIT = 12  # phases that a pair which is far apart is left out
MEMORY = 0.05  # share of a substep's impulse that a contact's memory takes up: with all of it stacks swing
ALIKE = 0.9  # cosine between the normals of neighbouring triangles that a vertex over their border meets as one
OVERLAP_SHARE = 0.2  # of an old overlap is released a substep,
OVERLAP_SPEED = 0.10  # at most at this speed [m/s]


@njit(nogil=True, error_model="numpy", fastmath={"contract"})
def closest_on_segments(x, i, j, k, m):
    """Closest points of segments i-j and k-m (Ericson 2005, 5.1.9): parameters and p - q."""
    ax, ay, az = x[j, 0] - x[i, 0], x[j, 1] - x[i, 1], x[j, 2] - x[i, 2]
    bx, by, bz = x[m, 0] - x[k, 0], x[m, 1] - x[k, 1], x[m, 2] - x[k, 2]
    rx, ry, rz = x[i, 0] - x[k, 0], x[i, 1] - x[k, 1], x[i, 2] - x[k, 2]
    a = ax * ax + ay * ay + az * az + 1e-30
    e = bx * bx + by * by + bz * bz + 1e-30
    f = bx * rx + by * ry + bz * rz
    c = ax * rx + ay * ry + az * rz
    b = ax * bx + ay * by + az * bz
    den = a * e - b * b
    s = min(max((b * f - c * e) / den, 0.0), 1.0) if den > 1e-12 * a * e else 0.5
    t = (b * s + f) / e
    if t < 0.0:
        t = 0.0
        s = min(max(-c / a, 0.0), 1.0)
    elif t > 1.0:
        t = 1.0
        s = min(max((b - c) / a, 0.0), 1.0)
    return s, t, rx + s * ax - t * bx, ry + s * ay - t * by, rz + s * az - t * bz


@njit(nogil=True, error_model="numpy", fastmath={"contract"})
def _along(x, i, p, q):
    """Where on segment p-q the point nearest to i is, from 0 to 1, and its squared distance."""
    ax, ay, az = x[q, 0] - x[p, 0], x[q, 1] - x[p, 1], x[q, 2] - x[p, 2]
    rx, ry, rz = x[i, 0] - x[p, 0], x[i, 1] - x[p, 1], x[i, 2] - x[p, 2]
    t = min(max((ax * rx + ay * ry + az * rz) / (ax * ax + ay * ay + az * az + 1e-30), 0.0), 1.0)
    dx, dy, dz = rx - t * ax, ry - t * ay, rz - t * az
    return t, dx * dx + dy * dy + dz * dz


@njit(nogil=True, error_model="numpy", fastmath={"contract"})
def _from_border(x, i, p, q, r):
    """The point of a triangle's border that is nearest to vertex i: weights of the corners, and the way to i."""
    a, a2 = _along(x, i, p, q)
    b, b2 = _along(x, i, q, r)
    c, c2 = _along(x, i, r, p)
    if a2 <= b2 and a2 <= c2:
        b0, b1, b2 = 1.0 - a, a, 0.0
    elif b2 <= c2:
        b0, b1, b2 = 0.0, 1.0 - b, b
    else:
        b0, b1, b2 = c, 0.0, 1.0 - c
    dx = x[i, 0] - b0 * x[p, 0] - b1 * x[q, 0] - b2 * x[r, 0]
    dy = x[i, 1] - b0 * x[p, 1] - b1 * x[q, 1] - b2 * x[r, 1]
    dz = x[i, 2] - b0 * x[p, 2] - b1 * x[q, 2] - b2 * x[r, 2]
    return b0, b1, b2, dx, dy, dz


@njit(nogil=True, error_model="numpy", fastmath={"contract"})
def narrow_vertex_triangle(
    count,
    pair,
    side,
    due,
    now,
    tri,
    x,
    v,
    w,
    thick,
    span,
    memory,
    act_i,
    act_b,
    act_n,
    act_d,
    act_w,
    act_m,
    act_c,
    inside,
):
    """Sides of the pairs, and those that can touch within `span` [s] as contacts from row 0 on; -> rows, and how
    far the fastest of them may go in this time [m]. inside (rows,): the least barycentric coordinate of each.

    A vertex that is not over the triangle meets the nearest point of its border, from the side that it is
    remembered on or clearly is on: else it could slip through over a corner that points at it."""
    n = 0
    farthest = 0.0
    release, give_up = RELEASE * thick, GIVE_UP * thick
    for c in range(count):
        if due[c] > now:
            continue
        i, t = pair[c, 0], pair[c, 1]
        p, q, r = tri[t, 0], tri[t, 1], tri[t, 2]
        if w[i] + w[p] + w[q] + w[r] == 0.0:
            due[c] = PARKED
            continue
        jx, jy, jz = memory[c, 0], memory[c, 1], memory[c, 2]
        memory[c, 0] = memory[c, 1] = memory[c, 2] = 0.0
        ux, uy, uz = x[q, 0] - x[p, 0], x[q, 1] - x[p, 1], x[q, 2] - x[p, 2]
        vx, vy, vz = x[r, 0] - x[p, 0], x[r, 1] - x[p, 1], x[r, 2] - x[p, 2]
        nx, ny, nz = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
        nn = nx * nx + ny * ny + nz * nz
        if nn < 1e-20:
            continue
        scale = 1.0 / np.sqrt(nn)
        dx, dy, dz = x[i, 0] - x[p, 0], x[i, 1] - x[p, 1], x[i, 2] - x[p, 2]
        d = (nx * dx + ny * dy + nz * dz) * scale
        # the gap cannot close within the span: the pair is apart, whichever side
        sx, sy, sz = v[i, 0] - v[p, 0], v[i, 1] - v[p, 1], v[i, 2] - v[p, 2]
        reach = STRAY + span * 1.5 * np.sqrt(sx * sx + sy * sy + sz * sz)
        if abs(d) > release + reach:
            side[c] = 0
            due[c] = now + PHASE * (1 + int(min((abs(d) - release - reach) / reach, MAX_WAIT)))
            continue
        # barycentric coordinates of the projection
        b1 = ((dy * vz - dz * vy) * nx + (dz * vx - dx * vz) * ny + (dx * vy - dy * vx) * nz) / nn
        b2 = ((uy * dz - uz * dy) * nx + (uz * dx - ux * dz) * ny + (ux * dy - uy * dx) * nz) / nn
        b0 = 1.0 - b1 - b2
        s, aim = side[c], thick
        beside = min(b0, min(b1, b2))
        inside[n] = beside
        if beside < 0.0:
            # beside the triangle, at least so far: the height over an edge is twice the area by its length
            if beside == b0:
                across = (vx - ux) ** 2 + (vy - uy) ** 2 + (vz - uz) ** 2
            else:
                across = vx * vx + vy * vy + vz * vz if beside == b1 else ux * ux + uy * uy + uz * uz
            away = np.sqrt(d * d + beside * beside * nn / across)
            if away > max(release, thick + reach):
                side[c] = 0
                due[c] = now + PHASE * (1 + int(min(max(away - release - reach, 0.0) / reach, MAX_WAIT)))
                continue
            b0, b1, b2, dx, dy, dz = _from_border(x, i, p, q, r)
            away = np.sqrt(dx * dx + dy * dy + dz * dz)
            if away > release:
                s = side[c] = 0
            if away > thick + reach:
                due[c] = now + PHASE * (1 + int(min(max(away - release - reach, 0.0) / reach, MAX_WAIT)))
                continue
            if s == 0 and abs(d) > LEAN * away:
                s = 1 if d > 0.0 else -1
            if s * d <= 0.0:
                continue
            if away < thick:
                nx, ny, nz = dx / away, dy / away, dz / away
            else:
                nx, ny, nz = s * nx * scale, s * ny * scale, s * nz * scale
                if beside < -BORDER:  # it may slide on over the triangle, but sink no deeper
                    aim = min(thick, s * d)
        else:
            if s == 0:
                s = 1 if d > 0.0 else -1
            elif s * d > release or s * d < -give_up:
                s = side[c] = 0
                s = 1 if d > 0.0 else -1
            if s * d > thick + reach:
                continue
            nx, ny, nz = s * nx * scale, s * ny * scale, s * nz * scale
        side[c] = s  # what comes fast may be through by the next narrow phase
        den = w[i] + b0 * b0 * w[p] + b1 * b1 * w[q] + b2 * b2 * w[r]
        if den == 0.0:
            continue
        den = max(den, LEAST_SHARE * max(max(w[i], w[p]), max(w[q], w[r])))
        act_i[n, 0], act_i[n, 1], act_i[n, 2], act_i[n, 3] = i, p, q, r
        act_b[n, 0], act_b[n, 1], act_b[n, 2], act_b[n, 3] = 1.0, -b0, -b1, -b2
        act_n[n, 0], act_n[n, 1], act_n[n, 2] = nx, ny, nz
        act_d[n] = aim
        act_w[n] = 1.0 / den
        act_m[n, 0], act_m[n, 1], act_m[n, 2] = jx, jy, jz
        act_c[n] = c
        n += 1
        farthest = max(farthest, reach)
    return n, farthest


@njit(nogil=True, error_model="numpy", fastmath={"contract"})
def meet_once(n, pair, last, chain, better, inside, act_i, act_b, act_n, act_d, act_w, act_m, act_c):
    """Of neighbouring triangles in about one plane a vertex over their border meets the one that it is most inside
    of, and no border of those beside it; this one bears what the others bore; -> rows. On the border itself they
    are the same contact, so that none jumps, and which one stays hangs on positions alone. last (vertices,), -1;
    chain, better (rows,): scratch; inside (rows,): the least barycentric coordinate of each."""
    for c in range(n):
        i = act_i[c, 0]
        chain[c], last[i] = last[i], c
    for c in range(n):
        better[c] = -1
        most = inside[c]
        if most > BORDER:
            continue
        o = last[act_i[c, 0]]
        while o >= 0:
            deeper = inside[o]
            if deeper >= most and o != c and (deeper > most or _comes_first(pair, act_c, better, c, o)):
                lean = act_n[c, 0] * act_n[o, 0] + act_n[c, 1] * act_n[o, 1] + act_n[c, 2] * act_n[o, 2]
                # over one of them: a border that it slides towards must not stand in its way
                over = inside[c] < -BORDER <= deeper
                if lean > (0.0 if over else ALIKE) and _joined(act_i, c, o):
                    better[c], most = o, deeper
            o = chain[o]
    for c in range(n):
        last[act_i[c, 0]] = -1
        if better[c] < 0:
            continue
        o = better[c]
        while better[o] >= 0:
            o = better[o]
        jx, jy, jz = act_m[c, 0], act_m[c, 1], act_m[c, 2]
        if jx != 0.0 or jy != 0.0 or jz != 0.0:
            act_m[o, 0] += jx
            act_m[o, 1] += jy
            act_m[o, 2] += jz
    kept = 0
    for c in range(n):
        if better[c] >= 0:
            continue
        if kept < c:
            for m in range(4):
                act_i[kept, m], act_b[kept, m] = act_i[c, m], act_b[c, m]
            for m in range(3):
                act_n[kept, m], act_m[kept, m] = act_n[c, m], act_m[c, m]
            act_d[kept], act_w[kept], act_c[kept] = act_d[c], act_w[c], act_c[c]
        kept += 1
    return kept


@njit(nogil=True)
def _comes_first(pair, act_c, better, c, o):
    """Whether row o has a triangle of lower number than what is the best for row c so far."""
    best = better[c] if better[c] >= 0 else c
    return pair[act_c[o], 1] < pair[act_c[best], 1]


@njit(nogil=True)
def _joined(act_i, c, o):
    """Whether the triangles of two contacts have a common vertex."""
    p, q, r = act_i[c, 1], act_i[c, 2], act_i[c, 3]
    s, t, u = act_i[o, 1], act_i[o, 2], act_i[o, 3]
    return (
        (p == s) | (p == t) | (p == u) | (q == s) | (q == t) | (q == u) | (r == s) | (r == t) | (r == u)
    )


@njit(nogil=True, error_model="numpy", fastmath={"contract"})
def _sided(c, nx, ny, nz, d, near, normal, release, give_up):
    """Normal and gap of two crossing edges on the side that they are remembered to be on."""
    lean = nx * normal[c, 0] + ny * normal[c, 1] + nz * normal[c, 2] if near[c] else d
    if lean < 0.0:
        nx, ny, nz, d = -nx, -ny, -nz, -d
    if near[c] and (d > release or d < -give_up):
        near[c] = False
        if d < 0.0:
            nx, ny, nz, d = -nx, -ny, -nz, -d
    elif d < release:
        near[c] = True
        normal[c, 0], normal[c, 1], normal[c, 2] = nx, ny, nz
    return nx, ny, nz, d


@njit(nogil=True, error_model="numpy", fastmath={"contract"})
def narrow_edge_edge(
    count,
    pair,
    near,
    normal,
    due,
    now,
    edge,
    rim,
    x,
    v,
    w,
    thick,
    span,
    memory,
    act_i,
    act_b,
    act_n,
    act_d,
    act_w,
    act_m,
    act_c,
    n,
):
    """The same for edge pairs; normal: (m, 3) the remembered direction from the second to the first edge.

    rim: (e,) edges of hems and seams. Two of these that meet edge-on, as sheets do that slide towards each other
    on the table, have no other normal than the shortest way from one to the other."""
    release, give_up = RELEASE * thick, GIVE_UP * thick
    farthest = 0.0
    for c in range(count):
        if due[c] > now:
            continue
        i, j = edge[pair[c, 0], 0], edge[pair[c, 0], 1]
        k, m = edge[pair[c, 1], 0], edge[pair[c, 1], 1]
        if w[i] + w[j] + w[k] + w[m] == 0.0:
            due[c] = PARKED
            continue
        jx, jy, jz = memory[c, 0], memory[c, 1], memory[c, 2]
        memory[c, 0] = memory[c, 1] = memory[c, 2] = 0.0
        s, t, dx, dy, dz = closest_on_segments(x, i, j, k, m)
        d2 = dx * dx + dy * dy + dz * dz
        sx = (1 - s) * v[i, 0] + s * v[j, 0] - (1 - t) * v[k, 0] - t * v[m, 0]
        sy = (1 - s) * v[i, 1] + s * v[j, 1] - (1 - t) * v[k, 1] - t * v[m, 1]
        sz = (1 - s) * v[i, 2] + s * v[j, 2] - (1 - t) * v[k, 2] - t * v[m, 2]
        reach = STRAY + span * 1.5 * np.sqrt(sx * sx + sy * sy + sz * sz)
        if d2 > (release + reach) ** 2:
            near[c] = False
            due[c] = now + PHASE * (1 + int(min((np.sqrt(d2) - release - reach) / reach, MAX_WAIT)))
            continue
        ax, ay, az = x[j, 0] - x[i, 0], x[j, 1] - x[i, 1], x[j, 2] - x[i, 2]
        bx, by, bz = x[m, 0] - x[k, 0], x[m, 1] - x[k, 1], x[m, 2] - x[k, 2]
        nx, ny, nz = ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx
        nn = nx * nx + ny * ny + nz * nz
        both = (ax * ax + ay * ay + az * az) * (bx * bx + by * by + bz * bz)
        inner = s > 1e-4 and s < 1.0 - 1e-4 and t > 1e-4 and t < 1.0 - 1e-4
        if nn < NEAR_PARALLEL * both or not inner:
            if near[c] and d2 > release * release:
                near[c] = False
            d = np.sqrt(d2)
            edge_on = rim[pair[c, 0]] and rim[pair[c, 1]] and not near[c] and d > 1e-6
            if not edge_on or d > thick + reach:
                continue
            nx, ny, nz = dx / d, dy / d, dz / d
        else:
            scale = 1.0 / np.sqrt(nn)
            nx, ny, nz = nx * scale, ny * scale, nz * scale
            d = nx * dx + ny * dy + nz * dz
            nx, ny, nz, d = _sided(c, nx, ny, nz, d, near, normal, release, give_up)
            if d <= thick + reach:
                near[c] = True
                normal[c, 0], normal[c, 1], normal[c, 2] = nx, ny, nz
        if d > thick + reach:
            continue
        den = (1 - s) ** 2 * w[i] + s * s * w[j] + (1 - t) ** 2 * w[k] + t * t * w[m]
        if den == 0.0:
            continue
        den = max(den, LEAST_SHARE * max(max(w[i], w[j]), max(w[k], w[m])))
        act_i[n, 0], act_i[n, 1], act_i[n, 2], act_i[n, 3] = i, j, k, m
        act_b[n, 0], act_b[n, 1], act_b[n, 2], act_b[n, 3] = 1 - s, s, t - 1, -t
        act_n[n, 0], act_n[n, 1], act_n[n, 2] = nx, ny, nz
        act_d[n] = thick
        act_w[n] = 1.0 / den
        act_m[n, 0], act_m[n, 1], act_m[n, 2] = jx, jy, jz
        act_c[n] = c
        n += 1
        farthest = max(farthest, reach)
    return n, farthest


@njit(nogil=True, error_model="numpy", fastmath={"contract"})
def apply_impulses(n, act_i, act_b, act_n, act_m, act_j, act_p, w, x, xp):
    """What the contacts have borne of late, to begin a substep with. act_p: (m, 4) how far apart the two sides of
    each contact were at its beginning, and how far along the normal."""
    for c in range(n):
        i, j, k, m = act_i[c, 0], act_i[c, 1], act_i[c, 2], act_i[c, 3]
        bi, bj, bk, bm = act_b[c, 0], act_b[c, 1], act_b[c, 2], act_b[c, 3]
        px = bi * xp[i, 0] + bj * xp[j, 0] + bk * xp[k, 0] + bm * xp[m, 0]
        py = bi * xp[i, 1] + bj * xp[j, 1] + bk * xp[k, 1] + bm * xp[m, 1]
        pz = bi * xp[i, 2] + bj * xp[j, 2] + bk * xp[k, 2] + bm * xp[m, 2]
        act_p[c, 0], act_p[c, 1], act_p[c, 2] = px, py, pz
        act_p[c, 3] = act_n[c, 0] * px + act_n[c, 1] * py + act_n[c, 2] * pz
        jx, jy, jz = act_m[c, 0], act_m[c, 1], act_m[c, 2]
        act_j[c, 0], act_j[c, 1], act_j[c, 2] = jx, jy, jz
        if jx != 0.0 or jy != 0.0 or jz != 0.0:
            _push(x, i, w[i] * bi, jx, jy, jz)
            _push(x, j, w[j] * bj, jx, jy, jz)
            _push(x, k, w[k] * bk, jx, jy, jz)
            _push(x, m, w[m] * bm, jx, jy, jz)


@njit(nogil=True, error_model="numpy", fastmath={"contract"})
def _push(x, i, s, jx, jy, jz):
    x[i, 0] += s * jx
    x[i, 1] += s * jy
    x[i, 2] += s * jz


@njit(nogil=True, error_model="numpy", fastmath={"contract"})
def solve_contacts(n, act_i, act_b, act_n, act_d, act_w, act_j, act_p, w, x, friction, h, sweep):
    """One sweep: no approach below the contact distance, old overlap released, Coulomb friction. act_j: (m, 3)
    what each contact has borne in this substep so far [kg m]; the sweep may take from it, but no contact pulls."""
    cap = OVERLAP_SPEED * h
    for row in range(n):
        c = row if sweep % 2 == 0 else n - 1 - row
        i, j, k, m = act_i[c, 0], act_i[c, 1], act_i[c, 2], act_i[c, 3]
        bi, bj, bk, bm = act_b[c, 0], act_b[c, 1], act_b[c, 2], act_b[c, 3]
        nx, ny, nz = act_n[c, 0], act_n[c, 1], act_n[c, 2]
        jx, jy, jz = act_j[c, 0], act_j[c, 1], act_j[c, 2]
        rx = bi * x[i, 0] + bj * x[j, 0] + bk * x[k, 0] + bm * x[m, 0]
        ry = bi * x[i, 1] + bj * x[j, 1] + bk * x[k, 1] + bm * x[m, 1]
        rz = bi * x[i, 2] + bj * x[j, 2] + bk * x[k, 2] + bm * x[m, 2]
        d = nx * rx + ny * ry + nz * rz
        borne = jx * nx + jy * ny + jz * nz
        if borne <= 0.0 and d >= act_d[c]:
            continue
        dp = act_p[c, 3]
        inv = act_w[c]
        # an old overlap is released slowly: it must not become speed
        aim = min(act_d[c], dp + min(OVERLAP_SHARE * (act_d[c] - dp), cap)) if dp < act_d[c] else act_d[c]
        press = max(0.0, borne + (aim - d) * inv)
        # the tangential motion of this substep, and what friction would have to bear to undo it
        away = d - dp
        tx = jx - nx * borne - inv * (rx - act_p[c, 0] - nx * away)
        ty = jy - ny * borne - inv * (ry - act_p[c, 1] - ny * away)
        tz = jz - nz * borne - inv * (rz - act_p[c, 2] - nz * away)
        hold = np.sqrt(tx * tx + ty * ty + tz * tz)
        share = min(1.0, friction * press / hold) if hold > 0.0 else 0.0
        gx = press * nx + share * tx
        gy = press * ny + share * ty
        gz = press * nz + share * tz
        act_j[c, 0], act_j[c, 1], act_j[c, 2] = gx, gy, gz
        gx, gy, gz = gx - jx, gy - jy, gz - jz
        _push(x, i, w[i] * bi, gx, gy, gz)
        _push(x, j, w[j] * bj, gx, gy, gz)
        _push(x, k, w[k] * bk, gx, gy, gz)
        _push(x, m, w[m] * bm, gx, gy, gz)


@njit(nogil=True)
def average_impulses(n, act_j, act_m):
    """Let the memory of each contact follow what it bore in this substep."""
    for c in range(n):
        for m in range(3):
            act_m[c, m] += MEMORY * (act_j[c, m] - act_m[c, m])


@njit(nogil=True)
def remember_impulses(n_vt, n, act_c, act_m, vt_j, ee_j):
    """Give what the contacts bear back to their pairs, until the next narrow phase."""
    for c in range(n):
        memory = vt_j if c < n_vt else ee_j
        for m in range(3):
            memory[act_c[c], m] = act_m[c, m]
