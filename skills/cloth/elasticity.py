# mypy: allow-untyped-defs, allow-incomplete-defs
"""Stretch over edges and quadratic bending over hinges, as compliant constraints (XPBD).

Stretch: an edge of rest length l beside triangles of area A is a spring of stiffness Y A / l^2, Y the membrane's
Young modulus [N/m]: on equilateral triangles the exact isotropic membrane with Poisson ratio 1/3 (Seung & Nelson
1988), on others with a factor for the edge's direction. Bending: quadratic hinges with the stencil K of Bergou et
al. 2006, each on its own: 1/2 * B / (A0 + A1) * |K x|^2, B the flexural rigidity [Nm], K from cotangents; it is
linear, so that a hinge is three independent linear constraints. Summed over hinges |K x|^2 / (A0 + A1) is the
squared curvature of a cylinder once; the factor 3 of the paper belongs to elements whose edges are assembled into
one operator.

One sweep of XPBD a substep adds a compliance of its own, about h^2 sum(w |grad C|^2) a constraint: it is
taken off the asked one beforehand, so that a material means the same on any mesh and with any substep.

Friction in bending: beside each hinge a spring with a slider in series (a Jenkins element; Miguel et al. 2013 put
Dahl's model there). The moment of a width is B kappa + friction, |friction| <= HB, as the KES-F bending test
draws it: cloth that is let go keeps a curvature of up to HB / B.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from robots.ports import Array
from skills.cloth.mesh import ClothMesh
from skills.cloth.simd.f64x4 import FOUR, dots, ends, gather_f64x4, load_f64x4, splat_f64x4, vdiv, where_above
from skills.cloth.simd.vec3 import dot, load, spread, store
from skills.vocabulary import Material

__all__ = [
    "GRAVITY",
    "BendingFriction",
    "Elastic",
    "build_bending_friction",
    "build_elastic",
    "colour_batches",
    "flexural_rigidity",
    "membrane_modulus",
    "shuffled",
    "stretch_excess",
    "turns",
]  # fmt: skip

GRAVITY = 9.81  # [m/s2]
SWEEP = 0.5  # compliance of one sweep, in units of h^2 sum(w |grad C|^2): measured by the hang test
FLOOR = 0.02  # of the same unit: no constraint is made stiffer
STIFFER = 4.0  # stiffness of a slider's spring over its hinge: it slips from 1 / STIFFER of the residual curvature
TOGETHER = 4.0  # factor of the compliance: a vertex has twelve hinges, which may all slip at once (stable from 3)
MOST_EVENED = (0.5, 2.0)  # limits of the factor by which an edge's stiffness is changed for its direction
LOST = 1e-18  # [m2] squared length below which an edge has no direction
FLAT = 1e-12  # [m2] a smaller triangle has no normal


class Elastic(NamedTuple):
    """Constraints of one mesh and material in shuffled order; edges are solved in colour batches of it
    (`colour_batches`).

    edge: (e, 2); rim: (e,) True for edges of hems and seams; length: (e,) [m]; compliance: (e,) [m/N], corrected
    for the sweep; stiffness: (e,) [N/m]. hinge: (h, 4); weight: (h, 4) the cotangent stencil K; bend: (h,)
    compliance (A0 + A1) / B [1/(N m)].
    """

    edge: NDArray[np.int32]
    rim: NDArray[np.bool_]
    length: Array
    compliance: Array
    stiffness: Array
    hinge: NDArray[np.int32]
    weight: Array
    bend: Array


class BendingFriction(NamedTuple):
    """Friction of the hinges, in their order; all arrays are empty without friction. near: (h, 4) the other hinges
    of both triangles, h where there is none. soft: (h,) compliance of the slider's spring against the turn, over
    h^2 [1/(kg m2)]; share: (h,) factor from the squared spring moment (times h^2) to squared spring curvature
    times area; limit: (h,) the largest sum of it over the hinge and its neighbours that the slider bears."""

    near: NDArray[np.int32]
    soft: Array
    share: Array
    limit: Array


def membrane_modulus(material: Material, reference_drop: float) -> float:
    """Young modulus of the membrane [N/m] with which a strip of length L = `reference_drop` [m], hung by its end,
    elongates by `stretch_fraction` s under its own weight: Y = areal_mass g L / (2 s)."""
    return material.areal_mass * GRAVITY * reference_drop / (2.0 * material.stretch_fraction)


def flexural_rigidity(material: Material) -> float:
    """B = areal_mass g c^3 [N m], c the bending length (Peirce 1930, ASTM D1388)."""
    return material.areal_mass * GRAVITY * material.bending_length**3


def build_elastic(
    mesh: ClothMesh,
    material: Material,
    inverse_mass: Array,
    step: float,
    reference_drop: float,
    anisotropy: float = 1.0,
    seam_factor: float = 1.0,
) -> Elastic:
    """Constraints for a substep of `step` [s]. anisotropy: stiffness along material y over that along x;
    seam_factor: stiffness of edges on the outline (hems, seams) over the cloth's."""
    edge, length = mesh.edges, mesh.edge_length
    stiffness = _stiffness(mesh, material, reference_drop, anisotropy, seam_factor)
    sweep = step**2 * inverse_mass[edge].sum(axis=1)
    compliance = np.maximum(1.0 / stiffness - SWEEP * sweep, FLOOR * sweep)
    weight, areas = _stencils(mesh)
    bend = areas / flexural_rigidity(material)
    e, h = shuffled(len(edge)), shuffled(len(mesh.hinges))
    return Elastic(
        edge[e].copy(), mesh.on_rim[e], length[e].copy(), compliance[e], stiffness[e], mesh.hinges[h].copy(),
        weight[h], bend[h]
    )  # fmt: skip


