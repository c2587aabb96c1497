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
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from robots.ports import Array
from skills.cloth.contact import (
    EDGE_SHARE,
    HASTE,
    OVERLAP_SHARE,
    OVERLAP_SPEED,
    PARKED,
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
    Rub,
    damp_edges,
    measure_turns,
    rub_hinges,
    solve_edges,
    solve_hinges,
    solve_rubbed_hinges,
)
from skills.cloth.patches import Patches, fit_patches, search_pairs
from skills.cloth.untangle import GLANCE, untangle

DONE, PAIRS_FULL = 0, 1  # why the loop came back
SWEEPS = 3  # over the contacts in a substep
FAST = 2.0  # x thickness: contacts that may go so far by the next narrow phase hasten it
CLOSING = 0.12  # [s] in which a pinch draws the cloth between the pads to their middle
SLACK = 0.0010  # [m] that a corner may stray from its straight course before its patch is searched anew
CALM_SLACK = 0.15  # of the thickness: the same for a calm one. Edges of layers that lie on each other are no pairs
STALE_SHARE = 0.8  # of SLACK: a patch that strayed by so much is searched along with those that must be
HORIZON = 5  # narrow phases for which the search looks ahead
RENEW = 4  # narrow phases after which a patch is searched along with others
SLIDING = 0.02  # [m/s] at which friction with the table is the dynamic one
STILL = 2.5e-4  # [m] a frame: who moved less is not foreseen to move
NEAR_CAPSULE = 0.02  # [m] cloth so near a capsule is awake
PUSH_SPEED = 0.6  # [m/s] at which cloth that is inside a capsule is pushed out
CAPSULE_FRICTION = 0.3

# places in State.counts
VT, EE, ACTIVE, EDGES, HINGES, AWAKE = range(6)  # lengths of the lists
# what is up to date, where the loop stands, and how many of the contacts are of a vertex and a triangle
SEARCHED, FITTED, PACKED, FRAME, SUBSTEP, NOW, SEARCHES, ACTIVE_VT, WATCHED, NEXT = range(6, 16)


class Body(NamedTuple):
    """What does not change: masses, constraints, triangles, neighbours (ring: CSR; ring_edge:
    the edges to them). edge_tri: (e, 2) triangles beside an edge, -1 where there is none; tri_edge: (t, 3).
    rim: (e,) edges of hems and seams."""

    w: Array
    edge: NDArray[np.int32]
    edge_tri: NDArray[np.int32]
    rim: NDArray[np.bool_]
    length: Array
    compliance: Array
    damping: Array
    hinge: NDArray[np.int32]
    weight: Array
    bend: Array
    rub: Rub
    tri: NDArray[np.int32]
    tri_edge: NDArray[np.int32]
    ring_start: NDArray[np.int32]
    ring: NDArray[np.int32]
    ring_edge: NDArray[np.int32]
    patches: Patches


class Rules(NamedTuple):
    """Numbers of the run. h: substep [s]."""

    h: float
    substeps: int
    gx: float
    gy: float
    gz: float
    thickness: float
    mu_static: float
    mu_dynamic: float
    mu_layers: float
    max_speed: float
    drag: float
    bend_gamma: float
    sleep_distance: float
    sleep_frames: int
    table: bool
    hold_compliance: float


