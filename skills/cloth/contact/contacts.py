# mypy: allow-untyped-defs, allow-incomplete-defs
"""Self-contact of cloth: what contacts are, and the sweeps over them.

The search for pairs is in cluster_search.py. Narrow phase, every few substeps (vertex_triangle.py, edge_edge.py):
which of the pairs are near, on which side, and with which weights; such a contact is one linear constraint
n . sum(b_i x_i) >= thickness until the next narrow phase. The side of a pair follows the geometry as long as it
is apart and is kept while it is near: a pair that was pressed through is pushed back to where it came from. What
comes so fast that it could be through by the next narrow phase has the next one earlier; where nothing does it
is later.

A substep sweeps over the contacts until a sweep moves none by much: twice where they rest on each other, up to six
times where they are pressed or pulled hard, as at a pinch or where cloth is caught in cloth.

Overlap that is older than the substep is released little by little, as a shift of where the cloth is and was: no
speed comes of it, which would throw layers apart. Friction is Coulomb's at position level, bounded by all that a
contact has borne in the substep.

The contacts of a narrow phase are in a list, and in two other orders (contact_order.py): in turns they release
overlap and begin, in groups of EIGHT they are swept over. What sweeps read is laid out group by group (`lay_out`):
in registers, where what the contacts bear stays for the whole phase. After each substep `average_impulses` puts
what they bear of late back into the list, with which the next substep begins.

Every contact remembers, averaged over some substeps, what it bears, and begins with it (warm starting, as in
sequential impulses: Catto 2005). Few sweeps then carry a stack of layers without creep, with true masses: the
table bears the weight of all of them. The average, and not the last impulse, since the impulses and the speeds
would otherwise be two integrators in a ring, which swing.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numba.extending import register_jitable

from skills.cloth.simd.f64x8 import (
    EIGHT,
    add_shares,
    any_above,
    blocks,
    coordinates,
    dots,
    gather,
    load_f64x8,
    scatter,
    splat_f64x8,
    store_f64x8,
    vdiv,
    vmax,
    vmin,
    vsqrt,
    where_above,
)  # fmt: skip
from skills.cloth.simd.vec3 import dot, load, members, spread, store

# A phase is the time from one narrow phase to the next: 1 / PHASES [s], but no less than PHASE substeps.
PHASE, PHASES = 4, 240
HASTE_WAY = (
    2.0  # x thickness: if a contact may go farther in a phase, the next narrow phase comes after half of one;
)
LEISURE_WAY = 1.0  # if none may go farther in two phases, it comes after two
RELEASE = 1.25  # x contact distance: beyond it a pair is apart and its side follows the geometry
GIVE_UP = 3.0  # x contact distance: a pair pressed through by more is let go
# edge-edge contact distance: a share of the thickness, but in thin cloth, where a snag can pull so little through
# in a substep, this many metres, up to another share: layers lie a thickness apart, and their edges must not push
EDGE_SHARE, EDGE_DISTANCE, MOST_EDGE_SHARE = 0.5, 0.001, 0.8
# a contact among vertices of which few may move is as heavy as this share of the lightest: one that can hardly
# act on it would be flung
LEAST_SHARE = 0.25
STRAY = 2.5e-4  # [m] between two narrow phases, that no relative speed foretells
PARKED = 2**30  # due date of a pair that sleeps
MAX_WAIT = 12  # times as long as contacts serve a pair which is far apart is left out, at most
MEMORY = 0.05  # share of a substep's impulse that a contact's memory takes up: with all of it stacks swing
LEAST_SWEEPS, MOST_SWEEPS = 2, 6  # in a substep
TOLERANCE = 0.03  # x thickness: from LEAST_SWEEPS on, one that moved no contact by more is the last
OVERLAP_SHARE = 0.4  # of an overlap that is older is released a substep,
OVERLAP_SPEED = 0.4  # at most so fast [m/s]
# where a group's block has the normals of its contacts (three registers), their contact distances, one over their
# inverse masses; how far apart the sides were when the substep began, what is borne in it, and of late (three
# registers each)
NORMAL, GAP, INVERSE, APART, BORNE, OF_LATE, PLACES = 0, 3, 4, 5, 8, 11, 14


@njit(nogil=True, forceinline=True)
def expect_places(block):
    """That a block has all places. The compiler knows it from here on: it finds them by constants then."""
    if block.shape[1] != PLACES or block.shape[2] != EIGHT:
        raise ValueError("not blocks of so many registers")


@njit(nogil=True, forceinline=True)
def load_three(block, g, place):
    """Coordinates of a vector of each contact of a group."""
    return load_f64x8(block, g, place), load_f64x8(block, g, place + 1), load_f64x8(block, g, place + 2)


@njit(nogil=True, forceinline=True)
def store_three(block, g, place, a):
    """The reverse."""
    store_f64x8(block, g, place, a[0])
    store_f64x8(block, g, place + 1, a[1])
    store_f64x8(block, g, place + 2, a[2])


@register_jitable
def edge_distance(thick: float) -> float:
    """Contact distance of edges [m] of cloth so thick [m]."""
    return max(EDGE_SHARE * thick, min(MOST_EDGE_SHARE * thick, EDGE_DISTANCE))


def phase_length(h: float, substeps: int) -> int:
    """Substeps of `h` [s] from one narrow phase to the next; a frame has a whole number of phases."""
    fitting = [n for n in range(PHASE, substeps + 1) if substeps % n == 0 and n * h * PHASES < 1.0 + 1e-9]
    return max(fitting, default=PHASE)


@njit(nogil=True)
def next_narrow_phase(s, substeps, phase, pace, way):
    """The substep of the narrow phase after that of substep s, whose contacts serve for `pace` substeps, and the
    pace of that one. way: what the fastest pair that may touch can come nearer in a substep, x thickness."""
    step = phase // 2 if way * phase > HASTE_WAY else phase if 2 * way * phase > LEISURE_WAY else 2 * phase
    on_grid = s - s % phase + max(phase, min(step, pace))
    return min(s + step, on_grid, substeps), max(step, phase)


@njit(nogil=True, forceinline=True)
def is_due(due, now, pace):
    """Whether a pair is to be looked at now, since the next look would be too late."""
    return due < now + pace


@njit(nogil=True)
def later(now, pace, free, reach):
    """When a pair is to be looked at again that has to come nearer by `free`, and may in `pace` substeps by
    `reach`."""
    return now + pace * (1 + int(min(max(free - reach, 0.0) / reach, MAX_WAIT)))


@njit(nogil=True, error_model="numpy", fastmath={"contract"})
def release_overlaps(
    n,
    turn,
    contact_vertices,
    contact_weights,
    contact_mobilities,
    contact_normals,
    contact_distances,
    contact_masses,
    x,
    xp,
    h,
):
    """Shift apart what overlapped when the substep began, as it was then and as it is."""
    most_way = OVERLAP_SPEED * h
    for place in range(np.uint64(n)):
        c = np.uint64(turn[place])
        i, j, k, m = members(contact_vertices, c)
        bi, bj, bk, bm = spread(load(contact_weights, c))
        pi, pj, pk, pm = load(xp, i), load(xp, j), load(xp, k), load(xp, m)
        normal = load(contact_normals, c)
        overlap = contact_distances[c] - dot(normal, bi * pi + bj * pj + bk * pk + bm * pm)
        # shifted by nothing if it is apart: half of them are, and a branch would be guessed wrongly too often
        apart = (max(min(OVERLAP_SHARE * overlap, most_way), 0.0) * contact_masses[c]) * normal
        si, sj, sk, sm = spread(load(contact_mobilities, c))
        si, sj, sk, sm = si * apart, sj * apart, sk * apart, sm * apart
        store(xp, i, pi + si)
        store(xp, j, pj + sj)
        store(xp, k, pk + sk)
        store(xp, m, pm + sm)
        store(x, i, load(x, i) + si)
        store(x, j, load(x, j) + sj)
        store(x, k, load(x, k) + sk)
        store(x, m, load(x, m) + sm)


@njit(nogil=True, error_model="numpy", fastmath={"contract"})
def apply_impulses(n, turn, contact_vertices, contact_mobilities, contact_impulses, x):
    """What the contacts have borne of late, to begin a substep with. Which bear something is not guessed at."""
    for place in range(np.uint64(n)):
        c = np.uint64(turn[place])
        i, j, k, m = members(contact_vertices, c)
        borne = load(contact_impulses, c)
        si, sj, sk, sm = spread(load(contact_mobilities, c))
        store(x, i, load(x, i) + si * borne)
        store(x, j, load(x, j) + sj * borne)
        store(x, k, load(x, k) + sk * borne)
        store(x, m, load(x, m) + sm * borne)


@njit(nogil=True)
def room_for_groups(n):
    """Arrays for what is laid out of n groups, without content."""
    member = np.empty((n * EIGHT, 4), np.uint32)
    weight, share = blocks(n, 4).reshape((n * EIGHT, 4)), blocks(n, 4).reshape((n * EIGHT, 4))
    return member, weight, share, blocks(n, PLACES)


@njit(nogil=True)
def lay_out(
    groups,
    order,
    contact_vertices,
    contact_weights,
    contact_mobilities,
    contact_normals,
    contact_distances,
    contact_masses,
    contact_impulses,
    member,
    weight,
    share,
    block,
):
    """What the sweeps read, in the order in which they do. member, weight, share: (m * EIGHT, 4) contact_vertices,
    contact_weights, contact_mobilities; block: (m, PLACES, EIGHT) registers of each group, of all that has a place
    there but APART."""
    expect_places(block)
    end, full = np.uint64(groups), np.uint64(EIGHT)
    for row in range(end * full):
        c = np.uint64(order[row // full, row % full])
        member[row, 0], member[row, 1], member[row, 2], member[row, 3] = members(contact_vertices, c)
        store(weight, row, load(contact_weights, c))
        store(share, row, load(contact_mobilities, c))
    for g in range(end):
        for k in range(full):
            c = np.uint64(order[g, k])
            block[g, GAP, k], block[g, INVERSE, k] = contact_distances[c], contact_masses[c]
        store_three(block, g, NORMAL, coordinates(contact_normals, order, g))
        of_late = coordinates(contact_impulses, order, g)
        store_three(block, g, BORNE, of_late)
        store_three(block, g, OF_LATE, of_late)


@njit(nogil=True)
def measure_sides(groups, member, weight, block, xp):
    """How far apart the two sides of each contact were when the substep began."""
    expect_places(block)
    for g in range(np.uint64(groups)):
        store_three(block, g, APART, gather(xp, member, weight, g))


@njit(nogil=True, error_model="numpy", fastmath={"contract"})
def solve_contacts(groups, order, filled, member, weight, share, block, x, friction, back, tolerance, work):
    """One sweep through the groups of contacts, or `back` from their end: no approach below the contact distance,
    nor nearer than when the substep began where that was less; Coulomb friction. BORNE: what each contact has
    borne in this substep so far [kg m]; the sweep may take from it, but no contact pulls. -> whether it
    moved the sides of one by more than `tolerance` [m]. work: (n, 4) scratch, a row for each of n contacts"""
    one, end, moved, nothing, unit = np.uint64(1), np.uint64(groups), False, splat_f64x8(0.0), splat_f64x8(1.0)
    mu, most_way, full = splat_f64x8(friction), splat_f64x8(tolerance), np.uint8(EIGHT)
    expect_places(block)
    for row in range(end):
        g = end - one - row if back else row
        rx, ry, rz = gather(x, member, weight, g)
        bx, by, bz = load_three(block, g, BORNE)
        px, py, pz = load_three(block, g, APART)
        nx, ny, nz = load_three(block, g, NORMAL)
        least_gap, inv = load_f64x8(block, g, GAP), load_f64x8(block, g, INVERSE)
        d, dp = dots(nx, ny, nz, rx, ry, rz), dots(nx, ny, nz, px, py, pz)
        borne = dots(bx, by, bz, nx, ny, nz)
        press = vmax(nothing, borne + (vmin(least_gap, dp) - d) * inv)
        # the tangential motion of this substep, and what friction would have to bear to undo it
        ax = bx - borne * nx - inv * (rx - px - (d - dp) * nx)
        ay = by - borne * ny - inv * (ry - py - (d - dp) * ny)
        az = bz - borne * nz - inv * (rz - pz - (d - dp) * nz)
        hold = vsqrt(dots(ax, ay, az, ax, ay, az))
        slide = where_above(hold, nothing, vmin(unit, vdiv(mu * press, hold)), nothing)
        jx, jy, jz = press * nx + slide * ax, press * ny + slide * ay, press * nz + slide * az
        # nothing changes for one that bears nothing and is apart
        jx = where_above(borne, nothing, jx, where_above(least_gap, d, jx, bx))
        jy = where_above(borne, nothing, jy, where_above(least_gap, d, jy, by))
        jz = where_above(borne, nothing, jz, where_above(least_gap, d, jz, bz))
        store_three(block, g, BORNE, (jx, jy, jz))
        mx, my, mz, way = jx - bx, jy - by, jz - bz, most_way * inv
        moved = moved | any_above(dots(mx, my, mz, mx, my, mz), way * way)
        if filled[g] == full:
            add_shares(x, member, share, g, mx, my, mz)
        else:
            scatter(work, order, g, mx, my, mz)
            for k in range(np.uint64(filled[g])):
                at = np.uint64(EIGHT) * g + k
                i, j, a, m = members(member, at)
                more = load(work, np.uint64(order[g, k]))
                si, sj, sk, sm = spread(load(share, at))
                store(x, i, load(x, i) + si * more)
                store(x, j, load(x, j) + sj * more)
                store(x, a, load(x, a) + sk * more)
                store(x, m, load(x, m) + sm * more)
    return moved


@njit(nogil=True)
def average_impulses(groups, order, block, contact_impulses):
    """Let the memory of each contact follow what it bore in this substep: the next one begins with it."""
    expect_places(block)
    little = splat_f64x8(MEMORY)
    for g in range(np.uint64(groups)):
        bx, by, bz = load_three(block, g, BORNE)
        x, y, z = load_three(block, g, OF_LATE)
        x, y, z = x + little * (bx - x), y + little * (by - y), z + little * (bz - z)
        store_three(block, g, BORNE, (x, y, z))
        store_three(block, g, OF_LATE, (x, y, z))
        scatter(contact_impulses, order, g, x, y, z)


@njit(nogil=True)
def remember_impulses(n_vt, n, contact_pairs, contact_impulses, vt_j, ee_j):
    """Give what the contacts bear back to their pairs, until the next narrow phase."""
    for c in range(n):
        store(vt_j if c < n_vt else ee_j, contact_pairs[c], load(contact_impulses, c))
