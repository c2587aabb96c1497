"""Material and friction against lab tests: cantilever, layers on a tilted table, and stretch."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_bvp
from scipy.optimize import brentq
from scipy.sparse import coo_array, diags_array
from scipy.sparse.linalg import spsolve

from benchmarks.cloth.scenes import stacked
from foldcell.robots.errors import ConfigurationError, InternalError
from foldcell.skills.cloth import kernel
from foldcell.skills.cloth.elasticity import (
    GRAVITY,
    build_elastic,
    flexural_rigidity,
    membrane_modulus,
    stretch_excess,
)
from foldcell.skills.cloth.mesh import ClothMesh, mesh_from_contour
from foldcell.skills.cloth.settings import SolverSettings
from foldcell.skills.cloth.solver import MOST_PAIRS, ClothSimulation
from foldcell.skills.vocabulary import Material

MATERIAL = Material(
    areal_mass=0.4, stretch_fraction=0.02, bending_length=0.02, thickness=0.003, friction_static=0.6,
    friction_dynamic=0.55, friction_layers=0.5,
)  # fmt: skip


def sag(bending_length, overhang):
    """Angle of the chord below the horizontal [rad] for a heavy elastica that is clamped level: c^3 theta'' = -(l
    - s) cos(theta)."""
    s = np.linspace(0.0, overhang, 60)

    def rate(s, y):
        return np.vstack([y[1], -(overhang - s) * np.cos(y[0]) / bending_length**3])

    # continued from the solution for small loads
    guess = np.vstack([np.full(60, 0.3), np.zeros(60)])
    found = solve_bvp(rate, lambda a, b: np.array([a[0], b[1]]), s, guess)
    assert found.success
    theta = found.sol(np.linspace(0.0, overhang, 400))[0]
    return float(np.arctan2(np.sin(theta).sum(), np.cos(theta).sum()))


def strip(overhang, edge, width=0.12):
    """A strip and its mirror image about x = 0, so that a row of vertices is at the clamp's end."""
    half = mesh_from_contour(np.array([[0, 0], [overhang, 0], [overhang, width], [0, width]]), edge)
    free = half.rest[:, 0] > 1e-9
    mirror = np.where(free, len(half.rest) + np.cumsum(free) - 1, np.arange(len(half.rest))).astype(np.int32)
    rest = np.vstack([half.rest, half.rest[free] * [-1.0, 1.0]])
    tri = np.vstack([half.triangles, mirror[half.triangles][:, ::-1]]).astype(np.int32)
    zero = np.zeros(len(rest), np.int32)
    return ClothMesh(rest, zero, tri, np.zeros(len(tri), np.int32), np.zeros((0, 2), np.int32))


CANTILEVERS = [(0.015, 0.03), (0.0195, 0.03), (0.022, 0.045), (0.03, 0.06), (0.0125, 0.019)]


@pytest.mark.parametrize(("edge", "bending_length"), CANTILEVERS)
def test_a_cantilever_has_the_given_bending_length(edge, bending_length):
    """Peirce's test: the overhang whose chord falls by about 41.5 degrees is twice the bending length."""
    overhang = 2.0 * bending_length
    mesh = strip(overhang, edge)
    x = np.column_stack([mesh.rest, np.zeros(len(mesh.rest))])
    s = ClothSimulation(
        mesh, replace(MATERIAL, bending_length=bending_length), x, SolverSettings(drag=4.0, sleep_frames=0),
        table=False, fixed=mesh.rest[:, 0] < 1e-9,
    )  # fmt: skip
    s.advance(150)
    tip = s.positions[mesh.rest[:, 0] > overhang - 1e-9].mean(axis=0)
    # the hinges on the clamp's line bend over both triangles, so the free length starts half a height behind the
    # clamp
    behind = np.sqrt(3.0) / 4.0 * edge
    angle = np.arctan2(-tip[2], tip[0] + behind)
    measured = brentq(
        lambda c: sag(c, overhang + behind) - angle, 0.7 * bending_length, 1.4 * bending_length, xtol=1e-5
    )
    assert measured == pytest.approx(bending_length, rel=0.05)