class State(NamedTuple):
    """What moves, and what remembers. wa: inverse mass, 0 for a vertex asleep.
    press: what the table bore of each vertex in the last substep: displacements along x and y and upwards.
    base, course: (3, corners) each patch foresees its corners at base + course * (time since the substep
    born), to within slack; moving: whether a course is not zero; expired: it is to be searched (all: a patch).
    turned: (n,) fell asleep or woke since the last search; still: hardly moved in the last frame; watched: patches
    with a corner that is awake or was foreseen to move; last_row: (n,) scratch, -1. Of hinges that rub, else of no
    length: slip: (h,) the turn to which friction pulls; held: (h + 1,) what its spring holds of late; which:
    numbers of the packed hinges; axis, foot, turn, rub_inverse, moment: of these, as last measured."""

    x: Array
    xp: Array
    v: Array
    u: Array
    ref: Array
    last: Array
    base: NDArray[np.float32]
    course: NDArray[np.float32]
    slack: NDArray[np.float32]
    born: NDArray[np.int32]
    moving: NDArray[np.bool_]
    expired: NDArray[np.bool_]
    watched: NDArray[np.int32]
    turned: NDArray[np.bool_]
    wa: Array
    press: Array
    quiet: NDArray[np.int32]
    still: NDArray[np.bool_]
    awake: NDArray[np.bool_]
    stirred: NDArray[np.bool_]
    last_row: NDArray[np.int32]
    near: NDArray[np.bool_]
    awake_list: NDArray[np.int32]
    counts: NDArray[np.int64]
    edge: NDArray[np.int32]
    length: Array
    wi: Array
    wj: Array
    rate: Array
    hinge: NDArray[np.int32]
    weight: Array
    inverse: Array
    which: NDArray[np.int32]
    slip: Array
    held: Array
    axis: Array
    foot: Array
    turn: Array
    rub_inverse: Array
    moment: Array


class Pairs(NamedTuple):
    """Candidate pairs with their memory, and the contacts of the present narrow phase.

    vt_due, ee_due: substep from which a pair is to be looked at; vt_j, ee_j: (k, 3) what it bears [kg m];
    act_j, act_m: what a contact bears in this substep, and of late; act_c: its pair; act_p: (m, 4) how far apart
    its sides were when the substep began, and how far along its normal; inside: of a vertex over a triangle, the
    least barycentric coordinate; new_vt, new_ee, key, row, kept, chain, better: scratch."""

    vt: NDArray[np.int32]
    side: NDArray[np.int8]
    vt_due: NDArray[np.int32]
    vt_j: Array
    ee: NDArray[np.int32]
    near: NDArray[np.bool_]
    normal: Array
    ee_due: NDArray[np.int32]
    ee_j: Array
    new_vt: NDArray[np.int32]
    new_ee: NDArray[np.int32]
    key: NDArray[np.int64]
    row: NDArray[np.int32]
    kept: Array
    act_i: NDArray[np.int32]
    act_b: Array
    act_n: Array
    act_d: Array
    act_w: Array
    act_j: Array
    act_m: Array
    act_c: NDArray[np.int32]
    act_p: Array
    chain: NDArray[np.int32]
    better: NDArray[np.int32]
    inside: Array


class Holds(NamedTuple):
    """Pinched material points. vertex, bary: (m, 3); offset: (m, 3) in the tool frame when the pads
    met it; height: (m,) tool z at which it is held; hand: (m,), -1 unused.

    age: (2,) [s] since each hand closed. impulse: (2, 3) summed over a frame; force: (2, 3) [N] mean of the
    last frame on the hand. limit: (2,) [N], beyond which the pinch lets go. points: (2,) held.
    """

    vertex: NDArray[np.int32]
    bary: Array
    offset: Array
    height: Array
    hand: NDArray[np.int32]
    age: Array
    impulse: Array
    force: Array
    limit: Array
    points: NDArray[np.int64]


@njit(nogil=True)
def _grow(start, ring, near, rings):
    """Mark the neighbours of what is marked, `rings` times."""
    last = near.copy()
    for _ in range(rings):
        for i in range(len(near)):
            if last[i]:
                for a in range(start[i], start[i + 1]):
                    near[ring[a]] = True
        last[:] = near


