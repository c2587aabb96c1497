"""The broad phase against a search over all pairs."""

import numpy as np
import pytest

from benchmarks.cloth.scenes import stacked
from foldcell.skills.cloth import kernel, solver
from foldcell.skills.cloth.broad_phase.cluster_bounds import fit_clusters, fit_ridges
from foldcell.skills.cloth.broad_phase.cluster_search import search_pairs
from foldcell.skills.cloth.broad_phase.pairs import HORIZON as PHASES_FORESEEN
from foldcell.skills.cloth.broad_phase.pairs import _expire
from foldcell.skills.cloth.clusters import build_clusters
from foldcell.skills.cloth.contact.contacts import PHASE, RELEASE, edge_distance
from foldcell.skills.cloth.elasticity import turns
from foldcell.skills.cloth.mesh import mesh_from_contour
from foldcell.skills.cloth.settings import SolverSettings
from foldcell.skills.cloth.simd.i32x16 import LANES
from foldcell.skills.cloth.solver import ClothSimulation
from foldcell.skills.cloth.state import EE, SUBSTEP, VT, new_pairs
from foldcell.skills.vocabulary import Material
from tests.builders.cloth import EVERY_EDGE, call

THICK, SLACK, HORIZON = 0.003, 0.001, 0.02
MATERIAL = Material(
    areal_mass=0.3, stretch_fraction=0.03, bending_length=0.02, thickness=THICK, friction_static=0.6,
    friction_dynamic=0.55, friction_layers=0.5,
)  # fmt: skip


def two_sheets():
    """Two waved sheets that pass through each other."""
    square = np.array([[-0.09, -0.08], [0.09, -0.08], [0.09, 0.08], [-0.09, 0.08]])
    mesh = stacked([mesh_from_contour(square, 0.026, rotate=0.3 * k) for k in range(2)])
    rest = mesh.rest
    height = np.where(mesh.layer == 0, 0.01 * np.sin(20 * rest[:, 0]), 0.01 * np.cos(25 * rest[:, 1]))
    return mesh, np.column_stack([rest, height])


def nearest(a, b):
    """Distances (p,) of the hulls of points (p, k, 3) and (p, m, 3), pair by pair, by the Frank-Wolfe method. The
    results are upper bounds. Where the boxes of two hulls are far apart, it is the distance of the boxes."""
    gap = np.maximum(a.min(axis=1) - b.max(axis=1), b.min(axis=1) - a.max(axis=1)).max(axis=1)
    close = gap <= RELEASE * THICK
    a, b = a[close], b[close]
    u, v = np.full(a.shape[:2], 1 / a.shape[1]), np.full(b.shape[:2], 1 / b.shape[1])
    pair = np.arange(len(a))
    for _ in range(20):
        d = apart(a, b, u, v)
        i, j = np.argmin(dots(a, d[:, None]), axis=1), np.argmax(dots(b, d[:, None]), axis=1)
        way = d - (a[pair, i] - b[pair, j])
        s = np.clip(dots(d, way) / np.maximum(dots(way, way), 1e-30), 0.0, 1.0)
        u, v = (1 - s)[:, None] * u, (1 - s)[:, None] * v
        u[pair, i] += s
        v[pair, j] += s
    gap[close] = np.linalg.norm(apart(a, b, u, v), axis=1)
    return gap


def dots(a, b):
    return (a * b).sum(axis=-1)


def apart(a, b, u, v):
    """Vectors (p, 3) between the points with the weights u of a and v of b."""
    return (u[..., None] * a).sum(axis=1) - (v[..., None] * b).sum(axis=1)


def near_pairs(first, second, candidate, places, asked, limit):
    """Pairs (p, 2) of rows of `first` (r, k) and `second` (s, m), vertices of hulls, that are near in one of
    `places`. candidate (r, s): the pairs to look at. asked (n,): a pair counts if this holds for one of its
    vertices."""
    e, f = np.nonzero(candidate & (asked[first].any(axis=1)[:, None] | asked[second].any(axis=1)))
    distance = np.min([nearest(y[first[e]], y[second[f]]) for y in places], axis=0)
    near = distance <= limit
    return list(zip(e[near].tolist(), f[near].tolist(), strict=True))


