# mypy: allow-untyped-defs, allow-incomplete-defs
"""Self-contact of cloth: the contacts, and the sweeps over them.

The search for pairs is in cluster_search.py. The narrow phase runs every few substeps (vertex_triangle.py,
edge_edge.py). It finds the near pairs, their sides and weights; each near pair is a linear constraint n . sum(b_i
x_i) >= thickness until the next narrow phase. While a pair is apart, its side follows the geometry; while it is
near, its side is fixed: a pair that was pressed through is pushed back to its side. The next narrow phase comes
earlier if a pair is fast enough to pass through before it, and later if no pair is fast.

A substep repeats its sweep over the contacts until a sweep moves no contact by much: two sweeps where layers rest
on each other, up to six where they are pressed or pulled hard, as at a pinch or where cloth is caught in cloth.

Overlap that exists before the substep is released gradually, by shifting the present and the old positions
equally. The release thus causes no velocity, which would throw layers apart. Coulomb friction acts at position
level and is bounded by the total normal impulse of a contact in the substep.

The contacts of a narrow phase are stored in a list. Two other orders are computed (contact_order.py): the order of
`take_turns`, in which overlap is released and initial impulses are applied, and groups of EIGHT, which the sweeps
solve together. `lay_out` copies the data for the sweeps, group by group, into blocks of registers, where the
impulses stay until the next narrow phase. After each substep `average_impulses` writes the mean impulses back to
the list; the next substep begins with them.

Every contact stores the mean of its impulses over some substeps and begins each substep with it (warm starting, as
in sequential impulses: Catto 2005). A few sweeps then carry a stack of layers without creep and with true masses:
the table bears the weight of all layers. The mean is used instead of the last impulse, because the last impulse
and the velocities would form a loop of two integrators, which oscillates.
"""

from __future__ import annotations

import numpy as np
from numba.extending import register_jitable

from foldcell.skills.cloth.inner import inner
from foldcell.skills.cloth.simd.f64x8 import (
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
    vmax,
    vmin,
    vsqrt,
    where_above,
)  # fmt: skip
from foldcell.skills.cloth.simd.vec3 import dot, load, members, spread, store

# A phase is the usual time from one narrow phase to the next: at most 1 / PHASES [s], but at least PHASE substeps.
PHASE, PHASES = 4, 240
# x thickness: if a contact may move farther in a phase, the next narrow phase comes after half a phase
HASTE_WAY = 2.0
# x thickness: if no contact may move farther in two phases, the next narrow phase comes after two phases
LEISURE_WAY = 1.0
RELEASE = 1.25  # x contact distance: beyond this distance a pair is apart, and its side follows the geometry
GIVE_UP = 3.0  # x contact distance: a pair that is pressed through by more than this forgets its side
# Contact distance of edges: EDGE_SHARE x thickness. In thin cloth it is EDGE_DISTANCE [m], because a snag could
# pull such cloth through other cloth within a substep. In very thin cloth it is MOST_EDGE_SHARE x thickness,
# because layers lie a thickness apart, and their edges must not push each other.
EDGE_SHARE, EDGE_DISTANCE, MOST_EDGE_SHARE = 0.5, 0.001, 0.8
# Lower bound of a contact's inverse mass, as a share of the largest inverse mass of its vertices. It has an effect
# if few of the vertices can move: without it, a vertex with a small weight would be flung away.
LEAST_SHARE = 0.25
STRAY = 2.5e-4  # [m] allowance for motion until the next narrow phase that the relative speed does not predict
PARKED = 2**30  # substep at which a sleeping pair is due: never
MAX_WAIT = 12  # x pace: longest time for which a distant pair is not examined
MEMORY = 0.05  # weight of the latest substep's impulse in a contact's mean impulse; with 1, stacks oscillate
LEAST_SWEEPS, MOST_SWEEPS = 2, 6  # bounds of the number of sweeps in a substep
TOLERANCE = 0.03  # x thickness: after LEAST_SWEEPS, a sweep that moved no contact by more than this is the last
OVERLAP_SHARE = 0.4  # share of an existing overlap that is released in a substep
OVERLAP_SPEED = 0.4  # [m/s] greatest speed of this release
# Places of the registers in a group's block. NORMAL: normals of the contacts (three registers), GAP: contact
# distances, INVERSE: effective masses. APART: separation at the beginning of the substep, BORNE: impulse in this
# substep, OF_LATE: mean impulse (three registers each). PLACES: number of registers.
NORMAL, GAP, INVERSE, APART, BORNE, OF_LATE, PLACES = 0, 3, 4, 5, 8, 11, 14