@njit(nogil=True)
def _find_moving(index, n_awake, x, ref, last, quiet, still, distance, frames, stirred):
    """Mark awake vertices that left their reference point, which follows them; the others get quieter. What
    gathers speed is not quiet, however slow it still is: it steps further in this frame than in the mean."""
    for c in range(n_awake):
        i = index[c]
        away, step = 0.0, 0.0
        for m in range(3):
            away += (x[i, m] - ref[i, m]) ** 2
            step += (x[i, m] - last[i, m]) ** 2
            last[i, m] = x[i, m]
        quiet[i] += 1
        still[i] = step < STILL * STILL
        gathers = quiet[i] >= frames and np.sqrt(step) * frames > 1.5 * np.sqrt(away) + 1e-4
        if away > distance * distance or gathers:
            stirred[i] = True
            for m in range(3):
                ref[i, m] = x[i, m]


@njit(nogil=True)
def _stir_by_capsules(x, stirred, cap_p0, cap_p1, cap_r, f):
    for k in range(len(cap_r)):
        travel = 0.0
        for m in range(3):
            travel = max(travel, abs(cap_p0[f + 1, k, m] - cap_p0[f, k, m]))
            travel = max(travel, abs(cap_p1[f + 1, k, m] - cap_p1[f, k, m]))
        if travel < 1e-7:
            continue
        reach = cap_r[k] + NEAR_CAPSULE + travel
        for i in range(len(x)):
            if _distance2(x, i, cap_p0[f + 1, k], cap_p1[f + 1, k]) < reach * reach:
                stirred[i] = True


@njit(nogil=True)
def _stir_by_contact(n, act_i, stirred, near):
    for c in range(n):
        i, j, k, m = act_i[c, 0], act_i[c, 1], act_i[c, 2], act_i[c, 3]
        if stirred[i] or stirred[j] or stirred[k] or stirred[m]:
            near[i] = near[j] = near[k] = near[m] = True


@njit(nogil=True)
def _settle(sleep_frames, near, x, xp, u, v, ref, last, turned, quiet, awake, wa, w):
    """Wake what is near to something that moves, put to sleep what was quiet for long; -> whether anything
    changed, and whether something woke."""
    changed = woke = False
    for i in range(len(x)):
        if near[i]:
            quiet[i] = 0
            if awake[i] or w[i] == 0.0:
                continue
            awake[i], wa[i], turned[i] = True, w[i], True
            changed = woke = True
            for m in range(3):
                ref[i, m] = last[i, m] = xp[i, m] = x[i, m]
                v[i, m] = 0.0
        elif awake[i] and quiet[i] >= sleep_frames:
            awake[i], wa[i], turned[i] = False, 0.0, True
            changed = True
            for m in range(3):
                xp[i, m] = u[i, m] = x[i, m]
                v[i, m] = 0.0
    return changed, woke


@njit(nogil=True)
def _update_sleep(body, rules, state, pairs, holds, cap_p0, cap_p1, cap_r, f):
    """Vertices that moved stay awake and wake two rings about them and what they touch; quiet ones sleep."""
    count = state.counts
    stirred, near = state.stirred, state.near
    stirred[:] = False
    _find_moving(
        state.awake_list,
        count[AWAKE],
        state.x,
        state.ref,
        state.last,
        state.quiet,
        state.still,
        rules.sleep_distance,
        rules.sleep_frames,
        stirred,
    )
    _stir_by_capsules(state.x, stirred, cap_p0, cap_p1, cap_r, f)
    near[:] = stirred
    _grow(body.ring_start, body.ring, near, 2)
    _stir_by_contact(count[ACTIVE], pairs.act_i, stirred, near)
    hand, vertex = holds.hand, holds.vertex
    for k in range(len(hand)):
        if hand[k] >= 0:
            for m in range(3):
                near[vertex[k, m]] = True
    changed, woke = _settle(
        rules.sleep_frames,
        near,
        state.x,
        state.xp,
        state.u,
        state.v,
        state.ref,
        state.last,
        state.turned,
        state.quiet,
        state.awake,
        state.wa,
        body.w,
    )
    if changed:
        count[PACKED] = 0
    if woke:
        count[SEARCHED] = 0


