# mypy: allow-untyped-defs, allow-incomplete-defs
"""The compiled loop over frames and substeps (small-step XPBD, Macklin et al. 2019).

One thread, no global interpreter lock, a fixed order of every sum: the same input gives the same bits. The
state lives in arrays that the caller owns; the loop can be left and entered again between substeps (when
a list of pairs is too small) without any difference.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from pathlib import Path

import numpy as np
from numba import njit

from skills.cloth.capsules import near_capsules, push_by_capsules
from skills.cloth.contact import (
    EDGE_SHARE,
    HASTE,
    PHASE,
    apply_impulses,
    average_impulses,
    meet_once,
    narrow_edge_edge,
    narrow_vertex_triangle,
    remember_impulses,
    solve_contacts,
)
from skills.cloth.elastic import (
    damp_edges,
    measure_turns,
    rub_hinges,
    solve_edges,
    solve_hinges,
    solve_rubbed_hinges,
)
from skills.cloth.hold import hold, let_go
from skills.cloth.pairs import needs_search, search
from skills.cloth.sleep import pack, update_sleep
from skills.cloth.state import (
    ACTIVE,
    ACTIVE_VT,
    AWAKE,
    EDGES,
    EE,
    FRAME,
    HINGES,
    NEXT,
    NOW,
    PACKED,
    SEARCHED,
    SUBSTEP,
    VT,
)
from skills.cloth.table import clear_press, press_on_table
from skills.cloth.untangle import GLANCE, untangle

DONE, PAIRS_FULL = 0, 1  # why the loop came back
SWEEPS = 3  # over the contacts in a substep
FAST = 2.0  # x thickness: contacts that may go so far by the next narrow phase hasten it
COMPILED = (
    "capsules.py", "contact.py", "crossings.py", "elastic.py", "hold.py", "kernel.py", "pairs.py", "patches.py",
    "sleep.py", "state.py", "table.py", "untangle.py",
)  # fmt: skip
"""The files that are compiled into the loop."""


@njit(nogil=True, error_model="numpy", fastmath={"contract"})
def _integrate(rules, state):
    h = rules.h
    keep = 1.0 / (1.0 + rules.drag * h)
    for c in range(state.counts[AWAKE]):
        i = state.awake_list[c]
        vx = state.v[i, 0] * keep + h * rules.gx
        vy = state.v[i, 1] * keep + h * rules.gy
        vz = state.v[i, 2] * keep + h * rules.gz
        s2 = vx * vx + vy * vy + vz * vz
        if s2 > rules.max_speed * rules.max_speed:
            k = rules.max_speed / np.sqrt(s2)
            vx, vy, vz = k * vx, k * vy, k * vz
        for m in range(3):
            state.xp[i, m] = state.x[i, m]
        state.x[i, 0] += h * vx
        state.x[i, 1] += h * vy
        state.x[i, 2] += h * vz


@njit(nogil=True, error_model="numpy", fastmath={"contract"})
def _bend(body, rules, state, s):
    """Hinges with damping: solved for u = x + gamma (x - xp), in which the damped constraint is the plain one."""
    g = rules.bend_gamma
    n = state.counts[HINGES]
    x, xp, u = state.x, state.xp, state.u
    for c in range(state.counts[AWAKE]):
        i = state.awake_list[c]
        for m in range(3):
            u[i, m] = x[i, m] + g * (x[i, m] - xp[i, m])
    if len(body.rub.most):
        _rub(body, state, s)
        solve_rubbed_hinges(
            n,
            state.hinge,
            state.weight,
            state.inverse,
            state.axis,
            state.foot,
            state.moment,
            1.0 + g,
            state.wa,
            u,
        )
    else:
        solve_hinges(n, state.hinge, state.weight, state.inverse, state.wa, u)
    scale = 1.0 / (1.0 + g)
    for c in range(state.counts[AWAKE]):
        i = state.awake_list[c]
        for m in range(3):
            x[i, m] = (u[i, m] + g * xp[i, m]) * scale


@njit(nogil=True)
def _rub(body, state, s):
    """Friction of the hinges, whose turns and axes are measured now and then."""
    n, rub = state.counts[HINGES], body.rub
    if s % PHASE == 0:
        measure_turns(
            n,
            state.which,
            state.hinge,
            rub.soft,
            body.w,
            state.x,
            state.axis,
            state.foot,
            state.turn,
            state.rub_inverse,
        )
    rub_hinges(
        n,
        state.which,
        state.hinge,
        rub.near,
        rub.share,
        rub.most,
        state.axis,
        state.foot,
        state.turn,
        state.rub_inverse,
        state.slip,
        state.held,
        state.x,
        state.moment,
    )


@njit(nogil=True, error_model="numpy", fastmath={"contract"})
def _take_speed(rules, state):
    """Velocities from displacements."""
    inv_h = 1.0 / rules.h
    for c in range(state.counts[AWAKE]):
        i = state.awake_list[c]
        for m in range(3):
            state.v[i, m] = (state.x[i, m] - state.xp[i, m]) * inv_h


def _fingerprint() -> str:
    """Of the sources that are compiled into the loop: numba's cache sees changes of one file only."""
    digest = hashlib.sha256()
    for name in COMPILED:
        digest.update((Path(__file__).parent / name).read_bytes())
    return digest.hexdigest()