@pytest.mark.parametrize("direction", [0.0, 0.5, np.pi / 2])
def test_the_hinges_store_the_bending_energy_of_a_cylinder(direction):
    """The energy is 1/2 B kappa^2 per unit area, for any direction of the cylinder on the mesh."""
    mesh = mesh_from_contour(np.array([[-0.3, -0.2], [0.3, -0.2], [0.3, 0.2], [-0.3, 0.2]]), 0.02)
    e = build_elastic(mesh, MATERIAL, np.ones(len(mesh.rest)), 1e-3)
    z = 0.5 * (mesh.rest @ [np.cos(direction), np.sin(direction)]) ** 2  # curvature 1
    bent = 0.5 * (e.weight * z[e.hinge]).sum(axis=1) ** 2 / e.bend
    inner = (np.abs(mesh.rest[e.hinge[:, :2]].mean(axis=1)) < [0.25, 0.15]).all(axis=1)
    assert bent[inner].sum() == pytest.approx(0.5 * flexural_rigidity(MATERIAL) * 0.5 * 0.3, rel=0.02)


OUTLINES = {
    "towel": [[-0.3, -0.2], [0.3, -0.2], [0.3, 0.2], [-0.3, 0.2]],
    "strip": [[0.0, 0.0], [0.15, 0.0], [0.15, 0.6], [0.0, 0.6]],
    "bent": [[0.0, 0.0], [0.4, 0.0], [0.4, 0.15], [0.15, 0.2], [0.1, 0.5], [0.0, 0.4]],
}


@pytest.mark.parametrize("outline", OUTLINES)
@pytest.mark.parametrize(("edge", "layers", "rotate"), [(0.015, 1, 0.0), (0.022, 2, 0.0), (0.026, 1, 0.7)])
def test_the_edges_store_the_energy_of_an_isotropic_membrane(outline, edge, layers, rotate):
    """The energy is that of plane stress with a Poisson ratio of 1/3, for any direction of strain, on an irregular
    mesh."""
    mesh = mesh_from_contour(np.array(OUTLINES[outline]), edge, layers, rotate=rotate)
    e = build_elastic(mesh, MATERIAL, np.ones(len(mesh.rest)), 1e-3)
    along = (mesh.rest[e.edge[:, 1]] - mesh.rest[e.edge[:, 0]]) / e.length[:, None]
    modulus, poisson = membrane_modulus(MATERIAL), 1.0 / 3.0
    for a, b, g in np.vstack([np.eye(3), np.random.default_rng(3).normal(size=(5, 3))]):
        strain = np.array([[a, 0.5 * g], [0.5 * g, b]])
        held = 0.5 * (e.stiffness * (e.length * (along @ strain * along).sum(axis=1)) ** 2).sum()
        energy = a * a + b * b + 2.0 * poisson * a * b + 0.5 * (1.0 - poisson) * g * g
        assert held == pytest.approx(0.5 * modulus / (1.0 - poisson**2) * energy * mesh.area.sum(), rel=0.01)


@pytest.mark.parametrize("count", [1, 4])
def test_edges_in_only_three_directions_have_the_mean_stiffness_of_the_membrane(count):
    """The mesh is one right triangle, or squares that are all cut along the same diagonal. No factors make these
    isotropic."""
    side = np.arange(count + 1)
    rest = 0.02 * np.array([(i, j) for j in side for i in side], dtype=float)
    corner = np.array([i + j * (count + 1) for j in range(count) for i in range(count)])[:, None]
    lower, upper = np.add(corner, [0, 1, count + 2]), np.add(corner, [0, count + 2, count + 1])
    triangles = (lower if count == 1 else np.vstack([lower, upper])).astype(np.int32)
    zero = np.zeros(len(triangles), np.int32)
    used = np.unique(triangles)
    mesh = ClothMesh(
        rest[used], np.zeros(len(used), np.int32), np.searchsorted(used, triangles).astype(np.int32), zero,
        np.zeros((0, 2), np.int32),
    )  # fmt: skip
    e = build_elastic(mesh, MATERIAL, np.ones(len(used)), 1e-3)
    swollen = 0.5 * (e.stiffness * e.length**2).sum()
    assert swollen == pytest.approx(1.5 * membrane_modulus(MATERIAL) * mesh.area.sum())
    assert e.stiffness.min() > 0.0