@njit(nogil=True)
def _pack(body, rules, state):
    """Lists of what is awake: vertices, and constraints with an awake end, with their shares ready. The shares are
    those of the free masses: what a vertex feels must not change when its neighbour falls asleep."""
    count, wa = state.counts, state.wa
    n = 0
    for i in range(len(wa)):
        if state.awake[i]:
            state.awake_list[n] = i
            n += 1
    count[AWAKE] = n
    n = 0
    inv_h2 = 1.0 / rules.h**2
    for e in range(len(body.length)):
        i, j = body.edge[e, 0], body.edge[e, 1]
        if state.awake[i] or state.awake[j]:
            inv = 1.0 / (body.w[i] + body.w[j] + body.compliance[e] * inv_h2)
            state.edge[n, 0], state.edge[n, 1] = i, j
            state.length[n] = body.length[e]
            state.wi[n], state.wj[n] = wa[i] * inv, wa[j] * inv
            state.rate[n] = body.damping[e]
            n += 1
    count[EDGES] = n
    n = 0
    grow = 1.0 + rules.bend_gamma
    for e in range(len(body.bend)):
        some = False
        den = 0.0
        for m in range(4):
            i = body.hinge[e, m]
            some = some or state.awake[i]
            den += grow * body.w[i] * body.weight[e, m] ** 2
        if some:
            for m in range(4):
                state.hinge[n, m] = body.hinge[e, m]
                state.weight[n, m] = body.weight[e, m]
            state.inverse[n] = grow / (den + body.bend[e] * inv_h2)
            if len(body.rub.most):
                state.which[n] = e
            n += 1
    count[HINGES] = n
    count[WATCHED] = _watch(
        body.patches.corner, body.patches.corner_start, state.awake, state.moving, state.watched
    )
    count[PACKED] = 1


@njit(nogil=True)
def _watch(corner, start, awake, moving, watched):
    """Patches with a corner that is awake or was foreseen to move; -> their number."""
    n = 0
    for k in range(len(moving)):
        some = moving[k]
        for c in range(start[k], start[k + 1]):
            some = some or awake[corner[c]]
        if some:
            watched[n] = k
            n += 1
    return n


@njit(nogil=True)
def _search(body, rules, state, pairs):
    """Pairs of stale patches anew; near ones keep their side. False, and no pair changed, when a list is too
    small."""
    count, patches = state.counts, body.patches
    now, ahead = count[NOW], 0.5 * HORIZON * PHASE * rules.h
    _foresee(
        now,
        min(SLACK, CALM_SLACK * rules.thickness),
        patches.corner,
        patches.corner_start,
        state.x,
        state.v,
        state.awake,
        state.still,
        state.turned,
        state.expired,
        state.base,
        state.course,
        state.slack,
        state.born,
        state.moving,
        patches.stale,
    )
    fit_patches(
        patches,
        state.base,
        state.course,
        state.slack,
        state.born,
        state.moving,
        now,
        rules.h,
        ahead,
        count[FITTED] == 0,
    )
    n_vt, n_ee = search_pairs(patches, body.tri, body.edge, rules.thickness, ahead, pairs.new_vt, pairs.new_ee)
    if n_vt + count[VT] > len(pairs.vt) or n_ee + count[EE] > len(pairs.ee):
        return False
    _renew_vertex_triangle(patches, np.int64(len(body.tri)), pairs, count, n_vt)
    _renew_edge_edge(patches, np.int64(len(body.edge)), pairs, count, n_ee)
    state.expired[:] = False
    state.turned[:] = False
    count[SEARCHED] = count[FITTED] = 1
    count[SEARCHES] += 1
    return True