def beside(a, b):
    """Which points (r, 3) and (s, 3) are near each other along every axis."""
    return (np.abs(a[:, None] - b) < 0.03).all(axis=2)


def near_vertices(mesh, places, asked):
    """Pairs of a vertex and a triangle of different layers that are near in one of `places`."""
    x, tri, one = places[0], mesh.triangles, np.arange(len(mesh.layer))[:, None]
    candidate = beside(x, x[tri].mean(axis=1)) & (mesh.layer[:, None] != mesh.layer[tri[:, 0]])
    return near_pairs(one, tri, candidate, places, asked, RELEASE * THICK)


def near_edges(mesh, edges, places, asked):
    """Pairs of edges of different layers that are near in one of `places`. The first is of layer 0."""
    middle, of = places[0][edges].mean(axis=1), mesh.layer[edges[:, 0]]
    candidate = beside(middle, middle) & (of == 0)[:, None] & (of == 1)
    return near_pairs(edges, edges, candidate, places, asked, RELEASE * edge_distance(THICK))


def missing_pairs(mesh, edges, places, found_vt, found_ee, asked):
    """Pairs of different layers that are near in one of `places` but were not found.

    asked (n,): a pair must be found if this holds for one of its vertices. Returns missing vertex-triangle pairs,
    missing edge-edge pairs, and the number of near pairs.
    """
    vt, ee = near_vertices(mesh, places, asked), near_edges(mesh, edges, places, asked)
    lost_vt = [pair for pair in vt if pair not in found_vt]
    lost_ee = [(e, f) for e, f in ee if (min(e, f), max(e, f)) not in found_ee]
    return lost_vt, lost_ee, len(vt) + len(ee)


def bits_of(clusters, chosen):
    """The chosen edges (e,) as bits in the layout of the clusters."""
    bits = np.zeros(clusters.edge.shape, np.int32)
    bits.ravel()[clusters.at_edge[chosen]] = 1
    return (bits << np.arange(bits.shape[1])).sum(axis=1).astype(np.int32)


@pytest.mark.parametrize(("stale_share", "ridge_share"), [(1.0, 1.0), (0.4, 1.0), (1.0, 0.5), (0.4, 0.2)])
def test_every_near_pair_of_two_sheets_is_found(stale_share, ridge_share):
    """Of the edges, only ridges are found."""
    mesh, x = two_sheets()
    rng = np.random.default_rng(2)
    edges = mesh.edges.astype(np.int32)
    clusters = build_clusters(mesh, edges)
    m, corner = len(clusters.tri), clusters.corner
    clusters.stale[:] = rng.random(m) < stale_share
    clusters.stale[0] = True
    speed = np.where(mesh.layer[:, None] == 0, 0.1, 0.0) * np.array([1.0, 0.0, 1.0])
    base, course = (np.ascontiguousarray(a[corner].T, np.float32) for a in (x, speed))
    vt, ee = np.zeros((40000, 2), np.int32), np.zeros((40000, 2), np.int32)
    moving, slack = (speed[:, 0] > 0)[corner[clusters.corner_start[:-1]]], np.full(m, SLACK, np.float32)
    call(
        fit_clusters,
        clusters,
        base,
        course,
        slack,
        np.zeros(m, np.int32),
        moving,
        0,
        0.004,
        0.5 * HORIZON,
        True,
        EVERY_EDGE,
    )
    ridge = rng.random(len(edges)) < ridge_share
    clusters.ridge[:] = bits_of(
        clusters, np.ones(len(edges), bool)
    )  # all edges first, then fewer: nothing of the first remains
    call(fit_ridges, clusters, course, slack)
    np.testing.assert_array_equal(clusters.ridge, clusters.bent)
    clusters.fitted[:] = False
    clusters.ridge[:] = bits_of(clusters, ridge)
    call(fit_ridges, clusters, course, slack)
    n_vt, n_ee = call(search_pairs, clusters, THICK, 0.5 * HORIZON, vt, ee)
    found_vt, found_ee = {tuple(p) for p in vt[:n_vt].tolist()}, {tuple(p) for p in ee[:n_ee].tolist()}
    assert len(found_vt) == n_vt and len(found_ee) == n_ee  # each pair is found once
    stale = np.ones(len(x), bool)  # only vertices of stale clusters
    stale[corner[np.repeat(~clusters.stale, np.diff(clusters.corner_start))]] = False
    places = [x, x + 0.5 * HORIZON * speed, x + HORIZON * speed]
    lost_vt, lost_ee, near = missing_pairs(mesh, edges, places, found_vt, found_ee, stale)
    assert near > 20 and not lost_vt
    assert all(ridge[e] and ridge[f] for e, f in found_ee) and len(found_ee) > 20 * ridge_share**2
    assert not [(e, f) for e, f in lost_ee if ridge[e] and ridge[f]]
    for room in (LANES, 2 * LANES, 100):  # too short lists are reported, and nothing is written behind their ends
        short = [np.full((room + 2 * LANES, 2), -7, np.int32) for _ in range(2)]
        told = call(search_pairs, clusters, THICK, 0.5 * HORIZON, *(a[LANES : LANES + room] for a in short))
        for a, n, wanted, all_of_them in zip(short, told, (n_vt, n_ee), (vt, ee), strict=True):
            assert (a[:LANES] == -7).all() and (a[LANES + room :] == -7).all()
            assert n == wanted if wanted <= room - LANES else n > room - LANES
            kept = min(n, room - LANES)
            np.testing.assert_array_equal(a[LANES : LANES + kept], all_of_them[:kept])