def hung_by_springs(mesh, material, top):
    """Displacement of each vertex (n,) [m] for small strains, from one linear system of the same springs."""
    e = build_elastic(mesh, material, np.ones(len(mesh.rest)), 1e-3)
    along = (mesh.rest[e.edge[:, 1]] - mesh.rest[e.edge[:, 0]]) / e.length[:, None]
    rows = np.repeat(np.arange(len(e.edge)), 4)
    columns = (2 * e.edge[:, :, None] + [0, 1]).reshape(-1)
    lengthen = coo_array((np.hstack([-along, along]).ravel(), (rows, columns))).tocsr()
    free = np.flatnonzero(~np.repeat(top, 2))
    stiffness = (lengthen.T @ diags_array(e.stiffness) @ lengthen).tocsr()[free][:, free]
    weight = np.zeros(2 * len(top))
    weight[1::2] = material.areal_mass * GRAVITY * mesh.vertex_area
    down = np.zeros(2 * len(top))
    down[free] = spsolve(stiffness.tocsc(), weight[free])
    return down[1::2]


@pytest.mark.parametrize("edge", [0.015, 0.020, 0.026])
def test_cloth_hung_by_a_clip_has_the_length_of_its_springs(edge):
    """The cloth hangs from a few edges with one held end. When the solver ignored the held end, these edges were
    too stiff, and garments on clips were 0.1 to 0.2 percentage points too short."""
    mesh = mesh_from_contour(np.array([[-0.08, 0.0], [0.08, 0.0], [0.02, 0.6], [-0.02, 0.6]]), edge)
    top, bottom = mesh.rest[:, 1] > 0.6 - 1e-9, mesh.rest[:, 1] < 1e-9
    material = replace(MATERIAL, stretch_fraction=0.01)
    x = np.column_stack([mesh.rest[:, 0], np.zeros(len(top)), mesh.rest[:, 1]])
    s = ClothSimulation(mesh, material, x, SolverSettings(drag=3.0, sleep_frames=0), table=False, fixed=top)
    s.advance(240)
    sunk = float((x - s.positions)[bottom, 2].mean())
    assert sunk / 0.6 == pytest.approx(hung_by_springs(mesh, material, top)[bottom].mean() / 0.6, abs=1.5e-4)


def sheet_on_a_sheet():
    lower = mesh_from_contour(np.array([[-0.2, -0.15], [0.5, -0.15], [0.5, 0.15], [-0.2, 0.15]]), 0.026)
    upper = mesh_from_contour(
        np.array([[-0.1, -0.07], [0.1, -0.07], [0.1, 0.07], [-0.1, 0.07]]), 0.026, rotate=0.3
    )
    return len(lower.rest), stacked([lower, upper])


@pytest.mark.parametrize("mu", [0.3, 0.6, 0.9])
def test_a_layer_slides_on_another_by_coulombs_law(mu):
    """The table holds the lower sheet. The upper sheet is observed after it has landed."""
    n, mesh = sheet_on_a_sheet()
    a = np.arctan(1.1 * mu)
    settings = SolverSettings(gravity=(GRAVITY * np.sin(a), 0.0, -GRAVITY * np.cos(a)), drag=0.0, sleep_frames=0)
    material = replace(MATERIAL, friction_static=5.0, friction_dynamic=5.0, friction_layers=mu)
    s = ClothSimulation(mesh, material, settings=settings)
    s.advance(12)
    x0, v0 = s.positions[n:, 0].mean(), s.velocities[n:, 0].mean()
    s.advance(24)
    t = 24 / 60
    expected = 0.5 * GRAVITY * (np.sin(a) - mu * np.cos(a)) * t * t
    assert s.positions[n:, 0].mean() - x0 - v0 * t == pytest.approx(expected, rel=0.02)