@njit(nogil=True)
def _foresee(
    now, calm_slack, corner, start, x, v, awake, still, turned, expired, base, course, slack, born, moving, stale
):  # fmt: skip
    """New courses for the patches that expired, or have a corner that woke, or move and have one that fell asleep:
    they are stale."""
    for k in range(len(stale)):
        for c in range(start[k], start[k + 1]):
            i = corner[c]
            expired[k] = expired[k] or (turned[i] and (awake[i] or moving[k]))
        stale[k] = expired[k]
        if not stale[k]:
            continue
        born[k], moving[k] = now, False
        for c in range(start[k], start[k + 1]):
            i = corner[c]
            calm = still[i] or not awake[i]
            moving[k] = moving[k] or not calm
            for d in range(3):
                base[d, c] = x[i, d]
                course[d, c] = 0.0 if calm else v[i, d]
        slack[k] = SLACK if moving[k] else calm_slack


@njit(nogil=True)
def _empty_table(key, kept):
    size = 64
    while size < 2 * kept:
        size *= 2
    key[:size] = -1
    return size


@njit(nogil=True)
def _renew_vertex_triangle(patches, width, pairs, count, n_new):
    """Pairs of stale patches out, the new ones in, with the side of those that were there."""
    vt, side, due, new, scratch = pairs.vt, pairs.side, pairs.vt_due, pairs.new_vt, pairs.act_i
    borne, memory = pairs.vt_j, pairs.kept
    stale, of_vertex, of_tri = patches.stale, patches.of_vertex, patches.of_tri
    kept = n = 0
    for c in range(count[VT]):
        if stale[of_vertex[vt[c, 0]]] or stale[of_tri[vt[c, 1]]]:
            if side[c] != 0:
                scratch[kept, 0], scratch[kept, 1], scratch[kept, 2] = vt[c, 0], vt[c, 1], side[c]
                for m in range(3):
                    memory[kept, m] = borne[c, m]
                kept += 1
        elif side[c] != 0 or due[c] != PARKED:
            if n < c:
                vt[n, 0], vt[n, 1], side[n], due[n] = vt[c, 0], vt[c, 1], side[c], due[c]
                for m in range(3):
                    borne[n, m] = borne[c, m]
            n += 1
    size = _empty_table(pairs.key, kept)
    key, row = pairs.key[:size], pairs.row[:size]
    for c in range(kept):
        _put(key, row, scratch[c, 0] * width + scratch[c, 1], c)
    for c in range(n_new):
        vt[n, 0], vt[n, 1] = new[c, 0], new[c, 1]
        r = _get(key, row, vt[n, 0] * width + vt[n, 1], -1)
        side[n] = scratch[r, 2] if r >= 0 else 0
        for m in range(3):
            borne[n, m] = memory[r, m] if r >= 0 else 0.0
        due[n] = count[NOW]
        n += 1
    count[VT] = n


@njit(nogil=True)
def _renew_edge_edge(patches, width, pairs, count, n_new):
    """The same for edges, with the normals of those that were near."""
    ee, near, normal, due, new = pairs.ee, pairs.near, pairs.normal, pairs.ee_due, pairs.new_ee
    stale, of_edge, scratch, memory, borne = patches.stale, patches.of_edge, pairs.act_i, pairs.kept, pairs.ee_j
    kept = n = 0
    for c in range(count[EE]):
        if stale[of_edge[ee[c, 0]]] or stale[of_edge[ee[c, 1]]]:
            if near[c]:
                scratch[kept, 0], scratch[kept, 1] = ee[c, 0], ee[c, 1]
                for m in range(3):
                    memory[kept, m] = normal[c, m]
                    memory[kept, m + 3] = borne[c, m]
                kept += 1
        elif near[c] or due[c] != PARKED:
            if n < c:
                ee[n, 0], ee[n, 1], near[n], due[n] = ee[c, 0], ee[c, 1], near[c], due[c]
                for m in range(3):
                    borne[n, m] = borne[c, m]
                    normal[n, m] = normal[c, m]
            n += 1
    size = _empty_table(pairs.key, kept)
    key, row = pairs.key[:size], pairs.row[:size]
    for c in range(kept):
        _put(key, row, scratch[c, 0] * width + scratch[c, 1], c)
    for c in range(n_new):
        ee[n, 0], ee[n, 1] = new[c, 0], new[c, 1]
        r = _get(key, row, ee[n, 0] * width + ee[n, 1], -1)
        near[n] = r >= 0
        for m in range(3):
            borne[n, m] = memory[r, m + 3] if r >= 0 else 0.0
            if r >= 0:
                normal[n, m] = memory[r, m]
        due[n] = count[NOW]
        n += 1
    count[EE] = n


