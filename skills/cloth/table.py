# mypy: allow-untyped-defs, allow-incomplete-defs
"""The table: a plane at z = 0 with Coulomb friction."""

from __future__ import annotations

import numpy as np
from numba import njit

from skills.cloth.contact import OVERLAP_SHARE, OVERLAP_SPEED
from skills.cloth.state import AWAKE

SLIDING = 0.02  # [m/s] at which friction with the table is the dynamic one


@njit(nogil=True)
def clear_press(state):
    for c in range(state.counts[AWAKE]):
        i = state.awake_list[c]
        state.press[i, 0] = state.press[i, 1] = state.press[i, 2] = 0.0


@njit(nogil=True, error_model="numpy", fastmath={"contract"})
def press_on_table(rules, state):
    """The table (a plane at z = 0) with Coulomb friction. It is asked before the contacts, so that layers rest on
    what it holds, and after them, with the sum of what it bore: press, the displacements in this substep."""
    if not rules.table:
        return
    low = 0.5 * rules.thickness
    x, xp, press = state.x, state.xp, state.press
    for c in range(state.counts[AWAKE]):
        i = state.awake_list[c]
        borne = press[i, 2]
        if x[i, 2] >= low and borne == 0.0:
            continue
        old = xp[i, 2]
        floor = min(low, old + min(OVERLAP_SHARE * (low - old), OVERLAP_SPEED * rules.h)) if old < low else low
        up = max(0.0, borne + floor - x[i, 2])
        sx, sy = press[i, 0] - x[i, 0] + xp[i, 0], press[i, 1] - x[i, 1] + xp[i, 1]
        # by the speed that it has: else whatever gives way a little while loads settle would go on sliding
        v = state.v
        sliding = min(1.0, np.sqrt(v[i, 0] * v[i, 0] + v[i, 1] * v[i, 1]) / SLIDING)
        limit = (rules.mu_static + sliding * (rules.mu_dynamic - rules.mu_static)) * up
        hold = np.sqrt(sx * sx + sy * sy)
        if hold > limit:
            sx, sy = sx * limit / hold, sy * limit / hold
        x[i, 0] += sx - press[i, 0]
        x[i, 1] += sy - press[i, 1]
        x[i, 2] += up - borne
        press[i, 0], press[i, 1], press[i, 2] = sx, sy, up
