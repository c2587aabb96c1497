"""The search for pairs against every pair."""

import numpy as np
import pytest

from skills.cloth.contact import EDGE_SHARE, RELEASE
from skills.cloth.mesh import ClothMesh, mesh_from_contour
from skills.cloth.patches import build_patches, fit_patches, search_pairs

THICK, SLACK, HORIZON = 0.003, 0.001, 0.02


def two_sheets():
    """Two waved sheets that pass through each other."""
    square = np.array([[-0.09, -0.08], [0.09, -0.08], [0.09, 0.08], [-0.09, 0.08]])
    sheets = [mesh_from_contour(square, 0.026, rotate=0.3 * k) for k in range(2)]
    n = len(sheets[0].rest)
    of_vertex = np.repeat([0, 1], [n, len(sheets[1].rest)]).astype(np.int32)
    triangles = np.vstack([sheets[0].triangles, sheets[1].triangles + n]).astype(np.int32)
    of_triangle = np.repeat([0, 1], [len(s.triangles) for s in sheets]).astype(np.int32)
    rest = np.vstack([s.rest for s in sheets])
    mesh = ClothMesh(rest, of_vertex, triangles, of_triangle, np.zeros((0, 2), np.int32))
    height = np.where(of_vertex == 0, 0.01 * np.sin(20 * rest[:, 0]), 0.01 * np.cos(25 * rest[:, 1]))
    return mesh, np.column_stack([rest, height])


def nearest(a, b):
    """Least distance of two convex hulls of points (k, 3), (m, 3), after Frank and Wolfe (not less)."""
    box = max((a.min(axis=0) - b.max(axis=0)).max(), (b.min(axis=0) - a.max(axis=0)).max())
    if box > RELEASE * THICK:
        return box
    u, v = np.full(len(a), 1 / len(a)), np.full(len(b), 1 / len(b))
    for _ in range(20):
        d = u @ a - v @ b
        i, j = np.argmin(a @ d), np.argmax(b @ d)
        e = a[i] - b[j]
        s = np.clip(d @ (d - e) / max((d - e) @ (d - e), 1e-30), 0.0, 1.0)
        u, v = (1 - s) * u, (1 - s) * v
        u[i] += s
        v[j] += s
    return np.linalg.norm(u @ a - v @ b)


@pytest.mark.parametrize("stale_share", [1.0, 0.1])
def test_every_pair_of_two_sheets_that_is_near_is_found(stale_share):
    mesh, x = two_sheets()
    n, rng = len(x), np.random.default_rng(2)
    edges, triangles = mesh.edges.astype(np.int32), mesh.triangles
    patches = build_patches(mesh, edges)
    stale = rng.random(n) < stale_share
    course = np.where(mesh.layer[:, None] == 0, 0.1, 0.0) * np.array([1.0, 0.0, 1.0]) * stale[:, None]
    vt, ee = np.zeros((40000, 2), np.int32), np.zeros((40000, 2), np.int32)
    fit_patches(
        patches, triangles, edges, x, course, np.full(n, SLACK), np.zeros(n, np.int32), 0, 0.004, stale, True
    )
    n_vt, n_ee = search_pairs(patches, triangles, edges, THICK, HORIZON, vt, ee)
    found_vt, found_ee = {tuple(p) for p in vt[:n_vt].tolist()}, {tuple(p) for p in ee[:n_ee].tolist()}
    assert len(found_vt) == n_vt and len(found_ee) == n_ee  # each once
    where = [x, x + HORIZON * course]
    layer = mesh.layer
    for t, tri in enumerate(triangles):
        close = np.flatnonzero((np.abs(x - x[tri].mean(axis=0)) < 0.03).all(axis=1) & (layer != layer[tri[0]]))
        for i in close:
            if stale[i] or stale[tri].any():
                apart = min(nearest(y[[i]], y[tri]) for y in where)
                assert apart > RELEASE * THICK or (i, t) in found_vt
    middle = x[edges].mean(axis=1)
    for e, (i, j) in enumerate(edges[layer[edges[:, 0]] == 0]):
        e = int(np.flatnonzero((edges == [i, j]).all(axis=1))[0])
        for f in np.flatnonzero((np.abs(middle - middle[e]) < 0.03).all(axis=1) & (layer[edges[:, 0]] == 1)):
            if stale[[i, j, *edges[f]]].any():
                apart = min(nearest(y[[i, j]], y[edges[f]]) for y in where)
                assert apart > EDGE_SHARE * RELEASE * THICK or (min(e, f), max(e, f)) in found_ee
