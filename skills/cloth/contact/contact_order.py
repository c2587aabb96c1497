# mypy: allow-untyped-defs, allow-incomplete-defs
"""Orders of contacts in which those that follow each other, or are solved at once, have no common vertex.

Neighbours in the list of contacts often share vertices, and each would wait for what the one before writes. Where
two share a vertex their order is kept, so that the result is that of one by one.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from skills.cloth.simd.f64x8 import EIGHT
from skills.cloth.simd.vec3 import members

__all__ = ["PARTS", "group_contacts", "take_turns"]

# neighbours in the list often share vertices, and can then not be of one group: one contact of each of so many
# parts of the list comes in turn
PARTS = 4


@njit(nogil=True)
def take_turns(n, contact_vertices, taken, turn, level, first):
    """An order in which contacts that follow each other seldom have a common vertex, so that one need not wait for
    what another one writes; those that have one keep theirs. turn: (n,) the contacts in it: first all that come
    after no other, then all that come after one of these, and so on. taken: (vertices,), level: (n,) and first:
    (n + 1,) scratch."""
    one, count, levels = np.uint64(1), np.uint64(n), np.uint64(0)
    taken[:] = 0  # the level after that of the last one of each vertex
    first[: n + 1] = 0
    for c in range(count):
        i, j, k, m = members(contact_vertices, c)
        own = np.uint64(max(max(taken[i], taken[j]), max(taken[k], taken[m])))
        after = own + one
        taken[i] = taken[j] = taken[k] = taken[m] = after
        level[c] = own
        first[after] += np.uint32(1)
        levels = max(levels, after)
    for before in range(levels):
        first[before + one] += first[before]
    for c in range(count):
        own = np.uint64(level[c])
        turn[np.uint64(first[own])] = c
        first[own] += np.uint32(1)


@njit(nogil=True)
def group_contacts(n, contact_vertices, taken, order, filled):
    """Put the contacts into groups of up to EIGHT without a common vertex, which a sweep solves at once. Where two
    share a vertex, they are solved in the order in which one contact of each of PARTS of the list comes in turn,
    and so the sweep's result is that of solving them one by one. -> groups

    order: (m, EIGHT) the contacts of each, filled: (m,) how many of these (the rest repeats the first). taken:
    (vertices,) scratch."""
    one, parts, count, full = np.uint64(1), np.uint64(PARTS), np.uint64(n), np.uint64(EIGHT)
    taken[:] = 0  # the group after the last one of each vertex
    length, begin, end = (count + parts - one) // parts, np.uint64(0), np.uint64(0)
    for place in range(length):
        for part in range(parts):
            c = part * length + place
            if c >= count:
                continue
            i, j, k, m = members(contact_vertices, c)
            g = max(begin, np.uint64(max(max(taken[i], taken[j]), max(taken[k], taken[m]))))
            while g < end and filled[g] == full:
                g += one
            if g == end:
                filled[g] = 0
                end += one
            order[g, np.uint64(filled[g])] = c
            filled[g] += np.uint8(1)
            taken[i] = taken[j] = taken[k] = taken[m] = g + one
            while begin < end and filled[begin] == full:
                begin += one
    for row in range(end):
        for k in range(np.uint64(filled[row]), full):
            order[row, k] = order[row, np.uint64(0)]
    return np.int64(end)
