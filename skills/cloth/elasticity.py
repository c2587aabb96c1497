# mypy: allow-untyped-defs, allow-incomplete-defs
"""Stretch over edges and quadratic bending over hinges, as compliant constraints (XPBD).

Stretch: an edge of rest length l beside triangles of area A is a spring of stiffness Y A / l^2, where Y is the
Young modulus of the membrane [N/m]. On equilateral triangles this is exactly the isotropic membrane with Poisson
ratio 1/3 (Seung & Nelson 1988); on other meshes each edge gets a factor for its direction.

Bending: hinges with the stencil K of Bergou et al. 2006. Each hinge is a separate constraint with the energy 1/2 *
B / (A0 + A1) * |K x|^2, where B is the flexural rigidity [Nm] and K is computed from cotangents. K x is linear in
x, so a hinge is three independent linear constraints. If cloth is bent to a cylinder, the integral of its squared
curvature equals the sum of |K x|^2 / (A0 + A1) over all hinges, without any factor. The paper's factor of 3 is for
elements whose edges are assembled into one operator.

A hinge that is bent by the angle a has |K x| = 2 l sin(a / 2), where l is the length of its edge. The quadratic
energy therefore grows slower than a^2, and a crease along a row of edges longer than half a bending length
collapses. Here the stiffness is divided by cos^2(a / 2): -4 l^2 ln cos^2(a / 2) takes the place of |K x|^2.
With this energy, the free fold of a chain of hinges has the height of the elastica within 6 % for any spacing of
the hinges up to one bending length (benchmarks/cloth/free_fold.py).

With one sweep of XPBD per substep, a constraint gets an additional compliance of about h^2 sum(w |grad C|^2). For
edges it is subtracted from the requested compliance beforehand, so that a material behaves in the same way on any
mesh and with any substep.

Bending friction: a spring in series with a slider, parallel to each hinge (a Jenkins element; Miguel et al. 2013
use Dahl's model instead). The moment per width is B kappa + friction with |friction| <= HB, as the KES-F bending
test plots it. Released cloth therefore keeps a curvature of up to HB / B.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from foldcell.robots.ports import Array
from foldcell.skills.cloth.inner import inner
from foldcell.skills.cloth.mesh import ClothMesh
from foldcell.skills.cloth.simd.f64x4 import FOUR, dots, ends, gather_f64x4, load_f64x4, splat_f64x4, where_above
from foldcell.skills.cloth.simd.vec3 import dot, load, spread, store, vector
from foldcell.skills.vocabulary import REFERENCE_DROP, Material

GRAVITY = 9.81  # [m/s2]
SWEEP = 0.5  # compliance that one sweep adds, in units of h^2 sum(w |grad C|^2), measured by the hang test
FLOOR = 0.02  # lower bound of the corrected compliance, in the same unit
# Stiffness ratio of the slider's spring to the hinge. The slider slips if the spring's curvature exceeds
# 1 / STIFFER of the residual curvature.
STIFFER = 4.0
TOGETHER = 4.0  # factor on sum(w grad^2), since all twelve hinges of a vertex may slip together (stable if >= 3)
MOST_EVENED = (0.5, 2.0)  # limits of the factor by which an edge's stiffness is changed for its direction
SHARPEST = 0.7  # largest limit of sin^2(angle / 2) up to which hinges stiffen, here at 114 degrees
SHARE_LIMITS = (0.1, 4.0)  # limits of the factor on a hinge's rigidity
LOST = 1e-18  # [m2] squared length below which an edge has no direction
FLAT = 1e-12  # [m2] a smaller triangle has no normal


class Elastic(NamedTuple):
    """Constraints of one mesh and material in shuffled order; edges are solved in colour batches
    (`colour_batches`).

    edge: (e, 2) vertices; rim: (e,) True for edges of hems and seams; length: (e,) rest length [m]; compliance:
    (e,) [m/N], corrected for the sweep (see above); stiffness: (e,) [N/m]. hinge: (h, 4) vertices; hinge_length:
    (h,) rest length of its edge [m]; weight: (h, 4) the cotangent stencil K; bend: (h,) compliance (A0 + A1) / B
    [1/(N m)].
    """

    edge: NDArray[np.int32]
    rim: NDArray[np.bool_]
    length: Array
    compliance: Array
    stiffness: Array
    hinge: NDArray[np.int32]
    hinge_length: Array
    weight: Array
    bend: Array


class BendingFriction(NamedTuple):
    """Bending friction of the hinges, in the order of the hinges; all arrays are empty without friction. near: (h,
    4) the other hinges of both triangles of a hinge; the index h means that there is none. soft: (h,) compliance
    of the slider's spring against the turn, divided by the squared substep [1/(kg m2)]. share: (h,) factor that
    converts g^2 to the load of the spring, where g is the moment of the spring times the squared substep and the
    load is the squared curvature of the spring times area. limit: (h,) the slider slips if the sum of the loads of
    the hinge and its neighbours exceeds this limit."""

    near: NDArray[np.int32]
    soft: Array
    share: Array
    limit: Array


def membrane_modulus(material: Material) -> float:
    """Return the Young modulus of the membrane [N/m] with which a strip of length L = REFERENCE_DROP, hung by its
    end, elongates by the fraction s = `stretch_fraction` under its own weight: Y = areal_mass g L / (2 s)."""
    return material.areal_mass * GRAVITY * REFERENCE_DROP / (2.0 * material.stretch_fraction)


def flexural_rigidity(material: Material) -> float:
    """Return B = areal_mass g c^3 [N m], where c is the bending length (Peirce 1930, ASTM D1388)."""
    return material.areal_mass * GRAVITY * material.bending_length**3


def build_elastic(
    mesh: ClothMesh,
    material: Material,
    inverse_mass: Array,
    step: float,
    anisotropy: float = 1.0,
    bending_ratio: float = 1.0,
) -> Elastic:
    """Build the constraints for a substep of `step` [s]. anisotropy: stretch stiffness ratio of material y to
    material x; bending_ratio: rigidity along material y divided by the rigidity along x. The material's rigidity
    is their geometric mean."""
    edge, length = mesh.edges, mesh.edge_length
    stiffness = _stiffness(mesh, material, anisotropy)
    sweep = step**2 * inverse_mass[edge].sum(axis=1)
    compliance = np.maximum(1.0 / stiffness - SWEEP * sweep, FLOOR * sweep)
    weight, areas = _stencils(mesh)
    bend = areas / (flexural_rigidity(material) * bending_shares(mesh, bending_ratio))
    e, h = shuffled(len(edge)), shuffled(len(mesh.hinges))
    return Elastic(
        edge[e].copy(), mesh.on_rim[e], length[e].copy(), compliance[e], stiffness[e], mesh.hinges[h].copy(),
        mesh.hinge_length[h], weight[h], bend[h]
    )  # fmt: skip


def build_bending_friction(
    mesh: ClothMesh,
    material: Material,
    step: float,
    residual_curvature: float,
    bending_ratio: float = 1.0,
    measured: bool = False,
) -> BendingFriction:
    """Build the bending friction for a substep of `step` [s]. Released cloth keeps a curvature of up to
    `residual_curvature` [1/m], which is HB / B, in all directions. bending_ratio: as in `build_elastic`. measured:
    build it even without friction, because the set of creases (crease_set.py) needs the measured turns."""
    if residual_curvature == 0.0 and not measured:
        return BendingFriction(np.zeros((0, 4), np.int32), np.zeros(0), np.zeros(0), np.zeros(0))
    order = shuffled(len(mesh.hinges))
    a, b = mesh.hinges[order, 0], mesh.hinges[order, 1]
    length2 = ((mesh.rest[b] - mesh.rest[a]) ** 2).sum(axis=1)
    _, areas = _stencils(mesh)
    areas = areas[order]
    rigidity = flexural_rigidity(material) * bending_shares(mesh, bending_ratio)[order]
    soft = areas / (STIFFER * rigidity * length2 * step**2)
    return BendingFriction(
        _hinges_near(mesh.hinge_triangles[order], len(mesh.triangles)), soft, soft**2 * length2 / areas,
        (residual_curvature / STIFFER) ** 2 * areas,
    )  # fmt: skip


def hinge_extents(mesh: ClothMesh) -> tuple[Array, Array]:
    """Return (h,) lengths of the edges, and (h,) widths of the cloth that each hinge bends, which are (A0 + A1) /
    length [m]; in the order of the hinges."""
    order = shuffled(len(mesh.hinges))
    length = mesh.hinge_length[order]
    return length, _stencils(mesh)[1][order] / length


def _hinges_near(triangles: NDArray[np.int32], count: int) -> NDArray[np.int32]:
    """Return (h, 4): the other hinges of both triangles of each hinge; the index h means that there is none.
    triangles: (h, 2) the triangles of each hinge."""
    h = len(triangles)
    order = np.argsort(triangles.ravel(), kind="stable")
    owner = triangles.ravel()[order]
    place = np.arange(2 * h) - np.searchsorted(owner, owner)
    of = np.full((count, 3), h, np.int32)
    of[owner, place] = order // 2
    six = of[triangles].reshape(h, 6)
    return six[six != np.arange(h)[:, None]].reshape(h, 4)


def turns(hinge: NDArray[np.int32], x: Array) -> Array:
    """Return (h,) 2 sin(angle / 2) of each hinge, signed as in `measure_turns`."""
    a, b, c, d = (x[hinge[:, k]] for k in range(4))
    p, q = np.cross(b - a, c - a), np.cross(d - a, b - a)
    cos = (p * q).sum(axis=1) / np.maximum(np.linalg.norm(p, axis=1) * np.linalg.norm(q, axis=1), FLAT**2)
    size = np.sqrt(np.maximum(2.0 - 2.0 * cos, 0.0))
    return np.copysign(size, (p * (d - a)).sum(axis=1))


def stretch_excess(mesh: ClothMesh, material: Material, step: float, anisotropy: float) -> float:
    """Estimate how much more the simulated cloth stretches than the material when it hangs, as a fraction of its
    length, for a substep of `step` [s]. It stretches more because an edge cannot be stiffer than one sweep allows.
    The estimate agrees with the hang test within a third."""
    stiffness = _stiffness(mesh, material, anisotropy)
    inverse_mass = 1.0 / (material.areal_mass * mesh.vertex_area)
    sweep = step**2 * inverse_mass[mesh.edges].sum(axis=1)
    return material.stretch_fraction * float(np.maximum((SWEEP + FLOOR) * sweep * stiffness - 1.0, 0.0).mean())


def _stiffness(mesh: ClothMesh, material: Material, anisotropy: float) -> Array:
    """Return (e,): stretch stiffness of the edges [N/m], in the order of the mesh."""
    edge, length = mesh.edges, mesh.edge_length
    along = (mesh.rest[edge[:, 1]] - mesh.rest[edge[:, 0]]) / length[:, None]
    directional = np.sqrt(anisotropy) ** (along[:, 1] ** 2 - along[:, 0] ** 2)
    even = _evened_out(along, mesh.edge_area, mesh.area.sum())
    return membrane_modulus(material) * even * mesh.edge_area / length**2 * directional


def _evened_out(along: Array, edge_area: Array, area: float) -> Array:
    """Return (e,) factors that make the edges equally stiff in all directions, and in sum as stiff as the membrane
    of the `area` [m2]. This holds in the mean over a uniformly strained mesh. along: (e, 2) directions of the
    edges; edge_area: (e,) total area of the triangles beside each edge [m2].

    No triangulation has equally many edges in all directions; coarse meshes are up to a tenth stiffer in one
    direction than in another. Springs are isotropic when the second and fourth harmonics of their stiffness over
    direction vanish. (These four harmonics and the sum are the five components of the stiffness tensor, whose
    Cauchy symmetry gives the Poisson ratio of 1/3.) A factor composed of the five harmonics fulfils all five
    conditions. On a mesh with edges in only three directions, it fulfils the condition on the sum alone.
    """
    angle = np.arctan2(along[:, 1], along[:, 0])
    harmonics = _harmonics(angle)
    moments = harmonics.T @ (edge_area[:, None] * harmonics)
    lack = np.array([3.0 * area, 0.0, 0.0, 0.0, 0.0]) - harmonics.T @ edge_area
    factor = np.clip(1.0 + harmonics @ np.linalg.lstsq(moments, lack, rcond=1e-6)[0], *MOST_EVENED)
    return np.asarray(factor * 3.0 * area / (edge_area @ factor))


def _harmonics(angle: Array) -> Array:
    """Return (n, 5): 1 and the cosines and sines of 2 and 4 times the angles (n,)."""
    return np.column_stack([np.ones_like(angle), *(f(m * angle) for m in (2, 4) for f in (np.cos, np.sin))])


def bending_shares(mesh: ClothMesh, ratio: float = 1.0) -> Array:
    """Return (h,) factors on the rigidity of the hinges, in the order of the mesh, with which the rigidity along
    material y is `ratio` times that along x, with the geometric mean 1. ratio: 1/4 to 4.

    In cloth that is bent to a cylinder of curvature 1 along the direction d, a hinge has the energy
    (d' T d)^2 / (2 A) per rigidity, where T is the hinge's stencil applied to x x' / 2. As a function of the angle
    of d, this has the harmonics 0, 2 and 4. The factors give the sums of harmonics 0 and 2 over the mesh the
    values of B(d) = B_x cos^2 + B_y sin^2. On a hexagonal grid at angles of 15 or 45 degrees to the warp, the
    fourth harmonic then vanishes along warp and weft; at 0 or 30 degrees it is half as large as the second one,
    which only another element could mend. An isotropic mesh passes on two thirds of a second harmonic in the
    factors, so the factors start from 3/2 of it.
    """
    if ratio == 1.0:
        return np.ones(len(mesh.hinges))
    weight, areas = _stencils(mesh)
    at = mesh.rest[mesh.hinges] - mesh.rest[mesh.hinges[:, :1]]
    tensor = 0.5 * np.einsum("hk,hki,hkj->hij", weight, at, at)
    p, q, s = 0.5 * (tensor[:, 0, 0] + tensor[:, 1, 1]), 0.5 * (tensor[:, 0, 0] - tensor[:, 1, 1]), tensor[:, 0, 1]
    energy = np.column_stack([p * p + 0.5 * (q * q + s * s), 2 * p * q, 2 * p * s]) / areas[:, None]
    mean, swing = 0.5 * (ratio**0.5 + ratio**-0.5), 0.5 * (ratio**-0.5 - ratio**0.5)
    across = np.arctan2(*at[:, 1].T[::-1]) + 0.5 * np.pi  # direction in which a hinge curves
    share = mean + 1.5 * swing * np.cos(2.0 * across)
    harmonics = _harmonics(across)[:, :3]
    wanted = energy[:, 0].sum() * np.array([mean, swing, 0.0])
    lack = np.linalg.lstsq(energy.T @ harmonics, wanted - energy.T @ share, rcond=1e-6)[0]
    return np.clip(share + harmonics @ lack, *SHARE_LIMITS)


def bend_stiffening(elastic: Elastic, own: Array, step: float) -> Array:
    """Return (h,) the factor g / (4 l^2) of each hinge [1/m2], with which |K x|^2 gives g sin^2(a / 2) for a hinge
    bent by the angle a. own: (h,) sum of w K^2 including the bending damping.

    K x / (own + compliance / h^2 cos^2(a / 2)) equals K x / (own + compliance / h^2), divided by 1 - g sin^2(a /
    2), where g is the share of the compliance in the denominator."""
    soft = elastic.bend / step**2
    return soft / (own + soft) / (4.0 * elastic.hinge_length**2)


def shuffled(n: int) -> NDArray[np.int64]:
    """Return a fixed random order of n items. A sweep in the order of the mesh would pull the cloth in one
    direction."""
    return np.random.default_rng(7).permutation(n)


def colour_batches(edge: NDArray[np.int32]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Sort the edges (e, 2) into batches without a common vertex (a greedy graph colouring). Returns the order
    (e,), and the start of each batch followed by the end of the last one. The edges of a batch can be solved
    together. Edges with a common vertex keep their order, so a sweep gives the same result as solving the edges
    one by one."""
    colour, free = [], [0] * (int(edge.max(initial=-1)) + 1)  # free: first colour that is free at each vertex
    for i, j in edge.tolist():
        colour.append(max(free[i], free[j]))
        free[i] = free[j] = colour[-1] + 1
    return np.argsort(colour, kind="stable"), np.append(0, np.cumsum(np.bincount(colour)))


def _stencils(mesh: ClothMesh) -> tuple[Array, Array]:
    """Return K of Bergou et al. 2006, (h, 4), and A0 + A1 [m2], (h,), of every hinge."""
    x0, x1, x2, x3 = (mesh.rest[mesh.hinges[:, k]] for k in range(4))
    e0, e1, e2, e3, e4 = x1 - x0, x2 - x0, x3 - x0, x2 - x1, x3 - x1

    def cot(u: Array, v: Array) -> Array:
        return (u * v).sum(axis=1) / np.abs(u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0])

    c01, c02, c03, c04 = cot(e0, e1), cot(e0, e2), cot(-e0, e3), cot(-e0, e4)
    weight = np.column_stack([c03 + c04, c01 + c02, -c01 - c03, -c02 - c04])
    areas = 0.5 * (
        np.abs(e0[:, 0] * e1[:, 1] - e0[:, 1] * e1[:, 0]) + np.abs(e0[:, 0] * e2[:, 1] - e0[:, 1] * e2[:, 0])
    )
    return weight, areas


