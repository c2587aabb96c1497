# mypy: allow-untyped-defs, allow-incomplete-defs
"""Plastic set: a pressed crease takes a rest turn, which it keeps when the load is gone.

Each hinge has a set, an angle towards which its elastic moment pulls: the moment acts on (turn - set). The set is
the sum of MODES parts. While the cloth at the hinge bears a pressure p [Pa], part m follows

    d set_m / dt = p / STANDARD_PRESSURE * (share_m * beyond(turn) - set_m) / time_m,

where beyond(turn) is the turn, less the part that stays elastic: YIELD_CURVATURE times the width of the hinge. The
times are a decade apart, so the set grows with the logarithm of the dwell and saturates. Pressure acts as a faster
clock: twice the pressure for half the time gives the same set. Cloth without pressure neither takes nor loses set;
a crease that is pressed flat loses its set by the same law. The law is linear in the turn, because a mesh puts the
180 degrees of a pressed crease into one row of hinges or into several; the set of the crease then does not depend
on their number. Friction in bending acts beside the set (elasticity.py).

Only one figure is known: `crease_set`. It is the share of `beyond` that is set after the standard test (AATCC 66
kind: STANDARD_PRESSURE for STANDARD_TIME). The form of the law, its times and its yield are assumed. Models in
print have friction, plasticity and dwell (arXiv 2502.13491), but no figures for a short load. Ranges: shortest
time 0.3 to 3 s (`crease_time`); yield curvature 20 to 80 /m, about the 23 to 54 /m that friction holds in denims.
A dab of a second by a fingertip follows the same law with the same constants; nobody has measured it.

Only bodies that press on the cloth cause pressure (`ClothSimulation.press`). Contact forces of the solver do not
count: the weight of cloth on cloth is a thousandth of the standard load (an 8-layer stack of jeans: 31 Pa). And
the solver pushes cloth away from fingers by positions, by at most 0.6 mm a substep, which is no true force.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit

from foldcell.robots.ports import Array
from foldcell.skills.cloth.inner import inner

STANDARD_PRESSURE = 18.17e3  # [Pa] 500 g on 15 x 18 mm of folded cloth
STANDARD_TIME = 300.0  # [s]
MODES = 4
SPREAD = 10.0  # ratio of one part's time to that of the part before it
YIELD_CURVATURE = 40.0  # [1/m] a bend up to this curvature stays elastic (assumed, 20 to 80)
LEAST_PRESSURE = 50.0  # [Pa] a lower pressure sets nothing in the time of a run
LITTLE = 0.01  # up to this value, two terms of the exponential's series are exact to a part in 50 000
FOLDED = 1.8  # turn from which a hinge is folded over, so that it may pass 180 degrees (128 degrees)
FOLDED_ANGLE = 2.24  # [rad] the same as an angle
SLIGHT = 0.1  # turn up to which the normals tell the direction of K x more exactly than K x itself


class CreaseLaw(NamedTuple):
    """The law for the hinges of one mesh, in the order of the hinges; the arrays are empty if no set is wanted.

    length: (h,) lengths of the edges [m]; allowance: (h,) turn up to which a hinge stays elastic [rad]; share:
    (MODES,) shares of the parts; rate: (MODES,) their rates [1/(Pa s)].
    """

    length: Array
    allowance: Array
    share: Array
    rate: Array


def set_share(equivalent_time: float, crease_time: float) -> float:
    """Return the share to which the set has grown: from 0 at the beginning towards 1 after a very long time.
    equivalent_time [s]: time under the standard pressure, or the integral of pressure over STANDARD_PRESSURE over
    time; crease_time [s]: shortest of the times of the law."""
    return float(np.mean(-np.expm1(-equivalent_time / _times(crease_time))))


def largest_crease_set(crease_time: float) -> float:
    """Return the crease_set with which a crease would keep all of its turn after a very long time."""
    return set_share(STANDARD_TIME, crease_time)


def build_crease_law(length: Array, width: Array, crease_set: float, crease_time: float) -> CreaseLaw:
    """Build the law. length, width: (h,) length of each hinge's edge, and width of the cloth that it bends [m];
    crease_set, crease_time [s]: see `SolverSettings`. With crease_set = 0 the arrays are empty."""
    if crease_set == 0.0:
        return CreaseLaw(np.zeros(0), np.zeros(0), np.zeros(0), np.zeros(0))
    share = np.full(MODES, crease_set / largest_crease_set(crease_time) / MODES)
    return CreaseLaw(length, YIELD_CURVATURE * width, share, 1.0 / (STANDARD_PRESSURE * _times(crease_time)))


def _times(crease_time: float) -> Array:
    return np.asarray(crease_time * SPREAD ** np.arange(MODES))


@njit(nogil=True)
def advance_set(law, hinge, x, pressure, seconds, side, parts, rest):
    """Advance the plastic set of every hinge by `seconds`, at the present shape x. The step is exact for any
    length of time in which shape and pressure do not change. pressure: (n,) pressure on the vertices [Pa]; side:
    (h,) see `aim_hinges`; parts: (h, MODES) the parts of each hinge's set [rad]. rest: (h,) the signed length that
    the hinge's bending vector K x (elasticity.py) has at rest [m]: the length of the edge times 2 sin(set / 2)."""
    for e in range(len(rest)):
        a, b, c, d = hinge[e, 0], hinge[e, 1], hinge[e, 2], hinge[e, 3]
        p = 0.25 * (pressure[a] + pressure[b] + pressure[c] + pressure[d])
        if p <= LEAST_PRESSURE:
            continue
        bent = _angle(x, a, b, c, d)
        if abs(bent) > FOLDED_ANGLE and bent * side[e] < 0.0:
            bent = side[e] * (2.0 * np.pi - abs(bent))
        beyond = np.copysign(max(0.0, abs(bent) - law.allowance[e]), bent)
        total = 0.0
        for m in range(len(law.share)):
            way = law.rate[m] * p * seconds
            grown = way - 0.5 * way * way if way < LITTLE else -np.expm1(-way)
            parts[e, m] += grown * (law.share[m] * beyond - parts[e, m])
            total += parts[e, m]
        rest[e] = 2.0 * np.sin(0.5 * total) * law.length[e]