@njit(nogil=True)
def _put(key, row, k, r):
    mask = len(key) - 1
    at = np.int64((k * 2654435761) & mask)
    while key[at] >= 0:
        at = (at + 1) & mask
    key[at] = k
    row[at] = r


@njit(nogil=True)
def _get(key, row, k, none):
    mask = len(key) - 1
    at = np.int64((k * 2654435761) & mask)
    while key[at] >= 0:
        if key[at] == k:
            return row[at]
        at = (at + 1) & mask
    return none


@njit(nogil=True, error_model="numpy", fastmath={"contract"})
def _expire(now, span, n, watched, corner, start, x, base, course, slack, born, moving, expired):
    """Whether a patch left the course that was foreseen for it, or its course has run out. Those of which this
    is true, or soon will be, are marked."""
    must = False
    for row in range(n):
        k = watched[row]
        age = now - born[k]
        after = np.float32(age * span)
        most = np.float32(0.0)
        for c in range(start[k], start[k + 1]):
            i = corner[c]
            dx = np.float32(x[i, 0]) - base[0, c] - after * course[0, c]
            dy = np.float32(x[i, 1]) - base[1, c] - after * course[1, c]
            dz = np.float32(x[i, 2]) - base[2, c] - after * course[2, c]
            most = max(most, dx * dx + dy * dy + dz * dz)
        strayed = np.sqrt(most) / slack[k]
        expired[k] = expired[k] or strayed > STALE_SHARE or (moving[k] and age >= RENEW * PHASE)
        must = must or strayed > 1.0 or (moving[k] and age >= HORIZON * PHASE)
    return must


@njit(nogil=True)
def _needs_search(body, rules, state):
    """Whether pairs may be missing from the lists."""
    count = state.counts
    must = _expire(
        count[NOW],
        rules.h,
        count[WATCHED],
        state.watched,
        body.patches.corner,
        body.patches.corner_start,
        state.x,
        state.base,
        state.course,
        state.slack,
        state.born,
        state.moving,
        state.expired,
    )
    return must or count[SEARCHED] == 0


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


@njit(nogil=True)
def _clear_press(state):
    for c in range(state.counts[AWAKE]):
        i = state.awake_list[c]
        state.press[i, 0] = state.press[i, 1] = state.press[i, 2] = 0.0


@njit(nogil=True, error_model="numpy", fastmath={"contract"})
def _table(rules, state):
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


@njit(nogil=True, error_model="numpy", fastmath={"contract"})
def _take_speed(rules, state):
    """Velocities from displacements."""
    inv_h = 1.0 / rules.h
    for c in range(state.counts[AWAKE]):
        i = state.awake_list[c]
        for m in range(3):
            state.v[i, m] = (state.x[i, m] - state.xp[i, m]) * inv_h


