# mypy: allow-untyped-defs, allow-incomplete-defs
"""Evaluates positions of vertices relative to triangles: side, distance, nearest point, and the distance to
maintain. LANES pairs are evaluated together, in single precision, relative to a corner of the triangle.

While a pair is apart, its side follows the geometry; while it is near, its side is fixed. A vertex is beside a
triangle if its projection is outside the triangle. Such a vertex has contact with the nearest point of the border,
on the remembered side or, if no side is remembered, on the side on which the vertex clearly is. Without this
contact, the vertex could slip through at a corner that points towards it. While the vertex is farther from the
border than the thickness, it may slide parallel to the triangle, but not sink towards its plane. A vertex that has
slid past the border sinks gradually around it, as around a rounded edge. If its contact ended suddenly, the load
on the vertex would throw it past the border before the next examination, and the edge contacts that take over
would remember the wrong side.

All quantities are rows of LANES numbers in one flat array. With constant offsets in one array, the compiler can
tell that no two rows overlap, and vectorises the loop.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from foldcell.skills.cloth.contact.contacts import GIVE_UP, MAX_WAIT, RELEASE, STRAY
from foldcell.skills.cloth.simd.i32x16 import LANES

# A vertex is over the border of two triangles if its least barycentric coordinate is between -BORDER and BORDER.
BORDER = 0.05
# A vertex begins to sink around a border when it is so far past the border that, at a height of one thickness
# above the plane, its distance from the border would be more than thickness + SLIP [m]. The vertex sinks by at
# most SINK x thickness per examination.
SLIP, SINK = 0.5 * STRAY, 0.1
LEAN = 0.5  # sine of the elevation above the plane at which a vertex beside a triangle clearly is on one side

# Input rows: vectors from a corner of the triangle to the two other corners and to the vertex; velocity of the
# vertex relative to this corner; remembered side.
TO_SECOND, TO_THIRD, TO_VERTEX, SLIDE, SIDE = 0, 3, 6, 9, 12
# Output rows, besides SIDE. VERDICT: AWAY, TOUCHES or neither; WAIT: for a pair that is away, the time until its
# next examination in units of the pace (rounded down, `later` in contacts.py), else 0; REACH: distance that the
# pair may move within the span. Of the contact: NORMAL; SECOND, THIRD: weights of the second and third corner;
# WITHIN: the least barycentric coordinate, always below -BORDER where the vertex sinks around the border; LEAST:
# the distance to maintain: the thickness, or less for a vertex beside the triangle that does not touch its border,
# since the contact must not push such a vertex; GAP: the distance, negative if the vertex is over the triangle on
# the wrong side.
VERDICT, WAIT, REACH, NORMAL, SECOND, THIRD, WITHIN, LEAST, GAP = 13, 14, 15, 16, 19, 20, 21, 22, 23
ROWS = 24
AWAY, TOUCHES = 1.0, 2.0

ZERO, ONE, TINY = np.float32(0.0), np.float32(1.0), np.float32(1e-30)  # TINY: added to denominators that may be 0
NO_AREA = np.float32(1e-20)  # [m4] a triangle has no normal if the square of twice its area is less


@njit(nogil=True, error_model="numpy", fastmath={"contract"}, forceinline=True)
def judge_sides(work, thick, span):
    """Evaluate LANES pairs. Inputs and results are in the rows of `work`, (ROWS * LANES,) float32. thick [m]: the
    contact distance; span [s]: time until the next examination."""
    release, give_up = np.float32(RELEASE) * thick, np.float32(GIVE_UP) * thick
    for k in range(LANES):
        ax, ay, az = work[k], work[LANES + k], work[2 * LANES + k]
        bx, by, bz = work[3 * LANES + k], work[4 * LANES + k], work[5 * LANES + k]
        px, py, pz = work[6 * LANES + k], work[7 * LANES + k], work[8 * LANES + k]
        vx, vy, vz = work[9 * LANES + k], work[10 * LANES + k], work[11 * LANES + k]
        remembered = work[SIDE * LANES + k]
        nx, ny, nz = ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx
        nn = nx * nx + ny * ny + nz * nz
        scale = ONE / np.sqrt(nn + TINY)
        nx, ny, nz = scale * nx, scale * ny, scale * nz
        d = nx * px + ny * py + nz * pz
        reach = np.float32(STRAY) + span * np.float32(1.5) * np.sqrt(vx * vx + vy * vy + vz * vz)
        # barycentric coordinates of the projection
        b1 = scale * (nx * (py * bz - pz * by) + ny * (pz * bx - px * bz) + nz * (px * by - py * bx))
        b2 = scale * (nx * (ay * pz - az * py) + ny * (az * px - ax * pz) + nz * (ax * py - ay * px))
        within = min(ONE - b1 - b2, min(b1, b2))
        beside = within < ZERO
        # the nearest point of each edge a, b and c = b - a, and the squared distance there
        cx, cy, cz = bx - ax, by - ay, bz - az
        qx, qy, qz = px - ax, py - ay, pz - az
        s = min(max((ax * px + ay * py + az * pz) / (ax * ax + ay * ay + az * az + TINY), ZERO), ONE)
        t = min(max((bx * px + by * py + bz * pz) / (bx * bx + by * by + bz * bz + TINY), ZERO), ONE)
        u = min(max((cx * qx + cy * qy + cz * qz) / (cx * cx + cy * cy + cz * cz + TINY), ZERO), ONE)
        rx, ry, rz = px - s * ax, py - s * ay, pz - s * az
        from_a = rx * rx + ry * ry + rz * rz
        rx, ry, rz = px - t * bx, py - t * by, pz - t * bz
        from_b = rx * rx + ry * ry + rz * rz
        rx, ry, rz = qx - u * cx, qy - u * cy, qz - u * cz
        from_c = rx * rx + ry * ry + rz * rz
        # the nearest point of the border, as weights of the second and third corner, and the vector from it to the
        # vertex
        on_a = (from_a <= from_c) & (from_a <= from_b)
        on_c = (not on_a) & (from_c <= from_b)
        e1 = s if on_a else (ONE - u if on_c else ZERO)
        e2 = ZERO if on_a else (u if on_c else t)
        wx, wy, wz = px - e1 * ax - e2 * bx, py - e1 * ay - e2 * by, pz - e1 * az - e2 * bz
        away = np.sqrt(wx * wx + wy * wy + wz * wz)
        out = away * away - d * d  # squared distance past the border
        slips = beside & (remembered != ZERO) & (out > np.float32(SLIP) * (thick + thick + np.float32(SLIP)))
        # true if the gap cannot close within the span: the pair is then apart, on whichever side
        far = (abs(d) > release + reach) | (beside & (away > thick + reach))
        gap = away if beside else abs(d)
        released = (away > release) if beside else ((remembered * d > release) | (remembered * d < -give_up))
        kept = ZERO if released else remembered
        clear = (not beside) | (abs(d) > np.float32(LEAN) * away)
        here = (ONE if d > ZERO else -ONE) if clear else ZERO
        side = here if kept == ZERO else kept
        touches = (side * d > ZERO if beside else side * d <= thick + reach) & (not far) & (nn > NO_AREA)
        stops = beside & (away < thick)
        inverse = ONE / (away + TINY)
        # a fast vertex may have passed through by the next examination, so its side is fixed from now on
        work[SIDE * LANES + k] = side if touches else (ZERO if far & (gap > release) else kept)
        work[VERDICT * LANES + k] = np.float32(AWAY) if far else (np.float32(TOUCHES) if touches else ZERO)
        wait = ONE + min(max(gap - release - reach, ZERO) / reach, np.float32(MAX_WAIT))
        work[WAIT * LANES + k] = wait if far else ZERO
        work[REACH * LANES + k] = reach
        work[NORMAL * LANES + k] = inverse * wx if stops else side * nx
        work[(NORMAL + 1) * LANES + k] = inverse * wy if stops else side * ny
        work[(NORMAL + 2) * LANES + k] = inverse * wz if stops else side * nz
        work[SECOND * LANES + k] = e1 if beside else b1
        work[THIRD * LANES + k] = e2 if beside else b2
        work[GAP * LANES + k] = away if beside else side * d
        work[WITHIN * LANES + k] = min(within, np.float32(-2.0 * BORDER)) if slips else within
        high = min(thick, side * d)
        lower = max(high - np.float32(SINK) * thick, min(high, np.sqrt(max(thick * thick - out, ZERO))))
        work[LEAST * LANES + k] = (lower if slips else high) if beside & (not stops) else thick