@pytest.mark.parametrize("turn", [0.0, 0.5, 1.0])
@pytest.mark.parametrize(("half", "overlap"), [((0.01, 0.01), -5e-4), ((0.01, 0.01), 0.04), ((0.0, 0.05), 0.04)])
def test_self_contact_of_flat_cloth_in_a_notch_is_found(turn, half, overlap):
    """The legs of pants on a table are moved together until their seams nearly touch, or until one leg lies on the
    other.

    half: half of the notch's width at its end and at its opening [m].
    """
    out, across = np.array([np.cos(turn), np.sin(turn)]), np.array([-np.sin(turn), np.cos(turn)])
    seam = [(0.0, half[0]), (0.2, half[1])]
    leg = [(-0.1, 0.12), (0.2, 0.12), *seam[::-1]]
    outline = [*leg, *((x, -y) for x, y in reversed(leg) if y > 0.0)]
    mesh = mesh_from_contour(np.array(outline)[::-1] @ np.array([out, across]), 0.02)
    along, side = mesh.rest @ out, np.sign(mesh.rest @ across) * (mesh.rest @ out > 0.01)
    closed = np.clip((along - 0.05) / 0.05, 0.0, 1.0)
    way = closed * (half[0] + (half[1] - half[0]) * along / 0.2 + 0.5 * overlap)
    x = np.column_stack(
        [mesh.rest - (side * way)[:, None] * across, closed * (side > 0.0) * (overlap > 0.0) * THICK]
    )
    edges = mesh.edges.astype(np.int32)
    clusters = build_clusters(mesh, edges)
    m, corner = len(clusters.tri), clusters.corner
    clusters.stale[:] = True
    base, still = np.ascontiguousarray(x[corner].T, np.float32), np.zeros((3, len(corner)), np.float32)
    born, moving, slack = np.zeros(m, np.int32), np.zeros(m, bool), np.full(m, SLACK, np.float32)
    call(fit_clusters, clusters, base, still, slack, born, moving, 0, 0.004, 0.0, True, EVERY_EDGE)
    call(fit_ridges, clusters, still, slack)
    vt, ee = np.zeros((40000, 2), np.int32), np.zeros((40000, 2), np.int32)
    n_vt, n_ee = call(search_pairs, clusters, THICK, 0.0, vt, ee)
    found_vt, found_ee = {tuple(p) for p in vt[:n_vt].tolist()}, {tuple(p) for p in ee[:n_ee].tolist()}

    def faces(first, second):
        """Which rows of vertices are wholly on opposite sides of the notch."""
        on, of = side[first], side[second]
        whole = (on == on[:, :1]).all(axis=1)[:, None] & (of == of[:, :1]).all(axis=1)
        return whole & (on[:, :1] == -of[:, 0]) & (on[:, :1] != 0.0)

    one, all_asked = np.arange(len(x))[:, None], np.ones(len(x), bool)
    touching = near_pairs(one, mesh.triangles, faces(one, mesh.triangles), [x], all_asked, RELEASE * THICK)
    seams = np.triu(faces(edges, edges)) & mesh.on_rim[:, None] & mesh.on_rim
    meeting = near_pairs(edges, edges, seams, [x], all_asked, RELEASE * edge_distance(THICK))
    assert len(touching) > 2 and len(meeting) > (0 if overlap > 0.0 else 2)
    assert not [p for p in touching if p not in found_vt] and not [p for p in meeting if p not in found_ee]


