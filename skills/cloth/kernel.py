# mypy: allow-untyped-defs, allow-incomplete-defs
"""The compiled loop over frames and substeps (small-step XPBD, Macklin et al. 2019).

One thread, no global interpreter lock, a fixed order of every sum: the same input gives the same bits. The
state lives in arrays that the caller owns; the loop can be left and entered again between substeps (when
a list of pairs is too small) without any difference.

What is called in every substep is handed the arrays that it works on: a tuple of arrays is handed over piece by
piece, hundreds of numbers a call, and nine such calls a substep took a sixth of a towel's time.
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
    release_overlaps,
    remember_impulses,
    solve_contacts,
)
from skills.cloth.edge_edge import narrow_edge_edge
from skills.cloth.elastic import (
    damp_edges,
    measure_turns,
    rub_hinges,
    solve_edges,
    solve_hinges,
    solve_rubbed_hinges,
)
from skills.cloth.hold import hold, let_go
from skills.cloth.integrate import follow, integrate, lead, put_back, take_speed
from skills.cloth.pairs import needs_search, search
from skills.cloth.sleep import pack, update_sleep
from skills.cloth.state import (
    ACTIVE,
    ACTIVE_VT,
    AWAKE,
    BEGUN,
    EDGES,
    EE,
    FRAME,
    HINGES,
    MOVABLE,
    NEXT,
    NOW,
    PACKED,
    SEARCHED,
    SUBSTEP,
    VT,
)
from skills.cloth.table import find_low, press_on_table
from skills.cloth.untangle import GLANCE, untangle
from skills.cloth.vertex_triangle import narrow_vertex_triangle

DONE, PAIRS_FULL = 0, 1  # why the loop came back
SWEEPS = 3  # over the contacts in a substep
FAST = 2.0  # x thickness: contacts that may go so far by the next narrow phase hasten it
COMPILED = (
    "capsules.py", "contact.py", "crossings.py", "edge_edge.py", "elastic.py", "hold.py", "integrate.py",
    "kernel.py", "pairs.py", "patch_bounds.py", "patch_search.py", "patches.py", "sleep.py", "state.py",
    "table.py", "untangle.py", "vectors.py", "vertex_sides.py", "vertex_triangle.py",
)  # fmt: skip
"""The files that are compiled into the loop."""


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
        gravity = (rules.gx, rules.gy, rules.gz)
        awake, rub = state.awake_list, body.rub
        for f in range(count[FRAME], frames):
            if count[BEGUN] == 0:
                update_sleep(body, rules, state, pairs, holds, cap_p0, cap_p1, cap_r, f)
                holds.impulse[:] = 0.0
                count[BEGUN] = 1
            if count[PACKED] == 0:
                pack(body, rules, state)
            busy = np.empty((0, 2), np.int32)
            if len(cap_r):
                busy = near_capsules(rules, state, cap_p0, cap_p1, cap_r, f)
            holding = holds.points[0] + holds.points[1] > 0
            if count[AWAKE] > 0:
                for s in range(count[SUBSTEP], rules.substeps):
                    if s == count[NEXT]:
                        if needs_search(body, rules, state):
                            count[SEARCHED] = 0
                            if not search(body, rules, state, pairs):
                                count[FRAME], count[SUBSTEP] = f, s
                                return PAIRS_FULL
                        n, farthest = narrow_vertex_triangle(
                            count[VT], count[NOW], thick, PHASE * h, body.tri, state.x, state.v, state.wa, pairs,
                            state.last_row
                        )  # fmt: skip
                        count[ACTIVE_VT] = n
                        n, edges_farthest = narrow_edge_edge(
                            count[EE], n, count[NOW], EDGE_SHARE * thick, PHASE * h, body.edge, body.rim, state.x,
                            state.v, state.wa, pairs
                        )  # fmt: skip
                        count[ACTIVE] = n
                        fast = max(farthest, edges_farthest) > FAST * thick
                        count[NEXT] = min(s + HASTE, s - s % PHASE + PHASE) if fast else s - s % PHASE + PHASE
                    if s % PHASE == 0:
                        damp_edges(count[EDGES], state.edge, state.rate, state.wa, state.x, state.v)
                    integrate(
                        count[MOVABLE], awake, h, rules.drag, rules.max_speed, gravity, state.x, state.xp, state.v
                    )  # fmt: skip
                    solve_edges(count[EDGES], state.edge, state.length, state.wi, state.wj, state.x)
                    lead(count[MOVABLE], awake, rules.bend_gamma, state.x, state.xp, state.u)
                    if len(rub.most):
                        if s % PHASE == 0:
                            measure_turns(
                                count[HINGES], state.which, state.hinge, rub.soft, body.w, state.x, state.axis,
                                state.foot, state.turn, state.rub_inverse
                            )  # fmt: skip
                        rub_hinges(
                            count[HINGES], state.which, state.hinge, rub.near, rub.share, rub.most, state.axis,
                            state.foot, state.turn, state.rub_inverse, state.slip, state.held, state.x,
                            state.moment
                        )  # fmt: skip
                        solve_rubbed_hinges(
                            count[HINGES], state.hinge, state.weight, state.inverse, state.axis, state.foot,
                            state.moment, 1.0 + rules.bend_gamma, state.free, state.u
                        )  # fmt: skip
                    else:
                        solve_hinges(
                            count[HINGES], state.hinge, state.weight, state.inverse, state.free, state.u
                        )  # fmt: skip
                    follow(count[AWAKE], awake, rules.bend_gamma, state.x, state.xp, state.u)
                    put_back(count[AWAKE], count[MOVABLE], awake, state.x, state.xp)
                    a = (s + 1.0) / rules.substeps
                    if holding:
                        hold(
                            holds.points, holds.age, holds.hand, holds.vertex, holds.bary, holds.offset,
                            holds.height, holds.impulse, rules.hold_compliance / h**2, state.x, state.wa,
                            a * frame, tool_p[f], tool_r[f], tool_p[f + 1], tool_r[f + 1], a
                        )  # fmt: skip
                    release_overlaps(
                        count[ACTIVE], pairs.act_i, pairs.act_b, pairs.act_n, pairs.act_d, pairs.act_w, state.wa,
                        state.x, state.xp, h
                    )  # fmt: skip
                    apply_impulses(
                        count[ACTIVE], pairs.act_i, pairs.act_b, pairs.act_n, pairs.act_m, pairs.act_j,
                        pairs.act_p, pairs.act_g, state.wa, state.x, state.xp
                    )  # fmt: skip
                    low = 0
                    if rules.table:
                        low = find_low(
                            count[AWAKE], awake, thick, rules.mu_static, rules.mu_dynamic, h, state.x, state.xp,
                            state.v, state.press, state.low, state.floor, state.rub
                        )  # fmt: skip
                    for sw in range(SWEEPS):
                        press_on_table(
                            low, state.low, 0.5 * thick, state.floor, state.rub, state.x, state.xp, state.press
                        )  # fmt: skip
                        solve_contacts(
                            count[ACTIVE], pairs.act_i, pairs.act_b, pairs.act_n, pairs.act_d, pairs.act_w,
                            pairs.act_j, pairs.act_p, pairs.act_g, state.wa, state.x, rules.mu_layers,
                            s * SWEEPS + sw,  # there in one substep and back in the next
                        )  # fmt: skip
                    average_impulses(count[ACTIVE], pairs.act_j, pairs.act_m)
                    if len(busy):
                        push_by_capsules(
                            busy, a, s / rules.substeps, cap_p0[f], cap_p1[f], cap_p0[f + 1], cap_p1[f + 1], cap_r,
                            0.5 * thick, h, state.edge, state.x, state.xp, state.wa
                        )  # fmt: skip
                    press_on_table(
                        low, state.low, 0.5 * thick, state.floor, state.rub, state.x, state.xp, state.press
                    )  # fmt: skip
                    take_speed(count[AWAKE], awake, h, state.x, state.xp, state.v)
                    count[NOW] += 1
                    if s + 1 == count[NEXT]:
                        remember_impulses(
                            count[ACTIVE_VT], count[ACTIVE], pairs.act_c, pairs.act_m, pairs.vt_j, pairs.ee_j
                        )
                if tangles.found[0] > 0 or count[NOW] // rules.substeps % GLANCE == 0:
                    soon = count[NOW] + PHASE
                    untangle(body, pairs, tangles, count[VT], count[EE], soon, state.x, state.wa, thick)
            count[SUBSTEP] = count[NEXT] = count[BEGUN] = 0
            for hand in range(2):
                holds.age[hand] += frame
                for m in range(3):
                    holds.force[hand, m] = holds.impulse[hand, m] / (h * h * rules.substeps)
            let_go(holds)
        count[FRAME] = 0
        return DONE

    return run_frames


SOURCES = _fingerprint()
"""What the loop is compiled from."""
run_frames = _compile(SOURCES)