def build_bending_friction(
    mesh: ClothMesh, material: Material, step: float, residual_curvature: float
) -> BendingFriction:
    """Friction for a substep of `step` [s] with which released cloth keeps `residual_curvature` [1/m], HB / B."""
    if residual_curvature == 0.0:
        return BendingFriction(np.zeros((0, 4), np.int32), np.zeros(0), np.zeros(0), np.zeros(0))
    order = shuffled(len(mesh.hinges))
    a, b = mesh.hinges[order, 0], mesh.hinges[order, 1]
    length2 = ((mesh.rest[b] - mesh.rest[a]) ** 2).sum(axis=1)
    _, areas = _stencils(mesh)
    areas = areas[order]
    soft = areas / (STIFFER * flexural_rigidity(material) * length2 * step**2)
    return BendingFriction(
        _hinges_near(mesh.hinge_triangles[order], len(mesh.triangles)), soft, soft**2 * length2 / areas,
        (residual_curvature / STIFFER) ** 2 * areas,
    )  # fmt: skip


def _hinges_near(triangles: NDArray[np.int32], count: int) -> NDArray[np.int32]:
    """(h, 4) the other hinges of both triangles (h, 2) of each hinge, h where there is none."""
    h = len(triangles)
    order = np.argsort(triangles.ravel(), kind="stable")
    owner = triangles.ravel()[order]
    place = np.arange(2 * h) - np.searchsorted(owner, owner)
    of = np.full((count, 3), h, np.int32)
    of[owner, place] = order // 2
    six = of[triangles].reshape(h, 6)
    return six[six != np.arange(h)[:, None]].reshape(h, 4)


def turns(hinge: NDArray[np.int32], x: Array) -> Array:
    """(h,) 2 sin(angle / 2) of each hinge, signed as in `measure_turns`."""
    a, b, c, d = (x[hinge[:, k]] for k in range(4))
    p, q = np.cross(b - a, c - a), np.cross(d - a, b - a)
    cos = (p * q).sum(axis=1) / np.maximum(np.linalg.norm(p, axis=1) * np.linalg.norm(q, axis=1), FLAT**2)
    size = np.sqrt(np.maximum(2.0 - 2.0 * cos, 0.0))
    return np.copysign(size, (p * (d - a)).sum(axis=1))