def test_normals_are_up_to_date_for_every_search():
    """The normals of stale clusters and of their neighbours decide whether a sheet can touch itself."""
    mesh = mesh_from_contour(np.array([[-0.3, -0.2], [0.3, -0.2], [0.3, 0.2], [-0.3, 0.2]]), 0.025)
    x = mesh.lay_flat(THICK)
    clusters = build_clusters(mesh, mesh.edges.astype(np.int32))
    m, corner = len(clusters.tri), clusters.corner
    still, slack = np.zeros((3, len(corner)), np.float32), np.full(m, SLACK, np.float32)

    def normals(x, stale, everything):
        clusters.stale[:] = stale
        base = np.ascontiguousarray(x[corner].T, np.float32)
        born, moving = np.zeros(m, np.int32), np.ones(m, bool)
        call(fit_clusters, clusters, base, still, slack, born, moving, 0, 0.004, 0.0, everything, EVERY_EDGE)
        return clusters.normal.copy()

    normals(x, True, True)
    bent = x + np.column_stack([0.0 * x[:, :2], 0.03 * np.sin(40.0 * x[:, 0])])
    stale = np.isin(np.arange(m), [0, m // 3, m // 3 + 1])
    some, every = normals(bent, stale, False), normals(bent, True, True)
    start, beside = clusters.beside_start, clusters.beside
    asked = np.unique(np.concatenate([beside[start[k] : start[k + 1]] for k in np.flatnonzero(stale)]))
    assert stale.sum() < len(asked) < m / 2 and np.isin(np.flatnonzero(stale), asked).all()
    np.testing.assert_array_equal(some[asked], every[asked])
    assert not np.array_equal(some, every)  # the other clusters were not fitted


@pytest.mark.parametrize(("gravity", "shake", "sleep_frames"), [(9.81, 0.05, 0), (9.81, 0.05, 10), (0.0, 0.0, 0)])
def test_pairs_of_moving_sheets_are_in_the_lists_at_every_narrow_phase(gravity, shake, sleep_frames, monkeypatch):
    """Sheets that fall onto each other, whose clusters leave their courses, and sheets that fly straight, whose
    courses run out."""
    mesh, x = two_sheets()
    x[:, 2] += np.where(mesh.layer == 1, 0.035, 0.012)
    rng = np.random.default_rng(3)
    settings = SolverSettings(
        frame_rate=240, substeps=PHASE, gravity=(0.0, 0.0, -gravity), drag=0.0, sleep_frames=sleep_frames
    )
    monkeypatch.setattr(solver, "flat_cosine", lambda *_: float(EVERY_EDGE))
    sim = ClothSimulation(mesh, MATERIAL, x, settings)
    upper = np.where(mesh.layer[:, None] == 1, 1.0, 0.0)
    sim.set_positions(x, upper * [0.3, 0.2, -0.8] + shake * rng.standard_normal(x.shape))
    edges, seen, searched = sim._body.edge, 0, []
    for _ in range(60):
        before = sim.positions
        sim.advance(1)
        counts, pairs = sim._state.counts, sim._pairs
        found_vt = {tuple(p) for p in pairs.vt[: counts[VT]].tolist()}
        found_ee = {tuple(p) for p in pairs.ee[: counts[EE]].tolist()}
        lost_vt, lost_ee, near = missing_pairs(mesh, edges, [before], found_vt, found_ee, ~sim.asleep)
        assert not lost_vt and not lost_ee
        seen += near
        searched.append(int(sim._body.clusters.stale.sum()))
    assert seen > 1000
    assert min(searched) < len(sim._body.clusters.tri)  # not all clusters are searched every time


def bent_edges(sim, x):
    """Edges that are bent enough to touch other edges, and edges with only one triangle."""
    hinge, edges = sim._body.hinge, np.sort(sim._body.edge, axis=1)
    number = {tuple(e): k for k, e in enumerate(edges.tolist())}
    bent = np.ones(len(edges), bool)
    at = [number[tuple(e)] for e in np.sort(hinge[:, :2], axis=1).tolist()]
    bent[at] = np.abs(turns(hinge, x)) > 2.0 * THICK / sim.mesh.edge_length.mean()
    return bent


def test_the_search_misses_almost_no_edge_pair_of_crumpled_sheets():
    """Pairs are missed for at most a frame, where an edge is bent now but will be flat in the middle of the
    horizon."""
    near = missing = 0
    for seed in range(3, 7):
        mesh, x = two_sheets()
        x[:, 2] = 3.0 * x[:, 2] + np.where(mesh.layer == 1, 0.035, 0.012)
        sim = ClothSimulation(mesh, MATERIAL, x, SolverSettings(frame_rate=240, substeps=PHASE, drag=0.0))
        upper = np.where(mesh.layer[:, None] == 1, 1.0, 0.0)
        shaken = 0.05 * np.random.default_rng(seed).standard_normal(x.shape)
        sim.set_positions(x, upper * [0.3, 0.2, -0.8] + shaken)
        sim.advance(1)  # the sheets cross at first
        edges = sim._body.edge
        for _ in range(40):
            before = sim.positions
            sim.advance(1)
            found = {tuple(p) for p in sim._pairs.ee[: sim._state.counts[EE]].tolist()}
            bent = bent_edges(sim, before)
            for e, f in near_edges(mesh, edges, [before], ~sim.asleep):
                near += bent[e] and bent[f]
                missing += bent[e] and bent[f] and (min(e, f), max(e, f)) not in found
    assert near > 300 and missing <= 0.02 * near


@pytest.mark.parametrize(("phase", "pace"), [(4, 4), (4, 8), (7, 7), (7, 14)])
def test_contacts_are_not_used_beyond_the_horizon_of_their_pairs(phase, pace):
    """A cluster with one corner moves exactly as predicted. It is searched again at the last possible time."""
    x, h, speed = np.zeros((1, 4)), 0.001, np.array([1.0, 0.0, 0.0])
    base, course = np.zeros((3, 1), np.float32), speed[:, None].astype(np.float32)
    one, none = np.zeros(1, np.int32), np.zeros(1, bool)
    foreseen = PHASES_FORESEEN * phase
    for age in range(2 * foreseen):
        x[0, :3] = age * h * speed
        searched = call(_expire,
            age, pace, phase, h, 1, one, one, np.array([0, 1], np.int32), x, base, course,
            np.full(1, 1e-4, np.float32), one, ~none, none.copy()
        )  # fmt: skip
        assert searched == (age + pace > foreseen)


@pytest.mark.parametrize("substeps", [16, 20])
def test_growing_pair_lists_do_not_change_the_result(substeps, monkeypatch):
    """Two sheets pass through each other at first and then swing. Their lists grow at the beginning of a frame and
    within one."""
    mesh, x = two_sheets()
    x[:, 2] += 0.03
    large, small = (ClothSimulation(mesh, MATERIAL, x, SolverSettings(substeps=substeps)) for _ in range(2))
    small._pairs = new_pairs(60, 60)
    grown_at, run_frames = set(), kernel.run_frames

    def watched(body, parameters, state, *others):
        ended = run_frames(body, parameters, state, *others)
        if ended == kernel.PAIRS_FULL:
            grown_at.add(int(state.counts[SUBSTEP]))
        return ended

    monkeypatch.setattr(kernel, "run_frames", watched)
    for _ in range(40):
        large.advance(1)
        small.advance(1)
        assert small.positions.tobytes() == large.positions.tobytes()
        assert np.array_equal(small._state.quiet, large._state.quiet)
    assert 0 in grown_at and max(grown_at) > 0