def pile(count):
    """Sheets that lie on each other, with meshes turned against each other."""
    square = np.array([[-0.1, -0.1], [0.1, -0.1], [0.1, 0.1], [-0.1, 0.1]])
    return stacked([mesh_from_contour(square, 0.026, rotate=0.3 * k) for k in range(count)])


def on_a_slope(count, mu, mu_layers, ratio, mu_dynamic=None):
    """The pile after 0.2 s on a table whose slope is `ratio` times the critical one. Sleeping is disabled."""
    mesh = pile(count)
    a = np.arctan(ratio * mu)
    settings = SolverSettings(gravity=(GRAVITY * np.sin(a), 0.0, -GRAVITY * np.cos(a)), drag=0.0, sleep_frames=0)
    dynamic = mu if mu_dynamic is None else mu_dynamic
    material = replace(MATERIAL, friction_static=mu, friction_dynamic=dynamic, friction_layers=mu_layers)
    x = np.column_stack([mesh.rest, material.thickness * (0.5 + mesh.layer)])
    s = ClothSimulation(mesh, material, x, settings)
    s.advance(12)
    weight = material.areal_mass * mesh.area.sum() * GRAVITY
    return s, mesh.layer, weight * np.sin(a), weight * np.cos(a)


def table_force(s: ClothSimulation) -> np.ndarray:
    """Force (3,) [N] of the cloth on the table in the last substep, from the momentum that the table absorbed."""
    w = s._body.w
    press = s._state.press[:, :3] / np.where(w > 0.0, w, np.inf)[:, None]
    return -press.sum(axis=0) / s._solver_parameters.h**2


@pytest.mark.parametrize("mu", [0.2, 0.6, 1.0])
@pytest.mark.parametrize("count", [2, 4])
def test_a_pile_on_the_table_holds_below_the_friction_angle(count, mu):
    s, _, along, down = on_a_slope(count, mu, mu, 0.98)
    before = s.positions
    s.advance(60)
    assert np.abs(s.positions - before)[:, 0].max() < 5e-5
    assert table_force(s) == pytest.approx([along, 0.0, -down], rel=0.01, abs=0.002 * down)


def test_two_layers_begin_to_slide_at_the_static_friction():
    """This holds for any lower dynamic friction. A contact that slips a little while loads settle does not
    continue to slide."""
    ways = []
    for ratio in (0.98, 1.02):
        s, _, _, _ = on_a_slope(2, 0.6, 0.6, ratio, mu_dynamic=0.4)
        before = s.positions
        s.advance(60)
        ways.append((s.positions - before)[:, 0])
    assert np.abs(ways[0]).max() < 5e-5
    assert ways[1].min() > 0.02


@pytest.mark.parametrize(("mu", "mu_layers"), [(0.2, 5.0), (0.6, 5.0), (0.6, 0.6), (1.0, 1.0)])
@pytest.mark.parametrize("ratio", [1.02, 1.1, 1.5])
@pytest.mark.parametrize("count", [2, 4])
def test_a_pile_slides_by_coulombs_law(count, mu, mu_layers, ratio):
    """The pile slides as one block if its layers hold. With equal friction everywhere, no layer slides on
    another."""
    s, sheet, along, down = on_a_slope(count, mu, mu_layers, ratio)
    x0, v0 = s.positions[:, 0], s.velocities[:, 0]
    s.advance(36)
    t = 36 / 60
    expected = 0.5 * (along - mu * down) / (down / GRAVITY) * np.cos(np.arctan(ratio * mu)) * t * t
    for k in range(count):
        own = sheet == k
        assert (s.positions[:, 0] - x0 - v0 * t)[own].mean() == pytest.approx(expected, rel=0.02)