@njit(nogil=True, error_model="numpy", fastmath={"contract"})
def _hold(rules, state, holds, a, tool_p, tool_r, f):
    """Draw the pinched points to where the tools have them, at the share a of frame f."""
    frame = rules.h * rules.substeps
    pose = np.empty((4, 3))
    for hand in range(2):
        if holds.points[hand] == 0:
            continue
        for d in range(3):
            pose[0, d] = tool_p[f, hand, d] + a * (tool_p[f + 1, hand, d] - tool_p[f, hand, d])
            for m in range(3):
                pose[1 + m, d] = tool_r[f, hand, d, m] + a * (tool_r[f + 1, hand, d, m] - tool_r[f, hand, d, m])
        ramp = max(0.0, 1.0 - (holds.age[hand] + a * frame) / CLOSING)
        _hold_line(
            hand,
            pose,
            ramp,
            rules.hold_compliance / rules.h**2,
            state.x,
            state.wa,
            holds.vertex,
            holds.bary,
            holds.offset,
            holds.height,
            holds.hand,
            holds.impulse,
        )


@njit(nogil=True, error_model="numpy", fastmath={"contract"})
def _hold_line(hand, pose, ramp, soft, x, wa, vertex, bary, offset, height, owner, impulse):
    """One hand's points. Several layers are held as a stack that is free to turn about the line: they keep their
    distances, and the angle is the one at which the cloth has them (a hinge bears no moment)."""
    # the middle height of the stack, and the moments of where its layers are about the line
    mean = 0.0
    n = 0
    for k in range(len(owner)):
        if owner[k] == hand:
            mean += height[k]
            n += 1
    mean /= n
    along, across = 0.0, 0.0
    for k in range(len(owner)):
        if owner[k] != hand:
            continue
        i, j, m = vertex[k, 0], vertex[k, 1], vertex[k, 2]
        y, z = 0.0, -mean
        for d in range(3):
            p = bary[k, 0] * x[i, d] + bary[k, 1] * x[j, d] + bary[k, 2] * x[m, d] - pose[0, d]
            y += p * pose[2, d]
            z += p * pose[3, d]
        along += (height[k] - mean) * z
        across += (height[k] - mean) * y
    size = np.sqrt(along * along + across * across)
    c, s = (along / size, across / size) if size > 1e-12 else (1.0, 0.0)
    for k in range(len(owner)):
        if owner[k] != hand:
            continue
        i, j, m = vertex[k, 0], vertex[k, 1], vertex[k, 2]
        bi, bj, bm = bary[k, 0], bary[k, 1], bary[k, 2]
        inv = 1.0 / (wa[i] * bi * bi + wa[j] * bj * bj + wa[m] * bm * bm + soft)
        r = height[k] - mean
        ox, oy = offset[k, 0], s * r + (offset[k, 1] - s * r) * ramp
        oz = mean + c * r + (offset[k, 2] - mean - c * r) * ramp
        for d in range(3):
            p = pose[0, d] + pose[1, d] * ox + pose[2, d] * oy + pose[3, d] * oz
            g = (p - bi * x[i, d] - bj * x[j, d] - bm * x[m, d]) * inv
            x[i, d] += wa[i] * bi * g
            x[j, d] += wa[j] * bj * g
            x[m, d] += wa[m] * bm * g
            impulse[hand, d] -= g


@njit(nogil=True)
def _distance2(x, i, p, q):
    """Squared distance of vertex i from segment p-q."""
    ax, ay, az = q[0] - p[0], q[1] - p[1], q[2] - p[2]
    rx, ry, rz = x[i, 0] - p[0], x[i, 1] - p[1], x[i, 2] - p[2]
    t = min(max((ax * rx + ay * ry + az * rz) / (ax * ax + ay * ay + az * az + 1e-30), 0.0), 1.0)
    dx, dy, dz = rx - t * ax, ry - t * ay, rz - t * az
    return dx * dx + dy * dy + dz * dz


@njit(nogil=True)
def _push_out(x, xp, wa, i, j, s, c, c0, reach, h):
    """Move the point (1 - s) i + s j of the cloth out of a ball of radius `reach` about c, which came from c0."""
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


