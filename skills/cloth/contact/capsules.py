# mypy: allow-untyped-defs, allow-incomplete-defs
"""Lets fingers and wrists, modelled as capsules, push the cloth."""

from __future__ import annotations

import numpy as np

from foldcell.skills.cloth.inner import inner
from foldcell.skills.cloth.state import EDGES

PUSH_SPEED = 0.6  # [m/s] largest speed at which cloth inside a capsule is pushed out
CAPSULE_FRICTION = 0.3


@inner()
def near_capsules(parameters, state, cap_p0, cap_p1, cap_r, f):
    """Return (m, 2): the pairs of a capsule and a packed edge (sleep.py) that can meet within frame f."""
    found = [(0, 0)]
    found.pop()
    frame = parameters.h * parameters.substeps
    for k in range(len(cap_r)):
        for e in range(state.counts[EDGES]):
            i, j = state.edge[e, 0], state.edge[e, 1]
            s, t = _closest_free(state.x, i, j, cap_p0[f + 1, k], cap_p1[f + 1, k])
            d2 = 0.0
            travel = 0.0
            v2 = 0.0
            for m in range(3):
                c = cap_p0[f + 1, k, m] + t * (cap_p1[f + 1, k, m] - cap_p0[f + 1, k, m])
                d2 += ((1 - s) * state.x[i, m] + s * state.x[j, m] - c) ** 2
                travel = max(travel, abs(cap_p0[f + 1, k, m] - cap_p0[f, k, m]))
                v2 += max(state.v[i, m] ** 2, state.v[j, m] ** 2)
            reach = cap_r[k] + parameters.thickness + 0.005 + 2.0 * travel + 1.5 * np.sqrt(v2) * frame
            if d2 < reach * reach:
                found.append((k, e))
    out = np.empty((len(found), 2), np.int32)
    for r in range(len(found)):
        out[r, 0], out[r, 1] = found[r]
    return out


@inner()
def push_by_capsules(busy, a, a0, p0, q0, p1, q1, radius, near, h, edge, x, xp, wa):
    """Push edges, and thus vertices, away from capsules. The motion of the capsules is given; an edge is pushed if
    it comes nearer than `near` [m] to the surface of a capsule. busy: (m, 2) capsule and edge. The ends of the
    capsules move from p0, q0 to p1, q1 (k, 3) during the frame. a0, a: time as a share of the frame, at the
    beginning and at the end of the substep."""
    p, q, c, c0 = np.empty(3), np.empty(3), np.empty(3), np.empty(3)
    for row in range(len(busy)):
        k, e = busy[row, 0], busy[row, 1]
        i, j = edge[e, 0], edge[e, 1]
        for m in range(3):
            p[m] = p0[k, m] + a * (p1[k, m] - p0[k, m])
            q[m] = q0[k, m] + a * (q1[k, m] - q0[k, m])
        s, t = _closest_free(x, i, j, p, q)
        for m in range(3):
            c[m] = p[m] + t * (q[m] - p[m])
            b0 = p0[k, m] + a0 * (p1[k, m] - p0[k, m])
            b1 = q0[k, m] + a0 * (q1[k, m] - q0[k, m])
            c0[m] = b0 + t * (b1 - b0)
        _push_out(x, xp, wa, i, j, s, c, c0, radius[k] + near, h)


@inner()
def _push_out(x, xp, wa, i, j, s, c, c0, reach, h):
    """Move the point (1 - s) i + s j of edge i-j out of a ball of radius `reach` around c, with friction. The
    centre of the ball moved from c0 to c in this substep."""
    b = 1.0 - s
    d = np.empty(3)
    old = np.empty(3)
    n2 = 0.0
    for m in range(3):
        d[m] = b * x[i, m] + s * x[j, m] - c[m]
        old[m] = b * xp[i, m] + s * xp[j, m] - c0[m]
        n2 += d[m] * d[m]
    if n2 >= reach * reach or n2 < 1e-16:
        return
    den = max(b * b * wa[i] + s * s * wa[j], 0.25 * max(wa[i], wa[j]))
    if den == 0.0:
        return
    dist = np.sqrt(n2)
    depth = min(reach - dist, PUSH_SPEED * h)
    slide = np.empty(3)
    along = 0.0
    for m in range(3):
        slide[m] = d[m] - old[m]
        along += slide[m] * d[m] / dist
    t2 = 0.0
    for m in range(3):
        slide[m] -= along * d[m] / dist
        t2 += slide[m] * slide[m]
    slip = np.sqrt(t2)
    hold = min(1.0, CAPSULE_FRICTION * depth / slip) if slip > 1e-12 else 0.0
    for m in range(3):
        g = (depth * d[m] / dist - hold * slide[m]) / den
        x[i, m] += wa[i] * b * g
        x[j, m] += wa[j] * s * g


@inner()
def _closest_free(x, i, j, p, q):
    """Return the parameters (s, t), from 0 to 1, of the closest points of edge i-j and segment p-q."""
    a = e = f = c = b = 0.0
    for m in range(3):
        u, v, r = x[j, m] - x[i, m], q[m] - p[m], x[i, m] - p[m]
        a += u * u
        e += v * v
        f += v * r
        c += u * r
        b += u * v
    a += 1e-30
    e += 1e-30
    den = a * e - b * b
    s = min(max((b * f - c * e) / den, 0.0), 1.0) if den > 1e-12 * a * e else 0.5
    t = (b * s + f) / e
    if t < 0.0:
        t = 0.0
        s = min(max(-c / a, 0.0), 1.0)
    elif t > 1.0:
        t = 1.0
        s = min(max((b - c) / a, 0.0), 1.0)
    return s, t


@inner()
def squared_distance(x, i, p, q):
    """Return the squared distance of vertex i from segment p-q."""
    ax, ay, az = q[0] - p[0], q[1] - p[1], q[2] - p[2]
    rx, ry, rz = x[i, 0] - p[0], x[i, 1] - p[1], x[i, 2] - p[2]
    t = min(max((ax * rx + ay * ry + az * rz) / (ax * ax + ay * ay + az * az + 1e-30), 0.0), 1.0)
    dx, dy, dz = rx - t * ax, ry - t * ay, rz - t * az
    return dx * dx + dy * dy + dz * dz
