# mypy: allow-untyped-defs, allow-incomplete-defs
"""The compiled loop over frames and substeps (small-step XPBD, Macklin et al. 2019).

The loop runs in one thread, without the global interpreter lock, and computes every sum in a fixed order: the same
input gives bit-identical results. The caller owns the arrays of the state. The loop can return between substeps,
when a list of pairs is too small; entering it again continues as if it had not returned.

Functions that are called in every substep take single arrays as arguments. A tuple of arrays would be passed as
hundreds of numbers per call: nine such calls per substep took a sixth of the time of a towel's simulation. Code
that runs often does not read an array from a tuple, slice it or take a view of it: each of these operations
changes a reference count twice, and each change is atomic. Such code uses unsigned indices, because compiled code
first tests whether a signed index is negative (which would mean counting from the end).
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from pathlib import Path

import numpy as np

from foldcell.skills.cloth.broad_phase.pairs import needs_search, search
from foldcell.skills.cloth.contact.capsules import near_capsules, push_by_capsules
from foldcell.skills.cloth.contact.contact_order import group_contacts, take_turns
from foldcell.skills.cloth.contact.contacts import (
    LEAST_SWEEPS,
    MOST_SWEEPS,
    TOLERANCE,
    apply_impulses,
    average_impulses,
    edge_distance,
    lay_out,
    measure_sides,
    next_narrow_phase,
    release_overlaps,
    remember_impulses,
    room_for_groups,
    solve_contacts,
)
from foldcell.skills.cloth.contact.edge_edge import narrow_edge_edge
from foldcell.skills.cloth.contact.table import find_low, press_on_table
from foldcell.skills.cloth.contact.vertex_triangle import narrow_vertex_triangle
from foldcell.skills.cloth.crease_set import advance_set, aim_hinges
from foldcell.skills.cloth.elasticity import (
    bending_friction_moments,
    damp_edges,
    measure_bends,
    measure_turns,
    solve_edges,
    solve_hinges,
    solve_hinges_with_friction,
)
from foldcell.skills.cloth.held_cloth import hold, release_overloaded
from foldcell.skills.cloth.integrate import (
    extrapolate,
    integrate,
    restore_positions,
    undo_extrapolation,
    update_velocities,
)
from foldcell.skills.cloth.intersections.resolve import GLANCE, resolve_intersections
from foldcell.skills.cloth.simd.f64x8 import EIGHT, blocks
from foldcell.skills.cloth.sleep import pack, update_sleep
from foldcell.skills.cloth.state import (
    ACTIVE,
    ACTIVE_VT,
    AWAKE,
    BEGUN,
    EE,
    FRAME,
    HINGES,
    MOVABLE,
    NEXT,
    NOW,
    PACE,
    PACKED,
    SEARCHED,
    SUBSTEP,
    VT,
)
from foldcell.skills.compiled import cached

DONE, PAIRS_FULL = 0, 1  # reasons to return from the loop
COMPILED = (
    "broad_phase/cluster_bounds.py", "broad_phase/cluster_search.py", "broad_phase/pairs.py", "clusters.py",
    "contact/capsules.py", "contact/contact_order.py", "contact/contacts.py", "contact/corners.py",
    "contact/edge_edge.py", "contact/ridges.py", "contact/table.py", "contact/vertex_sides.py",
    "contact/vertex_triangle.py", "crease_set.py", "elasticity.py", "held_cloth.py", "inner.py", "integrate.py",
    "intersections/crossings.py", "intersections/resolve.py", "kernel.py", "simd/f32x16.py", "simd/f64x4.py",
    "simd/f64x8.py", "simd/i32x16.py", "simd/registers.py", "simd/vec3.py", "sleep.py", "state.py",
)  # fmt: skip
"""Files that are compiled into the loop."""


def _fingerprint() -> str:
    """Return a hash of the sources of the loop. It is needed because numba's cache notices only changes in the
    file of the cached function."""
    digest = hashlib.sha256()
    for name in COMPILED:
        digest.update((Path(__file__).parent / name).read_bytes())
    return digest.hexdigest()


def _compile(sources: str) -> Callable[..., int]:
    """Compile the loop. The loop closes over `sources`, so that numba uses a cached loop only for exactly these
    sources. The name of the loop also contains their hash, so that every version has a separate cache index: the
    index of another version may name classes that no longer exist, and then cannot be read."""

    def run_frames(
        body, parameters, state, pairs, holds, intersections, tool_p, tool_r, cap_p0, cap_p1, cap_r, frames
    ):
        """Simulate from the frame and substep in `state.counts` (FRAME, SUBSTEP) to the end of the last of
        `frames` frames. Returns DONE, or PAIRS_FULL if a list of pairs is too small; the caller then enlarges the
        lists and calls again.

        At the frame boundaries: tool_p: (frames + 1, 2, 3) positions and tool_r: (frames + 1, 2, 3, 3) rotations
        of both hands; cap_p0, cap_p1: (frames + 1, k, 3) ends of the capsules. cap_r: (k,) radii of the capsules.
        All lengths are in metres.
        """
        count = state.counts
        # reading an attribute of a tuple increments a reference count atomically, so each is read only once
        x, xp, v, u, wa, awake = state.x, state.xp, state.v, state.u, state.wa, state.awake_list
        edge, batch_start, inverse_square = state.edge, state.batch_start, state.inverse_square
        wi, wj, rate = state.wi, state.wj, state.rate
        hinge, weight, part, free = state.hinge, state.weight, state.part, state.free
        stiffen, bend_ratio = state.stiffen, state.bend_ratio
        which, axis, foot, turn = state.which, state.axis, state.foot, state.turn
        friction_inverse, slip, held, moment = state.friction_inverse, state.slip, state.held, state.moment
        set_rest, side_of_turn, target = state.set_rest, state.side, state.target
        low, floor, table_friction, press = state.low, state.floor, state.table_friction, state.press
        contact_vertices, contact_weights, contact_mobilities, contact_normals = (
            pairs.contact_vertices,
            pairs.contact_weights,
            pairs.contact_mobilities,
            pairs.contact_normals,
        )
        contact_distances, contact_masses = pairs.contact_distances, pairs.contact_masses
        contact_impulses, room = pairs.contact_impulses, len(pairs.contact_distances)
        # These arrays are not preserved between calls, since the loop always begins with a narrow phase. Groups of
        # contacts (contact_order.py) seldom need more than this initial room
        groups, taken, work = 0, np.empty(len(x), np.int32), blocks((room + 1) // 2, 1).reshape((-1, 4))
        order, filled = np.empty((room, EIGHT), np.uint32), np.empty(room, np.uint8)
        contact_turn, level = np.empty(room, np.uint32), np.empty(room, np.uint32)
        first = np.empty(room + 1, np.uint32)
        member, group_weights, group_mobilities, block = room_for_groups(room // EIGHT + 1)
        points, age, hand, vertex = holds.points, holds.age, holds.hand, holds.vertex
        bary, offset, height, impulse = holds.bary, holds.offset, holds.height, holds.impulse
        soft, near, share, limit = (
            body.bending_friction.soft, body.bending_friction.near, body.bending_friction.share,
            body.bending_friction.limit
        )  # fmt: skip
        _ = sources
        h, pose = parameters.h, np.empty((4, 3))
        thick = parameters.thickness
        frame = h * parameters.substeps
        gravity = (parameters.gx, parameters.gy, parameters.gz)
        for f in range(count[FRAME], frames):
            if count[BEGUN] == 0:
                update_sleep(body, parameters, state, pairs, holds, cap_p0, cap_p1, cap_r, f)
                impulse[:] = 0.0
                count[BEGUN] = 1
            if count[PACKED] == 0:
                pack(body, state)
            busy = np.empty((0, 2), np.int32)
            if len(cap_r):
                busy = near_capsules(parameters, state, cap_p0, cap_p1, cap_r, f)
            p0, p1, r0, r1 = tool_p[f], tool_p[f + 1], tool_r[f], tool_r[f + 1]
            holding = points[0] + points[1] > 0
            if count[AWAKE] > 0:
                for s in range(count[SUBSTEP], parameters.substeps):
                    if s == count[NEXT]:
                        if needs_search(body, parameters, state):
                            count[SEARCHED] = 0
                            if not search(body, parameters, state, pairs):
                                count[FRAME], count[SUBSTEP] = f, s
                                return PAIRS_FULL
                        pace = count[PACE]
                        n, farthest = narrow_vertex_triangle(
                            count[VT], count[NOW], pace, h, thick, body.tri, x, v, wa, pairs,
                            state.top_row
                        )  # fmt: skip
                        count[ACTIVE_VT] = n
                        n, edges_farthest = narrow_edge_edge(
                            count[EE], n, count[NOW], pace, h, edge_distance(thick), body.edge, body.rim, x,
                            v, wa, pairs
                        )  # fmt: skip
                        count[ACTIVE] = n
                        take_turns(n, contact_vertices, taken, contact_turn, level, first)
                        groups = group_contacts(n, contact_vertices, taken, order, filled)
                        if groups > len(block):
                            member, group_weights, group_mobilities, block = room_for_groups(2 * groups)
                        lay_out(
                            groups, order, contact_vertices, contact_weights, contact_mobilities, contact_normals,
                            contact_distances, contact_masses, contact_impulses, member, group_weights,
                            group_mobilities, block
                        )  # fmt: skip
                        way = max(farthest, edges_farthest) / (pace * thick)
                        count[NEXT], count[PACE] = next_narrow_phase(
                            s, parameters.substeps, parameters.phase, pace, way
                        )
                    if s % parameters.phase == 0:
                        damp_edges(batch_start, edge, rate, wa, x, v)
                    integrate(
                        count[MOVABLE], awake, h, parameters.drag, parameters.max_speed, gravity, x, xp, v
                    )  # fmt: skip
                    solve_edges(batch_start, edge, inverse_square, wi, wj, x)
                    if s % parameters.phase == 0:
                        measure_bends(
                            count[HINGES], hinge, weight, stiffen, parameters.sharpest, x, bend_ratio
                        )  # fmt: skip
                    extrapolate(count[MOVABLE], awake, parameters.bend_gamma, x, xp, u)
                    if len(limit):
                        if s % parameters.phase == 0:
                            measure_turns(
                                count[HINGES], which, hinge, soft, body.w, x, axis,
                                foot, turn, friction_inverse
                            )  # fmt: skip
                            if len(target):
                                aim_hinges(
                                    count[HINGES], which, hinge, weight, axis, turn, set_rest, side_of_turn, x,
                                    target
                                )  # fmt: skip
                        bending_friction_moments(
                            count[HINGES], which, hinge, near, share, limit, axis,
                            foot, turn, friction_inverse, slip, held, x,
                            moment
                        )  # fmt: skip
                        solve_hinges_with_friction(
                            count[HINGES], hinge, weight, part, bend_ratio, axis, foot,
                            moment, 1.0 + parameters.bend_gamma, free, target, u
                        )  # fmt: skip
                    else:
                        solve_hinges(
                            count[HINGES], hinge, weight, part, bend_ratio, u
                        )  # fmt: skip
                    undo_extrapolation(count[AWAKE], awake, parameters.bend_gamma, x, xp, u)
                    restore_positions(count[AWAKE], count[MOVABLE], awake, x, xp)
                    a = (s + 1.0) / parameters.substeps
                    if holding:
                        hold(
                            points, age, hand, vertex, bary, offset,
                            height, impulse, parameters.hold_compliance / h**2, x, wa,
                            a * frame, p0, r0, p1, r1, a, pose
                        )  # fmt: skip
                    release_overlaps(
                        count[ACTIVE], contact_turn, contact_vertices, contact_weights, contact_mobilities,
                        contact_normals, contact_distances, contact_masses, x, xp, h
                    )  # fmt: skip
                    apply_impulses(
                        count[ACTIVE], contact_turn, contact_vertices, contact_mobilities, contact_impulses, x
                    )
                    measure_sides(groups, member, group_weights, block, xp)
                    sunk = 0
                    if parameters.table:
                        sunk = find_low(
                            count[AWAKE], awake, thick, parameters.mu_static, parameters.mu_dynamic, h, x, xp,
                            v, press, low, floor, table_friction
                        )  # fmt: skip
                    sweep, moved = 0, True
                    while sweep < LEAST_SWEEPS or (moved and sweep < MOST_SWEEPS):
                        press_on_table(
                            sunk, low, 0.5 * thick, floor, table_friction, x, xp, press
                        )  # fmt: skip
                        moved = solve_contacts(
                            groups, order, filled, member, group_weights, group_mobilities, block, x,
                            parameters.mu_layers,
                            (s + sweep) % 2 == 1,  # alternately forwards and backwards, also between substeps
                            TOLERANCE * thick, work
                        )  # fmt: skip
                        sweep += 1
                    average_impulses(groups, order, block, contact_impulses)
                    if len(busy):
                        push_by_capsules(
                            busy, a, s / parameters.substeps, cap_p0[f], cap_p1[f], cap_p0[f + 1], cap_p1[f + 1],
                            cap_r, 0.5 * thick, h, edge, x, xp, wa
                        )  # fmt: skip
                    press_on_table(
                        sunk, low, 0.5 * thick, floor, table_friction, x, xp, press
                    )  # fmt: skip
                    update_velocities(count[AWAKE], awake, h, x, xp, v)
                    count[NOW] += 1
                    if s + 1 == count[NEXT]:
                        remember_impulses(
                            count[ACTIVE_VT],
                            count[ACTIVE],
                            pairs.contact_pairs,
                            contact_impulses,
                            pairs.vt_j,
                            pairs.ee_j,
                        )
                if intersections.found[0] > 0 or count[NOW] // parameters.substeps % GLANCE == 0:
                    soon = count[NOW] + count[PACE]
                    resolve_intersections(body, pairs, intersections, count[VT], count[EE], soon, x, wa, thick)
            else:
                count[PACE] = parameters.phase
            if len(set_rest):
                advance_set(
                    body.crease_law, body.hinge, x, state.pressure, frame, side_of_turn, state.set_parts, set_rest
                )  # fmt: skip
            count[SUBSTEP] = count[NEXT] = count[BEGUN] = 0
            for side in range(2):
                age[side] += frame
                for m in range(3):
                    holds.force[side, m] = impulse[side, m] / (h * h * parameters.substeps)
            release_overloaded(holds)
        count[FRAME] = 0
        return DONE

    run_frames.__qualname__ = f"run_frames_{sources[:12]}"
    return cached(no_cfunc_wrapper=True)(run_frames)


SOURCES = _fingerprint()
"""Hash of the sources of the compiled loop."""
run_frames = _compile(SOURCES)