@inner(forceinline=True)
def _load_four(x, i):
    return load(x, i[0]), load(x, i[1]), load(x, i[2]), load(x, i[3])


@inner(forceinline=True)
def _apart(p, q):
    return q[0] - p[0], q[1] - p[1], q[2] - p[2], q[3] - p[3]


@inner(error_model="numpy", fastmath={"contract"}, forceinline=True)
def _store_four(x, i, p, share, d):
    """Store p + share * d in rows i of x, for four rows."""
    a, b, c, e = spread(share)
    store(x, i[0], p[0] + a * d[0])
    store(x, i[1], p[1] + b * d[1])
    store(x, i[2], p[2] + c * d[2])
    store(x, i[3], p[3] + e * d[3])


@inner(error_model="numpy", fastmath={"contract"})
def solve_edges(batch_start, edge, inverse_square, wi, wj, x):
    """Do one sweep over the packed edges (sleep.py): four edges of a batch (`colour_batches`) together, the
    remaining edges of the batch one by one. batch_start: the start of each batch, then the end of the last one;
    inverse_square: inverse squared rest lengths [1/m2]; wi, wj: share of each end, w / (w_i + w_j + compliance /
    h^2).

    The correction is 1 - 1 / sqrt(r), where r is the squared length over the squared rest length. It is replaced
    by its Pade approximant at r = 1, 2 (r - 1) / (3 r + 1). The relative error is 2e-4 at a strain of 3 % and 2e-3
    at 10 %. An exact square root would take as long as the rest of the sweep. The approximant also stays finite
    for an edge of zero length.
    """
    k, single, four, one, two = np.uint64(0), np.uint64(1), np.uint64(FOUR), splat_f64x4(1.0), splat_f64x4(2.0)
    for row in range(single, np.uint64(len(batch_start))):
        end = np.uint64(batch_start[row])
        while k + four <= end:
            i, j = ends(edge, k)
            p, q = _load_four(x, i), _load_four(x, j)
            d = _apart(p, q)
            r = load_f64x4(inverse_square, k) * dots(d, d)
            s = (2.0 * r - two) / (3.0 * r + one)
            _store_four(x, i, p, s * load_f64x4(wi, k), d)
            _store_four(x, j, q, -(s * load_f64x4(wj, k)), d)
            k += four
        while k < end:
            i, j = edge[k, 0], edge[k, 1]
            p, q = load(x, i), load(x, j)
            d = q - p
            r = inverse_square[k] * dot(d, d)
            s = (2.0 * r - 2.0) / (3.0 * r + 1.0)
            store(x, i, p + (s * wi[k]) * d)
            store(x, j, q - (s * wj[k]) * d)
            k += single