def _compile(sources: str) -> Callable[..., int]:
    """The loop; `sources` is closed over, so that a cached one belongs to exactly these."""

    @njit(cache=True, nogil=True)
    def run_frames(body, rules, state, pairs, holds, tangles, tool_p, tool_r, cap_p0, cap_p1, cap_r, frames):
        """Advance from (counts[FRAME], counts[SUBSTEP]) to the end of `frames`; -> DONE or PAIRS_FULL.

        tool_p: (frames + 1, 2, 3), tool_r: (frames + 1, 2, 3, 3) poses at the frames' bounds, by hand; cap_p0,
        cap_p1: (frames + 1, k, 3) ends of the capsules, cap_r: (k,).
        """
        count = state.counts
        _ = sources
        h = rules.h
        thick = rules.thickness
        frame = h * rules.substeps
        for f in range(count[FRAME], frames):
            if count[SUBSTEP] == 0:
                update_sleep(body, rules, state, pairs, holds, cap_p0, cap_p1, cap_r, f)
                holds.impulse[:] = 0.0
            if count[PACKED] == 0:
                pack(body, rules, state)
            busy = np.empty((0, 2), np.int32)
            if len(cap_r):
                busy = near_capsules(rules, state, cap_p0, cap_p1, cap_r, f)
            if count[AWAKE] > 0:
                for s in range(count[SUBSTEP], rules.substeps):
                    if s == count[NEXT]:
                        if needs_search(body, rules, state):
                            count[SEARCHED] = 0
                            if not search(body, rules, state, pairs):
                                count[FRAME], count[SUBSTEP] = f, s
                                return PAIRS_FULL
                        n, farthest = narrow_vertex_triangle(
                            count[VT],
                            pairs.vt,
                            pairs.side,
                            pairs.vt_due,
                            count[NOW],
                            body.tri,
                            state.x,
                            state.v,
                            state.wa,
                            thick,
                            PHASE * h,
                            pairs.vt_j,
                            pairs.act_i,
                            pairs.act_b,
                            pairs.act_n,
                            pairs.act_d,
                            pairs.act_w,
                            pairs.act_m,
                            pairs.act_c,
                            pairs.inside,
                        )
                        n = meet_once(
                            n,
                            pairs.vt,
                            state.last_row,
                            pairs.chain,
                            pairs.better,
                            pairs.inside,
                            pairs.act_i,
                            pairs.act_b,
                            pairs.act_n,
                            pairs.act_d,
                            pairs.act_w,
                            pairs.act_m,
                            pairs.act_c,
                        )
                        count[ACTIVE_VT] = n
                        n, edges_farthest = narrow_edge_edge(
                            count[EE],
                            pairs.ee,
                            pairs.near,
                            pairs.normal,
                            pairs.ee_due,
                            count[NOW],
                            body.edge,
                            body.rim,
                            state.x,
                            state.v,
                            state.wa,
                            EDGE_SHARE * thick,
                            PHASE * h,
                            pairs.ee_j,
                            pairs.act_i,
                            pairs.act_b,
                            pairs.act_n,
                            pairs.act_d,
                            pairs.act_w,
                            pairs.act_m,
                            pairs.act_c,
                            n,
                        )
                        count[ACTIVE] = n
                        fast = max(farthest, edges_farthest) > FAST * thick
                        count[NEXT] = min(s + HASTE, s - s % PHASE + PHASE) if fast else s - s % PHASE + PHASE
                    if s % PHASE == 0:
                        damp_edges(count[EDGES], state.edge, state.rate, state.wa, state.x, state.v)
                    _integrate(rules, state)
                    solve_edges(count[EDGES], state.edge, state.length, state.wi, state.wj, state.x)
                    _bend(body, rules, state, s)
                    a = (s + 1.0) / rules.substeps
                    hold(rules, state, holds, a, tool_p, tool_r, f)
                    apply_impulses(
                        count[ACTIVE],
                        pairs.act_i,
                        pairs.act_b,
                        pairs.act_n,
                        pairs.act_m,
                        pairs.act_j,
                        pairs.act_p,
                        state.wa,
                        state.x,
                        state.xp,
                    )
                    clear_press(state)
                    press_on_table(rules, state)
                    for sw in range(SWEEPS):
                        if sw > 0:
                            press_on_table(rules, state)
                        solve_contacts(
                            count[ACTIVE],
                            pairs.act_i,
                            pairs.act_b,
                            pairs.act_n,
                            pairs.act_d,
                            pairs.act_w,
                            pairs.act_j,
                            pairs.act_p,
                            state.wa,
                            state.x,
                            rules.mu_layers,
                            h,
                            s * SWEEPS + sw,  # there in one substep and back in the next
                        )
                    average_impulses(count[ACTIVE], pairs.act_j, pairs.act_m)
                    if len(busy):
                        push_by_capsules(rules, state, busy, a, s / rules.substeps, cap_p0, cap_p1, cap_r, f)
                    press_on_table(rules, state)
                    _take_speed(rules, state)
                    count[NOW] += 1
                    if s + 1 == count[NEXT]:
                        remember_impulses(
                            count[ACTIVE_VT], count[ACTIVE], pairs.act_c, pairs.act_m, pairs.vt_j, pairs.ee_j
                        )
                if tangles.found[0] > 0 or count[NOW] // rules.substeps % GLANCE == 0:
                    soon = count[NOW] + PHASE
                    untangle(body, pairs, tangles, count[VT], count[EE], soon, state.x, state.wa, thick)
            count[SUBSTEP] = count[NEXT] = 0
            for hand in range(2):
                holds.age[hand] += frame
                for m in range(3):
                    holds.force[hand, m] = holds.impulse[hand, m] / (h * h * rules.substeps)
            let_go(holds)
        count[FRAME] = 0
        return DONE

    return run_frames


run_frames = _compile(_fingerprint())
