"""Crossings that no contact undoes, since every pair remembers the side on which it found itself."""

from dataclasses import replace

import numpy as np
import pytest

from skills.cloth.crossings import count_crossings, find_crossings
from skills.cloth.mesh import ClothMesh, mesh_from_contour
from skills.cloth.solver import ClothSimulation, SolverSettings
from skills.cloth.untangle import GLANCE, PATIENCE, crosses, shorten
from skills.vocabulary import Material

MATERIAL = Material(
    areal_mass=0.3, stretch_fraction=0.012, bending_length=0.016, thickness=0.002, friction_static=0.6,
    friction_dynamic=0.55, friction_layers=0.5,
)  # fmt: skip
SQUARE = np.array([[-0.15, -0.15], [0.15, -0.15], [0.15, 0.15], [-0.15, 0.15]])


def two_sheets(turned=0.3):
    """One upon the other on the table, their meshes turned against each other."""
    one = mesh_from_contour(SQUARE, 0.025)
    c, s = np.cos(turned), np.sin(turned)
    upper = one.rest @ np.array([[c, s], [-s, c]])
    n = len(one.rest)
    mesh = ClothMesh(
        np.vstack([one.rest, upper]), np.repeat([0, 1], n).astype(np.int32),
        np.vstack([one.triangles, one.triangles + n]).astype(np.int32),
        np.repeat([0, 1], len(one.triangles)).astype(np.int32), np.zeros((0, 2), np.int32),
    )  # fmt: skip
    x = mesh.lay_flat(MATERIAL.thickness)
    x[:, 2] += 0.01
    return mesh, x, n


def poked(reach):
    """The upper sheet goes through the lower one within `reach` [m] of the middle."""
    mesh, x, n = two_sheets()
    inside = np.linalg.norm(mesh.rest, axis=1) < reach
    inside[:n] = False
    x[inside, 2] -= 2.0 * MATERIAL.thickness
    return mesh, x, n


@pytest.mark.parametrize("reach", [0.02, 0.05])
def test_a_bulge_that_was_pushed_through_a_sheet_goes_back(reach):
    """The upper sheet ends where it would have without: nothing is torn, nothing hangs on the memory of sides."""
    mesh, x, _ = poked(reach)
    assert count_crossings(x, mesh.triangles) >= 5
    s = ClothSimulation(mesh, MATERIAL, x)
    s.advance(120)
    assert count_crossings(s.positions, mesh.triangles) == 0
    undisturbed = ClothSimulation(mesh, MATERIAL, two_sheets()[1])
    undisturbed.advance(120)
    assert np.linalg.norm(s.positions - undisturbed.positions, axis=1).max() < 0.002


def test_undoing_a_crossing_makes_no_momentum_and_little_speed():
    mesh, x, _ = poked(0.05)
    s = ClothSimulation(
        mesh, MATERIAL, x, SolverSettings(gravity=(0.0, 0.0, 0.0), drag=0.0, sleep_frames=0), table=False
    )
    mass = 1.0 / s.inverse_mass[:, None]
    middle = (mass * x).sum(axis=0) / mass.sum()
    fastest = 0.0
    for _ in range(60):
        s.advance(1)
        fastest = max(fastest, float(np.linalg.norm(s.velocities, axis=1).max()))
    assert count_crossings(s.positions, mesh.triangles) == 0
    assert np.linalg.norm((mass * s.velocities).sum(axis=0)) / mass.sum() < 1e-9
    assert np.linalg.norm((mass * s.positions).sum(axis=0) / mass.sum() - middle) < 1e-9
    assert fastest < 0.6


def test_what_does_not_cross_is_left_alone():
    """Layers that lie on each other: no side is changed, nothing is found."""
    mesh, x, _ = two_sheets()
    s = ClothSimulation(mesh, MATERIAL, x)
    s.advance(60)
    assert int(s.checkpoint()["tangles.found"][0]) == 0
    assert not s.checkpoint()["tangles.age"].any()