@njit(nogil=True)
def _capsules(rules, state, busy, a, a0, cap_p0, cap_p1, cap_r, f):
    """Kinematic capsules push edges (and so vertices) that are near them."""
    x, xp, wa = state.x, state.xp, state.wa
    p, q, c, c0 = np.empty(3), np.empty(3), np.empty(3), np.empty(3)
    for row in range(len(busy)):
        k, e = busy[row, 0], busy[row, 1]
        i, j = state.edge[e, 0], state.edge[e, 1]
        for m in range(3):
            p[m] = cap_p0[f, k, m] + a * (cap_p0[f + 1, k, m] - cap_p0[f, k, m])
            q[m] = cap_p1[f, k, m] + a * (cap_p1[f + 1, k, m] - cap_p1[f, k, m])
        s, t = _closest_free(x, i, j, p, q)
        for m in range(3):
            c[m] = p[m] + t * (q[m] - p[m])
            b0 = cap_p0[f, k, m] + a0 * (cap_p0[f + 1, k, m] - cap_p0[f, k, m])
            b1 = cap_p1[f, k, m] + a0 * (cap_p1[f + 1, k, m] - cap_p1[f, k, m])
            c0[m] = b0 + t * (b1 - b0)
        _push_out(x, xp, wa, i, j, s, c, c0, cap_r[k] + 0.5 * rules.thickness, rules.h)


@njit(nogil=True)
def _closest_free(x, i, j, p, q):
    """Parameters of the closest points of edge i-j and segment p-q."""
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


@njit(nogil=True)
def _near_capsules(rules, state, cap_p0, cap_p1, cap_r, f):
    """(m, 2) capsule and packed edge that can meet within frame f."""
    found = [(0, 0)]
    found.pop()
    frame = rules.h * rules.substeps
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
            reach = cap_r[k] + rules.thickness + 0.005 + 2.0 * travel + 1.5 * np.sqrt(v2) * frame
            if d2 < reach * reach:
                found.append((k, e))
    out = np.empty((len(found), 2), np.int32)
    for r in range(len(found)):
        out[r, 0], out[r, 1] = found[r]
    return out


@njit(nogil=True)
def _let_go(holds):
    """A pinch that is pulled harder than its pads can bear loses the cloth."""
    for hand in range(2):
        f2 = 0.0
        for m in range(3):
            f2 += holds.force[hand, m] ** 2
        if f2 > holds.limit[hand] ** 2:
            for k in range(len(holds.hand)):
                if holds.hand[k] == hand:
                    holds.hand[k] = -1
            holds.points[hand] = 0


def _fingerprint() -> str:
    """Of the sources that are compiled into the loop: numba's cache sees changes of one file only."""
    digest = hashlib.sha256()
    for name in ("contact.py", "crossings.py", "elastic.py", "kernel.py", "patches.py", "untangle.py"):
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
                _update_sleep(body, rules, state, pairs, holds, cap_p0, cap_p1, cap_r, f)
                holds.impulse[:] = 0.0
            if count[PACKED] == 0:
                _pack(body, rules, state)
            busy = np.empty((0, 2), np.int32)
            if len(cap_r):
                busy = _near_capsules(rules, state, cap_p0, cap_p1, cap_r, f)
            if count[AWAKE] > 0:
                for s in range(count[SUBSTEP], rules.substeps):
                    if s == count[NEXT]:
                        if _needs_search(body, rules, state):
                            count[SEARCHED] = 0
                            if not _search(body, rules, state, pairs):
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
                    _hold(rules, state, holds, a, tool_p, tool_r, f)
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
                    _clear_press(state)
                    _table(rules, state)
                    for sw in range(SWEEPS):
                        if sw > 0:
                            _table(rules, state)
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
                        _capsules(rules, state, busy, a, s / rules.substeps, cap_p0, cap_p1, cap_r, f)
                    _table(rules, state)
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
            _let_go(holds)
        count[FRAME] = 0
        return DONE

    return run_frames


run_frames = _compile(_fingerprint())