@inner(error_model="numpy", fastmath={"contract"})
def measure_bends(n, hinge, weight, stiffen, sharpest, x, ratio):
    """Compute the factor on the correction of each of the first n packed hinges, 1 / (1 - g sin^2(a / 2)) for a
    hinge bent by the angle a (`bend_stiffening`). It comes from the positions, not from the extrapolated positions
    of the damped sweep: in these, fast cloth would seem more bent than it is, and would be thrown about."""
    for k in range(n):
        pa, pb, pc, pd = load(x, hinge[k, 0]), load(x, hinge[k, 1]), load(x, hinge[k, 2]), load(x, hinge[k, 3])
        ka, kb, kc, kd = spread(load(weight, k))
        r = ka * pa + kb * pb + kc * pc + kd * pd
        ratio[k] = 1.0 / (1.0 - min(stiffen[k] * dot(r, r), sharpest))


@inner(error_model="numpy", fastmath={"contract"})
def solve_hinges(n, hinge, weight, part, ratio, x):
    """Do one sweep over the first n packed hinges. part: w K / (sum w K^2 + compliance / h^2) of each vertex;
    ratio: see `measure_bends`."""
    for k in range(n):
        a, b, c, d = hinge[k, 0], hinge[k, 1], hinge[k, 2], hinge[k, 3]
        # read all before writing: the four vertices differ
        pa, pb, pc, pd = load(x, a), load(x, b), load(x, c), load(x, d)
        ka, kb, kc, kd = spread(load(weight, k))
        sa, sb, sc, sd = spread(load(part, k))
        r = ratio[k] * (ka * pa + kb * pb + kc * pc + kd * pd)
        store(x, a, pa - sa * r)
        store(x, b, pb - sb * r)
        store(x, c, pc - sc * r)
        store(x, d, pd - sd * r)