def test_a_crossing_is_found_and_its_age_goes_through_a_checkpoint():
    mesh, x, _ = poked(0.02)
    a, b = ClothSimulation(mesh, MATERIAL, x), ClothSimulation(mesh, MATERIAL, x)
    a.advance(GLANCE + PATIENCE - 1)
    saved = a.checkpoint()
    edge = a._body.edge
    listed = saved["tangles.cross"][: int(saved["tangles.found"][0])].tolist()
    found = {(*sorted(edge[e].tolist()), t) for e, t in listed}
    assert found == {(*sorted((i, j)), t) for i, j, t in find_crossings(a.positions, mesh.triangles).tolist()}
    b.restore(saved)
    a.advance(10)
    b.advance(10)
    assert a.positions.tobytes() == b.positions.tobytes()


def test_an_edge_crosses_a_triangle_where_a_line_solver_says_so():
    rng = np.random.default_rng(0)
    hits = 0
    for _ in range(500):
        x = rng.normal(size=(5, 3))
        u, v, d = x[3] - x[2], x[4] - x[2], x[1] - x[0]
        a, b, along = np.linalg.solve(np.column_stack([u, v, -d]), x[0] - x[2])
        expected = a >= 0.0 and b >= 0.0 and a + b <= 1.0 and 0.0 <= along <= 1.0
        assert crosses(x, 0, 1, 2, 3, 4) == expected
        hits += expected
    assert hits > 20


def test_the_way_of_an_edge_is_the_gradient_of_the_contour():
    """A tent's edges through a plane: the contour is as long as finite differences say, and goes with the way."""
    rng = np.random.default_rng(2)
    plane = np.array([[-9.0, -9.0, 0.0], [9.0, -9.0, 0.0], [0.0, 18.0, 0.0]])
    angle = np.linspace(0.0, 2.0 * np.pi, 6, endpoint=False) + rng.uniform(-0.2, 0.2, 6)
    rim = np.column_stack([np.cos(angle), np.sin(angle), 0.6 + rng.uniform(-0.1, 0.1, 6)])
    x = np.vstack([plane, rim, [[0.05, -0.03, -0.5]]])
    tip = 9
    tri = np.array([[0, 1, 2], *([3 + k, 3 + (k + 1) % 6, tip] for k in range(6))], np.int32)

    def contour(shift):
        """Length of the polygon in which the tent meets the plane."""
        y = x[3:] + shift
        s = -y[6, 2] / (y[:6, 2] - y[6, 2])
        points = y[6] + s[:, None] * (y[:6] - y[6])
        return np.linalg.norm(points - np.roll(points, 1, axis=0), axis=1).sum()

    total = np.zeros(3)
    for k in range(6):
        way = np.zeros(3)
        beside = np.array([1 + k, 1 + (k - 1) % 6], np.int32)
        shorten(x, np.array([3 + k, tip], np.int32), beside, tri, 0, way)
        assert way[2] > 0.0  # the tip goes back up
        total += way
    eps = 1e-6
    slope = np.array([(contour(eps * e) - contour(-eps * e)) / (2 * eps) for e in np.eye(3)])
    assert slope @ total < 0.0
    assert np.dot(slope, total) / np.linalg.norm(slope) / np.linalg.norm(total) < -0.95


@pytest.mark.parametrize("edge_mm", [4.0, 7.5])
def test_a_fine_sheet_keeps_its_shape(edge_mm):
    """Damped bending of quadratic hinges drives the edges of a fine mesh apart unless it is bounded: a disturbance
    of a thousandth of an edge grew to an edge within five frames."""
    edge = 1e-3 * edge_mm
    mesh = mesh_from_contour(SQUARE * (12.0 * edge / 0.15), edge)
    fine = replace(MATERIAL, stretch_fraction=0.03, bending_length=0.02, thickness=0.4 * edge)
    still = SolverSettings(gravity=(0.0, 0.0, 0.0), drag=0.0, sleep_frames=0, bend_damping=0.03)
    s = ClothSimulation(mesh, fine, settings=still, table=False)
    s.set_positions(s.positions + 1e-3 * edge * np.random.default_rng(0).normal(size=(len(mesh.rest), 3)))
    s.advance(15)
    now = np.linalg.norm(np.diff(s.positions[mesh.edges], axis=1)[:, 0], axis=1)
    assert np.abs(now / mesh.edge_length - 1.0).max() < 1e-3
