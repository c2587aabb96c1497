# mypy: allow-untyped-defs, allow-incomplete-defs
"""The table: a plane at z = 0 with Coulomb friction."""

from __future__ import annotations

import numpy as np

from foldcell.skills.cloth.inner import inner
from foldcell.skills.cloth.simd.vec3 import load, store, vector

LOW = 0.004  # [m] vertices that are higher than this above their rest height cannot reach the table in a substep
# Vertices inside the table are pushed out by SUNK_SHARE of their depth per substep, but not faster than SUNK_SPEED
# [m/s]. The old positions of these vertices are not shifted (unlike those of overlapping layers), because then
# more folded piles came to rest.
SUNK_SHARE, SUNK_SPEED = 0.2, 0.1
SLIDING = 0.02  # [m/s] speed from which friction with the table is fully dynamic


@inner(error_model="numpy", fastmath={"contract"})
def find_low(count, awake, thickness, mu_static, mu_dynamic, h, x, xp, v, press, low, floor, friction):
    """List in `low` the vertices of awake[:count] that contacts of this substep may press onto the table, in
    `floor` their lowest heights, and in `friction` the table's friction coefficient for each. The coefficient
    changes gradually with the speed of the vertex: with an abrupt change, a vertex that yields a little while
    loads settle would keep sliding. Resets `press`. Returns the number of these vertices."""
    nothing = vector(0.0, 0.0, 0.0)
    rest = 0.5 * thickness
    n = 0
    for c in range(count):
        i = awake[c]
        store(press, i, nothing)
        if x[i, 2] >= rest + LOW:
            continue
        old = xp[i, 2]
        least = old + min(SUNK_SHARE * (rest - old), SUNK_SPEED * h)
        sliding = min(1.0, np.sqrt(v[i, 0] * v[i, 0] + v[i, 1] * v[i, 1]) / SLIDING)
        low[n], floor[n] = i, min(rest, least) if old < rest else rest
        friction[n] = mu_static + sliding * (mu_dynamic - mu_static)
        n += 1
    return n


@inner(error_model="numpy", fastmath={"contract"})
def press_on_table(count, low, rest, floor, friction, x, xp, press):
    """Lift vertices that are below their lowest height `floor` up to it, with Coulomb friction of the table (the
    plane z = 0); vertices of a single layer rest at z = `rest`. The function is called before each sweep over the
    contacts, so that layers rest on the vertices that the table holds, and once after the sweeps. press: the
    displacement of each vertex by this function, summed over the substep."""
    for c in range(count):
        i = low[c]
        borne = press[i, 2]
        if x[i, 2] >= rest and borne == 0.0:
            continue
        up = max(0.0, borne + floor[c] - x[i, 2])
        sx, sy = press[i, 0] - x[i, 0] + xp[i, 0], press[i, 1] - x[i, 1] + xp[i, 1]
        limit, hold2 = friction[c] * up, sx * sx + sy * sy
        if hold2 > limit * limit:
            share = limit / np.sqrt(hold2)
            sx, sy = share * sx, share * sy
        moved = vector(sx, sy, up)
        store(x, i, load(x, i) + (moved - load(press, i)))
        store(press, i, moved)