def stretch_excess(
    mesh: ClothMesh,
    material: Material,
    step: float,
    reference_drop: float,
    anisotropy: float = 1.0,
    seam_factor: float = 1.0,
) -> float:
    """By how much the cloth would hang longer than asked, as a fraction of its length, with a substep
    of `step` [s]: edges stiffer than one sweep can be are as soft as the sweep. Agrees with the hang test
    within a third."""
    stiffness = _stiffness(mesh, material, reference_drop, anisotropy, seam_factor)
    inverse_mass = 1.0 / (material.areal_mass * mesh.vertex_area)
    sweep = step**2 * inverse_mass[mesh.edges].sum(axis=1)
    return material.stretch_fraction * float(np.maximum((SWEEP + FLOOR) * sweep * stiffness - 1.0, 0.0).mean())


def _stiffness(
    mesh: ClothMesh, material: Material, reference_drop: float, anisotropy: float, seam_factor: float
) -> Array:
    """(e,) [N/m] in the mesh's order."""
    edge, length = mesh.edges, mesh.edge_length
    along = (mesh.rest[edge[:, 1]] - mesh.rest[edge[:, 0]]) / length[:, None]
    directional = np.sqrt(anisotropy) ** (along[:, 1] ** 2 - along[:, 0] ** 2)
    outline = np.isin(edge[:, 0], mesh.border) & np.isin(edge[:, 1], mesh.border)
    modulus = membrane_modulus(material, reference_drop)
    even = _evened_out(along, mesh.edge_area, mesh.area.sum())
    return modulus * even * mesh.edge_area / length**2 * directional * np.where(outline, seam_factor, 1.0)


def _evened_out(along: Array, edge_area: Array, area: float) -> Array:
    """(e,) factors with which edges of directions `along` (e, 2), beside triangles of edge_area (e,) [m2] in all,
    are as stiff in each direction, and together as stiff as the membrane of that `area` [m2]: in the mean over the
    mesh, where all of it is strained alike.

    No triangulation has as many edges in each direction; coarse ones are up to a tenth stiffer one way than the
    other. Springs are isotropic when the second and fourth harmonics of their stiffness over direction vanish
    (they and the sum are the five parts of the tensor, whose Cauchy symmetry is the Poisson ratio of 1/3). A
    factor of these five harmonics fulfils that; of a mesh with edges in three directions only the sum."""
    angle = np.arctan2(along[:, 1], along[:, 0])
    harmonics = np.column_stack([np.ones_like(angle), *(f(m * angle) for m in (2, 4) for f in (np.cos, np.sin))])
    moments = harmonics.T @ (edge_area[:, None] * harmonics)
    lack = np.array([3.0 * area, 0.0, 0.0, 0.0, 0.0]) - harmonics.T @ edge_area
    factor = np.clip(1.0 + harmonics @ np.linalg.lstsq(moments, lack, rcond=1e-6)[0], *MOST_EVENED)
    return np.asarray(factor * 3.0 * area / (edge_area @ factor))


def shuffled(n: int) -> NDArray[np.int64]:
    """A fixed random order: a sweep along the order of the mesh would pull the cloth in one direction."""
    return np.random.default_rng(7).permutation(n)