def test_substeps_are_chosen_for_the_stretch():
    coarse = mesh_from_contour(np.array([[0, 0], [0.3, 0], [0.3, 0.3], [0, 0.3]]), 0.026)
    fine = mesh_from_contour(np.array([[0, 0], [0.3, 0], [0.3, 0.3], [0, 0.3]]), 0.015)

    def chosen(mesh, stretch, **kw):
        return ClothSimulation(mesh, replace(MATERIAL, stretch_fraction=stretch), settings=SolverSettings(**kw))

    def error(s):
        return stretch_excess(s.mesh, s.material, s.settings.frame / s.substeps, s.settings.anisotropy)

    soft, stiff = chosen(fine, 0.03), chosen(fine, 0.01)
    assert stiff.substeps > soft.substeps and chosen(coarse, 0.01).substeps < stiff.substeps
    assert max(error(soft), error(stiff)) < 5e-4
    rough = chosen(fine, 0.01, substeps=12)  # given substeps are used
    assert rough.substeps == 12 and error(rough) > 0.01
    with pytest.raises(ConfigurationError, match="64 substeps") as refused:
        chosen(fine, 0.0005)  # no reasonable number of substeps is enough
    assert refused.value.values["needed_substeps"] > 64


def test_cloth_too_stiff_for_its_substeps_is_an_error_or_stays_finite():
    """The bending length is a hundred times the usual one, on a fine mesh. The result is never a bare
    ZeroDivisionError and never a NaN."""
    mesh = mesh_from_contour(np.array([[-0.15, -0.1], [0.15, -0.1], [0.15, 0.1], [-0.15, 0.1]]), 0.010)
    x = mesh.lay_flat(0.003)
    x[:, 2] += 0.02 * np.sin(30.0 * x[:, 0]) ** 2
    s = ClothSimulation(mesh, replace(MATERIAL, bending_length=0.06, stretch_fraction=0.03), x)
    try:
        s.advance(60)
    except InternalError as error:
        assert error.values["substeps"] == s.substeps and error.values["bending_length"] == 0.06
    else:
        assert np.isfinite(s.positions).all()


def test_pair_lists_have_a_maximum_size(monkeypatch):
    """Cloth that crosses itself everywhere would need ever longer lists, so the simulation ends with an error."""
    s = ClothSimulation(mesh_from_contour(np.array([[0, 0], [0.1, 0], [0.1, 0.1], [0, 0.1]]), 0.02), MATERIAL)
    monkeypatch.setattr(kernel, "run_frames", lambda *_: kernel.PAIRS_FULL)
    with pytest.raises(InternalError, match="lost its positions"):
        s.advance(1)
    assert len(s._pairs.vt) <= 4 * MOST_PAIRS * len(s.positions)


@pytest.mark.parametrize("ratio", [1.0, 2.0, 3.4])
@pytest.mark.parametrize("grid", [np.deg2rad(4.0), np.deg2rad(34.0)])
def test_rigidity_along_warp_and_weft_has_the_given_ratio(ratio, grid):
    """The energy of a cylinder bent along warp or weft, summed over the hinges' own energies."""
    mesh = mesh_from_contour(np.array([[0, 0], [0.3, 0], [0.3, 0.3], [0, 0.3]]), 0.015, rotate=grid)
    elastic = build_elastic(
        mesh, MATERIAL, 1.0 / (MATERIAL.areal_mass * mesh.vertex_area), 1e-3, bending_ratio=ratio
    )

    def rigidity(direction):
        z = 0.5 * (mesh.rest @ direction) ** 2
        bent = (elastic.weight * z[elastic.hinge]).sum(axis=1)
        return (bent**2 / elastic.bend).sum() / mesh.area.sum()

    weft, warp = rigidity(np.array([1.0, 0.0])), rigidity(np.array([0.0, 1.0]))
    assert warp / weft == pytest.approx(ratio, rel=0.15)
    assert np.sqrt(warp * weft) == pytest.approx(flexural_rigidity(MATERIAL), rel=0.08)