@inner(forceinline=True)
def expect_places(block):
    """Check that a block has PLACES registers per group, so that the compiler can compute offsets from
    constants."""
    if block.shape[1] != PLACES or block.shape[2] != EIGHT:
        raise ValueError("not blocks of so many registers")


@inner(forceinline=True)
def load_three(block, g, place):
    """Load a vector for each contact of a group: the three registers of coordinates that begin at `place`."""
    return load_f64x8(block, g, place), load_f64x8(block, g, place + 1), load_f64x8(block, g, place + 2)


@inner(forceinline=True)
def store_three(block, g, place, a):
    """Store three registers of coordinates, the reverse of `load_three`."""
    store_f64x8(block, g, place, a[0])
    store_f64x8(block, g, place + 1, a[1])
    store_f64x8(block, g, place + 2, a[2])


@register_jitable
def edge_distance(thick: float) -> float:
    """Return the contact distance of edges [m] for a thickness [m]."""
    return max(EDGE_SHARE * thick, min(MOST_EDGE_SHARE * thick, EDGE_DISTANCE))


def phase_length(h: float, substeps: int) -> int:
    """Return the number of substeps of `h` [s] in a phase. A frame of `substeps` has a whole number of phases."""
    fitting = [n for n in range(PHASE, substeps + 1) if substeps % n == 0 and n * h * PHASES < 1.0 + 1e-9]
    return max(fitting, default=PHASE)


@inner()
def next_narrow_phase(s, substeps, phase, pace, way):
    """Return the substep of the next narrow phase, and its pace: the number of substeps for which its contacts
    will be valid. The contacts of the present narrow phase, in substep s, are valid for `pace` substeps. way:
    largest approach in a substep of a pair that may touch, x thickness."""
    step = phase // 2 if way * phase > HASTE_WAY else phase if 2 * way * phase > LEISURE_WAY else 2 * phase
    on_grid = s - s % phase + max(phase, min(step, pace))
    return min(s + step, on_grid, substeps), max(step, phase)


@inner(forceinline=True)
def is_due(due, now, pace):
    """Return whether a pair has to be examined in this narrow phase, because the next one would be too late."""
    return due < now + pace


@inner()
def later(now, pace, free, reach):
    """Return the substep in which a pair is to be examined again. The pair has to approach by `free` [m] to touch,
    and can approach by `reach` [m] in `pace` substeps."""
    return now + pace * (1 + int(min(max(free - reach, 0.0) / reach, MAX_WAIT)))


@inner(error_model="numpy", fastmath={"contract"})
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
    """Move overlapping contacts apart, shifting old and present positions equally, so that no velocity results."""
    most_way = OVERLAP_SPEED * h
    for place in range(np.uint64(n)):
        c = np.uint64(turn[place])
        i, j, k, m = members(contact_vertices, c)
        bi, bj, bk, bm = spread(load(contact_weights, c))
        pi, pj, pk, pm = load(xp, i), load(xp, j), load(xp, k), load(xp, m)
        normal = load(contact_normals, c)
        overlap = contact_distances[c] - dot(normal, bi * pi + bj * pj + bk * pk + bm * pm)
        # zero for a contact that is apart; about half are apart, so a branch would be mispredicted too often
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


