# mypy: allow-untyped-defs, allow-incomplete-defs
"""Stretch over edges and quadratic bending over hinges, as compliant constraints (XPBD).

Stretch: an edge of rest length l beside triangles of area A is a spring of stiffness Y A / l^2, Y the
membrane's Young modulus [N/m]; on equilateral triangles that is the exact isotropic membrane with Poisson
ratio 1/3 (Seung & Nelson 1988). Bending: quadratic hinges with the stencil K of Bergou et al. 2006, each on
its own: 1/2 * B / (A0 + A1) * |K x|^2, B the flexural rigidity [Nm], K from cotangents; it is linear, so that
a hinge is three independent linear constraints. Summed over hinges |K x|^2 / (A0 + A1) is the squared
curvature of a cylinder once; the factor 3 of the paper belongs to elements whose edges are assembled into one
operator.

One sweep of XPBD a substep adds a compliance of its own, about h^2 sum(w |grad C|^2) a constraint: it is
taken off the asked one beforehand, so that a material means the same on any mesh and with any substep.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from robots.ports import Array
from skills.cloth.mesh import ClothMesh
from skills.vocabulary import Material

__all__ = [
    "GRAVITY", "Elastic", "build_elastic", "flexural_rigidity", "membrane_modulus", "shuffled", "stretch_excess",
]  # fmt: skip

GRAVITY = 9.81  # [m/s2]
SWEEP = 0.5  # compliance of one sweep, in units of h^2 sum(w |grad C|^2): measured by the hang test
FLOOR = 0.02  # of the same unit: no constraint is made stiffer


class Elastic(NamedTuple):
    """Constraints of one mesh and material, in the order in which they are solved.

    edge: (e, 2); rim: (e,) edges of hems and seams; length: (e,) [m]; compliance: (e,) [m/N], corrected for the
    sweep; stiffness: (e,) [N/m]. hinge: (h, 4); weight: (h, 4) the cotangent stencil K; bend: (h,) compliance
    (A0 + A1) / B [1/(N m)].
    """

    edge: NDArray[np.int32]
    rim: NDArray[np.bool_]
    length: Array
    compliance: Array
    stiffness: Array
    hinge: NDArray[np.int32]
    weight: Array
    bend: Array


def membrane_modulus(material: Material, reference_drop: float) -> float:
    """Young modulus of the membrane [N/m] that a strip of `reference_drop` [m], hung by its end, elongates
    under its own weight by `stretch_fraction`: Y = areal_mass g L / (2 s)."""
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
    return modulus * mesh.edge_area / length**2 * directional * np.where(outline, seam_factor, 1.0)


def shuffled(n: int) -> NDArray[np.int64]:
    """A fixed order without direction: a sweep along the mesh's own order would pull the cloth one way."""
    return np.random.default_rng(7).permutation(n)


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


@njit(nogil=True, error_model="numpy", fastmath={"contract"})
def solve_edges(n, edge, length, wi, wj, x):
    """One sweep over the first n packed edges; wi, wj: share of each end, w / (w_i + w_j + compliance / h^2)."""
    for k in range(n):
        i, j = edge[k, 0], edge[k, 1]
        dx, dy, dz = x[j, 0] - x[i, 0], x[j, 1] - x[i, 1], x[j, 2] - x[i, 2]
        d2 = dx * dx + dy * dy + dz * dz
        if d2 < 1e-18:
            continue
        s = 1.0 - length[k] / np.sqrt(d2)
        a, b = s * wi[k], s * wj[k]
        x[i, 0] += a * dx
        x[i, 1] += a * dy
        x[i, 2] += a * dz
        x[j, 0] -= b * dx
        x[j, 1] -= b * dy
        x[j, 2] -= b * dz


@njit(nogil=True, error_model="numpy", fastmath={"contract"})
def solve_hinges(n, hinge, weight, inverse, w, x):
    """One sweep over the first n packed hinges; inverse: 1 / (sum w K^2 + compliance / h^2)."""
    for k in range(n):
        a, b, c, d = hinge[k, 0], hinge[k, 1], hinge[k, 2], hinge[k, 3]
        ka, kb, kc, kd = weight[k, 0], weight[k, 1], weight[k, 2], weight[k, 3]
        s = inverse[k]
        fa, fb, fc, fd = w[a] * ka, w[b] * kb, w[c] * kc, w[d] * kd
        for m in range(3):
            r = -s * (ka * x[a, m] + kb * x[b, m] + kc * x[c, m] + kd * x[d, m])
            x[a, m] += r * fa
            x[b, m] += r * fb
            x[c, m] += r * fc
            x[d, m] += r * fd


@njit(nogil=True, error_model="numpy", fastmath={"contract"})
def damp_edges(n, edge, rate, w, x, v):
    """Take the share `rate` of the speed at which each edge's ends part or meet: momentum is kept."""
    for k in range(n):
        i, j = edge[k, 0], edge[k, 1]
        total = w[i] + w[j]
        dx, dy, dz = x[j, 0] - x[i, 0], x[j, 1] - x[i, 1], x[j, 2] - x[i, 2]
        d2 = dx * dx + dy * dy + dz * dz
        if d2 < 1e-18 or total == 0.0:
            continue
        dv = (v[j, 0] - v[i, 0]) * dx + (v[j, 1] - v[i, 1]) * dy + (v[j, 2] - v[i, 2]) * dz
        s = rate[k] * dv / (d2 * total)
        a, b = s * w[i], s * w[j]
        v[i, 0] += a * dx
        v[i, 1] += a * dy
        v[i, 2] += a * dz
        v[j, 0] -= b * dx
        v[j, 1] -= b * dy
        v[j, 2] -= b * dz