@inner(error_model="numpy", fastmath={"contract"})
def measure_turns(n, which, hinge, soft, w, x, axis, foot, turn, inverse):
    """Measure the turn, 2 sin(angle / 2), of the hinges which[:n], and its gradient at their vertices.

    The turn times the length of the hinge's edge equals |K x| of the elastic hinge, but the turn has a sign, and
    its gradient neither shifts nor rotates the cloth. Vertices a and b are the ends of the edge, c and d the
    opposite vertices. axis[k]: the gradients at c and d, which are the normals of the triangles divided by their
    heights. foot[k]: the feet of these heights, as positions along a-b; they determine how the opposite of the
    gradients is divided between a and b. inverse: 1 / (TOGETHER sum w grad^2 + soft).
    """
    for k in range(n):
        e = which[k]
        a, b, c, d = hinge[k, 0], hinge[k, 1], hinge[k, 2], hinge[k, 3]
        ex, ey, ez = x[b, 0] - x[a, 0], x[b, 1] - x[a, 1], x[b, 2] - x[a, 2]
        ux, uy, uz = x[c, 0] - x[a, 0], x[c, 1] - x[a, 1], x[c, 2] - x[a, 2]
        vx, vy, vz = x[d, 0] - x[a, 0], x[d, 1] - x[a, 1], x[d, 2] - x[a, 2]
        # normals, as long as twice the area of their triangles; both point to the same side of flat cloth
        px, py, pz = ey * uz - ez * uy, ez * ux - ex * uz, ex * uy - ey * ux
        qx, qy, qz = vy * ez - vz * ey, vz * ex - vx * ez, vx * ey - vy * ex
        e2 = ex * ex + ey * ey + ez * ez
        p2, q2 = px * px + py * py + pz * pz, qx * qx + qy * qy + qz * qz
        if p2 < FLAT * FLAT or q2 < FLAT * FLAT:  # no normal: no friction in this phase
            axis[k, 0] = axis[k, 1] = axis[k, 2] = axis[k, 3] = axis[k, 4] = axis[k, 5] = 0.0
            foot[k, 0] = foot[k, 1] = inverse[k] = 0.0
            continue
        cos = (px * qx + py * qy + pz * qz) / np.sqrt(p2 * q2)
        turn[k] = np.copysign(np.sqrt(max(0.0, 2.0 - 2.0 * cos)), px * vx + py * vy + pz * vz)
        size = np.sqrt(max(0.0, 0.5 + 0.5 * cos) * e2)  # length of the edge times cos(angle / 2)
        fp, fq = size / p2, size / q2
        s, t = (ux * ex + uy * ey + uz * ez) / e2, (vx * ex + vy * ey + vz * ez) / e2
        foot[k, 0], foot[k, 1] = s, t
        axis[k, 0], axis[k, 1], axis[k, 2] = fp * px, fp * py, fp * pz
        axis[k, 3], axis[k, 4], axis[k, 5] = fq * qx, fq * qy, fq * qz
        moved = w[c] * fp * fp * p2 + w[d] * fq * fq * q2
        for m in range(3):
            at_b = s * axis[k, m] + t * axis[k, 3 + m]
            at_a = axis[k, m] + axis[k, 3 + m] - at_b
            moved += w[a] * at_a * at_a + w[b] * at_b * at_b
        inverse[k] = 1.0 / (TOGETHER * moved + soft[e])


