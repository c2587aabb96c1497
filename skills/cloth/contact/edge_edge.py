# mypy: allow-untyped-defs, allow-incomplete-defs
"""Narrow phase of edges against edges: finds which pairs touch, and on which side."""

from __future__ import annotations

import numpy as np

from foldcell.skills.cloth.contact.contacts import GIVE_UP, LEAST_SHARE, PARKED, RELEASE, STRAY, later
from foldcell.skills.cloth.contact.vertex_triangle import find_due
from foldcell.skills.cloth.inner import inner
from foldcell.skills.cloth.simd.vec3 import cross, dot, load, store, vector

# sin^2 of an angle: two edges at a smaller angle count as parallel, and vertex-triangle contacts keep them apart
NEAR_PARALLEL = 0.02


@inner(error_model="numpy", fastmath={"contract"}, forceinline=True)
def _closest_on_segments(a, b, r):
    """Return the parameters (s, t), from 0 to 1, of the closest points of two segments along the vectors a and b;
    r is the vector from the start of the second segment to the start of the first (Ericson 2005, 5.1.9)."""
    aa, bb = dot(a, a) + 1e-30, dot(b, b) + 1e-30
    f, c, ab = dot(b, r), dot(a, r), dot(a, b)
    den = aa * bb - ab * ab
    s = min(max((ab * f - c * bb) / den, 0.0), 1.0) if den > 1e-12 * aa * bb else 0.5
    t = (ab * s + f) / bb
    if t < 0.0:
        return min(max(-c / aa, 0.0), 1.0), 0.0
    if t > 1.0:
        return min(max((ab - c) / aa, 0.0), 1.0), 1.0
    return s, t


@inner(error_model="numpy", fastmath={"contract"}, forceinline=True)
def _sided(c, n, d, near, normal, release, give_up):
    """Return the normal and the gap of two crossing edges on their remembered side. Also updates what is
    remembered for pair c: near[c] and normal[c]."""
    lean = dot(n, load(normal, c)) if near[c] else d
    if lean < 0.0:
        n, d = -n, -d
    if near[c] and (d > release or d < -give_up):
        near[c] = False
        if d < 0.0:
            n, d = -n, -d
    elif d < release:
        near[c] = True
        store(normal, c, n)
    return n, d


@inner(error_model="numpy", fastmath={"contract"})
def narrow_edge_edge(count, n, now, pace, h, thick, edge, rim, x, v, w, pairs):
    """Update the sides of the pairs, and write those that can touch within `pace` substeps of h [s] as contacts
    from row n on. Returns the number of rows, including the first n, and the largest distance that one of these
    pairs may move in this time [m].

    rim: (e,) True for edges of hems and seams. If two rim edges meet edge-on, as when two sheets slide towards
    each other on the table, the normal is the direction of the shortest line between the edges, because no other
    normal exists.
    """
    pair, edge, near, normal = pairs.ee.view(np.uint32), edge.view(np.uint32), pairs.near, pairs.normal
    due, memory = pairs.ee_due, pairs.ee_j
    contact_vertices, contact_weights, contact_mobilities, contact_normals, contact_impulses = (
        pairs.contact_vertices,
        pairs.contact_weights,
        pairs.contact_mobilities,
        pairs.contact_normals,
        pairs.contact_impulses,
    )
    contact_distances, contact_masses, contact_pairs, asked = (
        pairs.contact_distances,
        pairs.contact_masses,
        pairs.contact_pairs,
        pairs.some,
    )
    release, give_up, nothing = RELEASE * thick, GIVE_UP * thick, vector(0.0, 0.0, 0.0)
    farthest, span, n = 0.0, pace * h, np.uint64(n)
    for place in range(find_due(count, now, pace, due, asked)):
        c = np.uint64(asked[place])
        i, j = edge[pair[c, 0], 0], edge[pair[c, 0], 1]
        k, m = edge[pair[c, 1], 0], edge[pair[c, 1], 1]
        if w[i] + w[j] + w[k] + w[m] == 0.0:
            due[c] = PARKED
            continue
        borne = load(memory, c)
        store(memory, c, nothing)
        pi, pk = load(x, i), load(x, k)
        a, b, r = load(x, j) - pi, load(x, m) - pk, pi - pk
        s, t = _closest_on_segments(a, b, r)
        way = r + s * a - t * b
        d2 = dot(way, way)
        slide = (1.0 - s) * load(v, i) + s * load(v, j) - (1.0 - t) * load(v, k) - t * load(v, m)
        reach = STRAY + span * 1.5 * np.sqrt(dot(slide, slide))
        seen = release + reach
        if d2 > seen * seen:
            near[c] = False
            due[c] = later(now, pace, np.sqrt(d2) - release, reach)
            continue
        direction = cross(a, b)
        nn = dot(direction, direction)
        inner = s > 1e-4 and s < 1.0 - 1e-4 and t > 1e-4 and t < 1.0 - 1e-4
        if nn < NEAR_PARALLEL * dot(a, a) * dot(b, b) or not inner:
            if near[c] and d2 > release * release:
                near[c] = False
            d = np.sqrt(d2)
            edge_on = rim[pair[c, 0]] and rim[pair[c, 1]] and not near[c] and d > 1e-6
            if not edge_on or d > thick + reach:
                continue
            direction = (1.0 / d) * way
        else:
            direction = (1.0 / np.sqrt(nn)) * direction
            direction, d = _sided(c, direction, dot(direction, way), near, normal, release, give_up)
            if d <= thick + reach:
                near[c] = True
                store(normal, c, direction)
        if d > thick + reach:
            continue
        den = (1 - s) * (1 - s) * w[i] + s * s * w[j] + (1 - t) * (1 - t) * w[k] + t * t * w[m]
        if den == 0.0:
            continue
        den = max(den, LEAST_SHARE * max(max(w[i], w[j]), max(w[k], w[m])))
        contact_vertices[n, 0], contact_vertices[n, 1], contact_vertices[n, 2], contact_vertices[n, 3] = i, j, k, m
        contact_weights[n, 0], contact_weights[n, 1], contact_weights[n, 2], contact_weights[n, 3] = (
            1 - s,
            s,
            t - 1,
            -t,
        )
        contact_mobilities[n, 0], contact_mobilities[n, 1], contact_mobilities[n, 2], contact_mobilities[n, 3] = (
            (1 - s) * w[i],
            s * w[j],
            (t - 1) * w[k],
            -t * w[m],
        )
        store(contact_normals, n, direction)
        store(contact_impulses, n, borne)
        contact_distances[n], contact_masses[n], contact_pairs[n] = thick, 1.0 / den, c
        n += np.uint64(1)
        farthest = max(farthest, reach)
    return np.int64(n), farthest