def colour_batches(edge: NDArray[np.int32]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Sort the edges (e, 2) into batches without a common vertex (a greedy graph colouring). -> order (e,), and
    where each batch begins and the last one ends. The edges of a batch can be solved at once. Edges with a common
    vertex keep their order, so a sweep gives the same result as one edge after another."""
    colour, free = [], [0] * (int(edge.max(initial=-1)) + 1)  # free: first colour that is free at each vertex
    for i, j in edge.tolist():
        colour.append(max(free[i], free[j]))
        free[i] = free[j] = colour[-1] + 1
    return np.argsort(colour, kind="stable"), np.append(0, np.cumsum(np.bincount(colour)))


def _stencils(mesh: ClothMesh) -> tuple[Array, Array]:
    """K of Bergou et al. 2006 (h, 4) and A0 + A1 (h,) of every hinge."""
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


@njit(nogil=True, forceinline=True)
def _load_four(x, i):
    return load(x, i[0]), load(x, i[1]), load(x, i[2]), load(x, i[3])


@njit(nogil=True, forceinline=True)
def _apart(p, q):
    return q[0] - p[0], q[1] - p[1], q[2] - p[2], q[3] - p[3]


@njit(nogil=True, error_model="numpy", fastmath={"contract"}, forceinline=True)
def _store_four(x, i, p, share, d):
    """p + share * d in rows i of x: four of each."""
    a, b, c, e = spread(share)
    store(x, i[0], p[0] + a * d[0])
    store(x, i[1], p[1] + b * d[1])
    store(x, i[2], p[2] + c * d[2])
    store(x, i[3], p[3] + e * d[3])


@njit(nogil=True, error_model="numpy", fastmath={"contract"})
def solve_edges(batch_start, edge, inverse_square, wi, wj, x):
    """One sweep over the packed edges: four edges of a batch (`colour_batches`) at once, the rest of the batch one
    by one. batch_start: where each batch begins and the last one ends; inverse_square: of the rest lengths [1/m2];
    wi, wj: share of each end, w / (w_i + w_j + compliance / h^2).

    The correction 1 - 1 / sqrt(r), r the squared length over the squared rest length, is replaced by its Pade
    approximant at r = 1, 2 (r - 1) / (3 r + 1). The relative error is 2e-4 at a strain of 3 % and 2e-3 at 10 %.
    The square root would take as long as all the rest, and the approximant stays finite for an edge of no length.
    """
    k, single, four, one, two = np.uint64(0), np.uint64(1), np.uint64(FOUR), splat_f64x4(1.0), splat_f64x4(2.0)
    for row in range(single, np.uint64(len(batch_start))):
        end = np.uint64(batch_start[row])
        while k + four <= end:
            i, j = ends(edge, k)
            p, q = _load_four(x, i), _load_four(x, j)
            d = _apart(p, q)
            r = load_f64x4(inverse_square, k) * dots(d, d)
            s = vdiv(2.0 * r - two, 3.0 * r + one)
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


@njit(nogil=True, error_model="numpy", fastmath={"contract"})
def solve_hinges(n, hinge, weight, part, x):
    """One sweep over the first n packed hinges; part: w K / (sum w K^2 + compliance / h^2) of each vertex."""
    for k in range(n):
        a, b, c, d = hinge[k, 0], hinge[k, 1], hinge[k, 2], hinge[k, 3]
        # read all before writing: the four vertices differ
        pa, pb, pc, pd = load(x, a), load(x, b), load(x, c), load(x, d)
        ka, kb, kc, kd = spread(load(weight, k))
        sa, sb, sc, sd = spread(load(part, k))
        r = ka * pa + kb * pb + kc * pc + kd * pd
        store(x, a, pa - sa * r)
        store(x, b, pb - sb * r)
        store(x, c, pc - sc * r)
        store(x, d, pd - sd * r)


@njit(nogil=True, error_model="numpy", fastmath={"contract"})
def measure_turns(n, which, hinge, soft, w, x, axis, foot, turn, inverse):
    """Turn 2 sin(angle / 2) of the hinges which[:n], and its gradient at their vertices.

    Times its length, the turn is |K x| of the elastic hinge, but with a sign and with a gradient that neither
    shifts nor rotates the cloth. axis[k]: the gradients at c and d, normals of the triangles over their heights.
    Their opposite is shared between a and b by foot[k], the feet of the heights on a-b. inverse: 1 / (TOGETHER sum
    w grad^2 + soft).
    """
    for k in range(n):
        e = which[k]
        a, b, c, d = hinge[k, 0], hinge[k, 1], hinge[k, 2], hinge[k, 3]
        ex, ey, ez = x[b, 0] - x[a, 0], x[b, 1] - x[a, 1], x[b, 2] - x[a, 2]
        ux, uy, uz = x[c, 0] - x[a, 0], x[c, 1] - x[a, 1], x[c, 2] - x[a, 2]
        vx, vy, vz = x[d, 0] - x[a, 0], x[d, 1] - x[a, 1], x[d, 2] - x[a, 2]
        # normals, as long as twice the area of their triangles; on the same side for flat cloth
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
        size = np.sqrt(max(0.0, 0.5 + 0.5 * cos) * e2)  # of the edge, times cos(angle / 2)
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


@njit(nogil=True, error_model="numpy", fastmath={"contract"})
def bending_friction_moments(
    n, which, hinge, near, share, limit, axis, foot, turn, inverse, slip, held, x, moment
):
    """Moments of the friction in bending of the hinges which[:n], as last measured: moment (n,), times h^2.

    A spring pulls each turn to slip[e], and slips when the springs around it bear more than `limit`. The load is
    summed over both triangles of the hinge (held: (h + 1,) of late). With a limit for each hinge alone, friction
    would be two thirds larger in one direction of the mesh than in another. This function only computes the
    moments, all from the same x; `solve_hinges_with_friction` applies them.
    """
    for k in range(n):
        e = which[k]
        a, b, c, d = hinge[k, 0], hinge[k, 1], hinge[k, 2], hinge[k, 3]
        px, py, pz, qx, qy, qz = axis[k, 0], axis[k, 1], axis[k, 2], axis[k, 3], axis[k, 4], axis[k, 5]
        s, t = foot[k, 0], foot[k, 1]
        bx, by, bz = s * px + t * qx, s * py + t * qy, s * pz + t * qz
        # equal to turn[k] at the last measurement: c and d less the feet of their heights are square to the
        # normals
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


@njit(nogil=True, error_model="numpy", fastmath={"contract"})
def solve_hinges_with_friction(n, hinge, weight, part, axis, foot, moment, grow, w, x):
    """`solve_hinges` with friction: `grow` times its friction moment bends each hinge just before it is solved.
    Moments and elasticity thus balance where cloth stays bent. In separate sweeps each would react to the motion
    of the other, and the damping of bending would take that for speed."""
    for k in range(n):
        a, b, c, d = hinge[k, 0], hinge[k, 1], hinge[k, 2], hinge[k, 3]
        ka, kb, kc, kd = weight[k, 0], weight[k, 1], weight[k, 2], weight[k, 3]
        g, s, t = grow * moment[k], foot[k, 0], foot[k, 1]
        for m in range(3):
            p, q = g * axis[k, m], g * axis[k, 3 + m]
            at_b = s * p + t * q
            xa = x[a, m] - w[a] * (p + q - at_b)
            xb = x[b, m] - w[b] * at_b
            xc = x[c, m] + w[c] * p
            xd = x[d, m] + w[d] * q
            r = ka * xa + kb * xb + kc * xc + kd * xd
            x[a, m] = xa - part[k, 0] * r
            x[b, m] = xb - part[k, 1] * r
            x[c, m] = xc - part[k, 2] * r
            x[d, m] = xd - part[k, 3] * r


@njit(nogil=True, error_model="numpy", fastmath={"contract"})
def damp_edges(batch_start, edge, rate, w, x, v):
    """Remove the share `rate` of the speed at which the ends of each edge part or approach; momentum is kept. Four
    edges at once, as in `solve_edges`."""
    k, single, four, nothing = np.uint64(0), np.uint64(1), np.uint64(FOUR), splat_f64x4(0.0)
    for row in range(single, np.uint64(len(batch_start))):
        end = np.uint64(batch_start[row])
        while k + four <= end:
            i, j = ends(edge, k)
            d = _apart(_load_four(x, i), _load_four(x, j))
            p, q, wi, wj = _load_four(v, i), _load_four(v, j), gather_f64x4(w, i), gather_f64x4(w, j)
            total, d2 = wi + wj, dots(d, d)
            s = vdiv(load_f64x4(rate, k) * dots(_apart(p, q), d), d2 * total)
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
            if not d2 < LOST and total > 0.0:  # what is lost (NaN) shows
                p, q = load(v, i), load(v, j)
                s = rate[k] * dot(q - p, d) / (d2 * total)
                store(v, i, p + (s * w[i]) * d)
                store(v, j, q - (s * w[j]) * d)
            k += single