@inner(error_model="numpy", fastmath={"contract"})
def bending_friction_moments(
    n, which, hinge, near, share, limit, axis, foot, turn, inverse, slip, held, x, moment
):
    """Compute the friction moments, times h^2, of the hinges which[:n] into moment (n,). They are based on the
    last measurement (`measure_turns`).

    A spring pulls the turn of each hinge e towards slip[e]. The slider slips (slip[e] changes) if the loads of the
    springs in both triangles of the hinge, in sum, exceed limit[e]. If the limit applied to the load of each hinge
    alone, friction would be two thirds larger in one direction of the mesh than in another. held: (h + 1,) the
    latest load of each spring. This function only computes the moments, all from the same x;
    `solve_hinges_with_friction` applies them.
    """
    for k in range(n):
        e = which[k]
        a, b, c, d = hinge[k, 0], hinge[k, 1], hinge[k, 2], hinge[k, 3]
        px, py, pz, qx, qy, qz = axis[k, 0], axis[k, 1], axis[k, 2], axis[k, 3], axis[k, 4], axis[k, 5]
        s, t = foot[k, 0], foot[k, 1]
        bx, by, bz = s * px + t * qx, s * py + t * qy, s * pz + t * qz
        # If nothing has moved since the last measurement, this equals turn[k], because the heights of c and d are
        # perpendicular to the normals
        now = (
            turn[k]
            + px * (x[c, 0] - x[a, 0]) + py * (x[c, 1] - x[a, 1]) + pz * (x[c, 2] - x[a, 2])
            + qx * (x[d, 0] - x[a, 0]) + qy * (x[d, 1] - x[a, 1]) + qz * (x[d, 2] - x[a, 2])
            - bx * (x[b, 0] - x[a, 0]) - by * (x[b, 1] - x[a, 1]) - bz * (x[b, 2] - x[a, 2])
        )  # fmt: skip
        g = (slip[e] - now) * inverse[k]
        held[e] = share[e] * g * g
        around = held[e] + 0.5 * (held[near[e, 0]] + held[near[e, 1]] + held[near[e, 2]] + held[near[e, 3]])
        if around > limit[e]:
            keep = np.sqrt(limit[e] / around)
            g *= keep
            slip[e] = now + keep * (slip[e] - now)
        moment[k] = g