@inner(error_model="numpy", fastmath={"contract"})
def apply_impulses(n, turn, contact_vertices, contact_mobilities, contact_impulses, x):
    """Apply the mean impulses of the contacts at the beginning of a substep. Branch-free."""
    for place in range(np.uint64(n)):
        c = np.uint64(turn[place])
        i, j, k, m = members(contact_vertices, c)
        borne = load(contact_impulses, c)
        si, sj, sk, sm = spread(load(contact_mobilities, c))
        store(x, i, load(x, i) + si * borne)
        store(x, j, load(x, j) + sj * borne)
        store(x, k, load(x, k) + sk * borne)
        store(x, m, load(x, m) + sm * borne)


@inner()
def room_for_groups(n):
    """Return uninitialised arrays for n groups: member, weight, share and block (see `lay_out`)."""
    member = np.empty((n * EIGHT, 4), np.uint32)
    weight, share = blocks(n, 4).reshape((n * EIGHT, 4)), blocks(n, 4).reshape((n * EIGHT, 4))
    return member, weight, share, blocks(n, PLACES)


@inner()
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
    """Copy the data for the sweeps in the order in which the sweeps read it. member, weight, share: (m * EIGHT, 4)
    copies of contact_vertices, contact_weights and contact_mobilities. block: (m, PLACES, EIGHT) the registers of
    each group; all are filled except APART."""
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


@inner()
def measure_sides(groups, member, weight, block, xp):
    """Store in APART the separation of the two sides of each contact at the beginning of the substep, as a
    vector."""
    expect_places(block)
    for g in range(np.uint64(groups)):
        store_three(block, g, APART, gather(xp, member, weight, g))


@inner(error_model="numpy", fastmath={"contract"})
def solve_contacts(groups, order, filled, member, weight, share, block, x, friction, back, tolerance, work):
    """Do one sweep over the groups of contacts, in reverse order if `back` is set, with Coulomb friction. The
    sweep keeps the two sides of a contact at least the contact distance apart, or their distance at the beginning
    of the substep if this was less. BORNE: the impulse of each contact in this substep so far [kg m]; the sweep
    may reduce it, but no contact pulls. Returns whether the sweep moved the sides of a contact by more than
    `tolerance` [m]. work: (n, 4) scratch, one row per contact."""
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
        # the friction impulse that would undo the tangential motion of this substep
        ax = bx - borne * nx - inv * (rx - px - (d - dp) * nx)
        ay = by - borne * ny - inv * (ry - py - (d - dp) * ny)
        az = bz - borne * nz - inv * (rz - pz - (d - dp) * nz)
        hold = vsqrt(dots(ax, ay, az, ax, ay, az))
        slide = where_above(hold, nothing, vmin(unit, mu * press / hold), nothing)
        jx, jy, jz = press * nx + slide * ax, press * ny + slide * ay, press * nz + slide * az
        # no change for a contact that is apart and bears no load
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


@inner()
def average_impulses(groups, order, block, contact_impulses):
    """Update each contact's mean impulse with its impulse in this substep; the next substep begins with the
    mean."""
    expect_places(block)
    little = splat_f64x8(MEMORY)
    for g in range(np.uint64(groups)):
        bx, by, bz = load_three(block, g, BORNE)
        x, y, z = load_three(block, g, OF_LATE)
        x, y, z = x + little * (bx - x), y + little * (by - y), z + little * (bz - z)
        store_three(block, g, BORNE, (x, y, z))
        store_three(block, g, OF_LATE, (x, y, z))
        scatter(contact_impulses, order, g, x, y, z)


@inner()
def remember_impulses(n_vt, n, contact_pairs, contact_impulses, vt_j, ee_j):
    """Store the impulses of the contacts with their pairs, for the next narrow phase."""
    for c in range(n):
        store(vt_j if c < n_vt else ee_j, contact_pairs[c], load(contact_impulses, c))
