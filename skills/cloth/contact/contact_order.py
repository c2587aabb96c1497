# mypy: allow-untyped-defs, allow-incomplete-defs
"""Computes orders of contacts in which successive contacts, or contacts that are solved together, have no common
vertex.

Neighbours in the list of contacts often share vertices; in list order, each contact would wait for the writes of
the contact before it. Contacts that share a vertex keep their order, so the result is the same as for solving the
contacts one by one.
"""

from __future__ import annotations

import numpy as np

from foldcell.skills.cloth.inner import inner
from foldcell.skills.cloth.simd.f64x8 import EIGHT
from foldcell.skills.cloth.simd.vec3 import members

# Number of parts of the list from which contacts are taken in turn. Neighbours in the list often share vertices
# and then cannot be in one group.
PARTS = 4


@inner()
def take_turns(n, contact_vertices, taken, turn, level, first):
    """Find an order in which successive contacts seldom share a vertex, so that a contact need not wait for the
    writes of another contact. Contacts that share a vertex keep their order. turn: (n,) the contacts in the new
    order: first all contacts that depend on no other contact, then those that depend only on these, and so on. A
    contact depends on an earlier contact if they share a vertex. taken: (vertices,), level: (n,) and first: (n +
    1,) scratch."""
    one, count, levels = np.uint64(1), np.uint64(n), np.uint64(0)
    taken[:] = 0  # first free level of each vertex
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


@inner()
def group_contacts(n, contact_vertices, taken, order, filled):
    """Put the contacts into groups of up to EIGHT contacts without a common vertex; a sweep solves a group
    together. Contacts that share a vertex keep the order of the interleaved list, which takes one contact from
    each of the PARTS parts of the list in turn. A sweep thus gives the same result as solving the contacts one by
    one in the interleaved order. Returns the number of groups.

    order: (m, EIGHT) the contacts of each group. filled: (m,) number of contacts in each group; the remaining
    places of the group repeat its first contact. taken: (vertices,) scratch.
    """
    one, parts, count, full = np.uint64(1), np.uint64(PARTS), np.uint64(n), np.uint64(EIGHT)
    taken[:] = 0  # first free group of each vertex
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