@inner()
def _angle(x, a, b, c, d):
    """Return the signed angle [rad] of the hinge at edge a-b; the sign is that of `measure_turns`."""
    ex, ey, ez = x[b, 0] - x[a, 0], x[b, 1] - x[a, 1], x[b, 2] - x[a, 2]
    ux, uy, uz = x[c, 0] - x[a, 0], x[c, 1] - x[a, 1], x[c, 2] - x[a, 2]
    vx, vy, vz = x[d, 0] - x[a, 0], x[d, 1] - x[a, 1], x[d, 2] - x[a, 2]
    px, py, pz = ey * uz - ez * uy, ez * ux - ex * uz, ex * uy - ey * ux
    qx, qy, qz = vy * ez - vz * ey, vz * ex - vx * ez, vx * ey - vy * ex
    cos = px * qx + py * qy + pz * qz
    sin = (px * vx + py * vy + pz * vz) * np.sqrt(ex * ex + ey * ey + ez * ez)
    return np.arctan2(sin, cos)


@inner(error_model="numpy", fastmath={"contract"})
def aim_hinges(n, which, hinge, weight, axis, turn, rest, side, x, target):
    """Write to target (n, 3) the vector that K x is at rest, for each of the hinges which[:n]. `measure_turns` has
    to be called before. The vector has the direction of the present K x, so that the elastic force exerts no
    torque on the cloth. In nearly flat hinges, the direction of K x is not certain, so the vector is perpendicular
    to the cloth.

    side: (h,) sign of each turn when it was last below FOLDED. A pressed hinge may pass 180 degrees, since its own
    two triangles do not collide. Its measured turn then has the wrong sign, which is corrected here."""
    for k in range(n):
        e = which[k]
        if abs(turn[k]) < FOLDED:
            side[e] = np.copysign(1.0, turn[k])
        elif turn[k] * side[e] < 0.0:
            turn[k] = -turn[k]
            for m in range(6):
                axis[k, m] = -axis[k, m]
        if rest[e] == 0.0:
            target[k, 0] = target[k, 1] = target[k, 2] = 0.0
            continue
        rx = ry = rz = 0.0
        if abs(turn[k]) > SLIGHT:
            sign = np.copysign(1.0, turn[k])
            for m in range(4):
                i, own = hinge[k, m], sign * weight[k, m]
                rx, ry, rz = rx + own * x[i, 0], ry + own * x[i, 1], rz + own * x[i, 2]
        else:
            for m in (0, 3):
                px, py, pz = axis[k, m], axis[k, m + 1], axis[k, m + 2]
                size = np.sqrt(px * px + py * py + pz * pz) + 1e-30
                rx, ry, rz = rx - px / size, ry - py / size, rz - pz / size
        share = rest[e] / (np.sqrt(rx * rx + ry * ry + rz * rz) + 1e-30)
        target[k, 0], target[k, 1], target[k, 2] = share * rx, share * ry, share * rz