@inner(error_model="numpy", fastmath={"contract"})
def solve_hinges_with_friction(n, hinge, weight, part, ratio, axis, foot, moment, grow, w, target, x):
    """Do the sweep of `solve_hinges` with friction and set. Each hinge is first bent by `grow` times its friction
    moment and then solved. Friction and elasticity thus balance where cloth stays bent. In two separate sweeps,
    friction would react to the displacements that elasticity causes and vice versa, and the bending damping would
    treat these displacements as motion. target: (n, 3) K x of each hinge at rest (crease_set.py), or empty."""
    creased = len(target) > 0
    for k in range(n):
        a, b, c, d = hinge[k, 0], hinge[k, 1], hinge[k, 2], hinge[k, 3]
        ka, kb, kc, kd = weight[k, 0], weight[k, 1], weight[k, 2], weight[k, 3]
        g, s, t = grow * moment[k], foot[k, 0], foot[k, 1]
        p, q = g * vector(axis[k, 0], axis[k, 1], axis[k, 2]), g * vector(axis[k, 3], axis[k, 4], axis[k, 5])
        at_b = s * p + t * q
        xa, xb = load(x, a) - w[a] * (p + q - at_b), load(x, b) - w[b] * at_b
        xc, xd = load(x, c) + w[c] * p, load(x, d) + w[d] * q
        r = ka * xa + kb * xb + kc * xc + kd * xd
        if creased:
            r = r - vector(target[k, 0], target[k, 1], target[k, 2])
        r = ratio[k] * r
        store(x, a, xa - part[k, 0] * r)
        store(x, b, xb - part[k, 1] * r)
        store(x, c, xc - part[k, 2] * r)
        store(x, d, xd - part[k, 3] * r)


@inner(error_model="numpy", fastmath={"contract"})
def damp_edges(batch_start, edge, rate, w, x, v):
    """Reduce the speed at which the ends of each edge separate or approach by the share `rate`; momentum is
    conserved. Four edges are processed together, as in `solve_edges`."""
    k, single, four, nothing = np.uint64(0), np.uint64(1), np.uint64(FOUR), splat_f64x4(0.0)
    for row in range(single, np.uint64(len(batch_start))):
        end = np.uint64(batch_start[row])
        while k + four <= end:
            i, j = ends(edge, k)
            d = _apart(_load_four(x, i), _load_four(x, j))
            p, q, wi, wj = _load_four(v, i), _load_four(v, j), gather_f64x4(w, i), gather_f64x4(w, j)
            total, d2 = wi + wj, dots(d, d)
            s = load_f64x4(rate, k) * dots(_apart(p, q), d) / (d2 * total)
            # without a branch, which would be mispredicted too often
            s = where_above(total, nothing, where_above(splat_f64x4(LOST), d2, nothing, s), nothing)
            _store_four(v, i, p, s * wi, d)
            _store_four(v, j, q, -(s * wj), d)
            k += four
        while k < end:
            i, j = edge[k, 0], edge[k, 1]
            total = w[i] + w[j]
            d = load(x, j) - load(x, i)
            d2 = dot(d, d)
            if not d2 < LOST and total > 0.0:  # NaN passes and spreads, so that it is detected
                p, q = load(v, i), load(v, j)
                s = rate[k] * dot(q - p, d) / (d2 * total)
                store(v, i, p + (s * w[i]) * d)
                store(v, j, q - (s * w[j]) * d)
            k += single
