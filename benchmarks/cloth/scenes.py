"""The garments, folds and arcs that the figures are taken on."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from cell.garments import load_garment
from robots.ports import Array, Side
from skills.cloth.crossings import count_crossings
from skills.cloth.mesh import ClothMesh, mesh_from_contour
from skills.cloth.predict import FoldPrediction, predict_fold
from skills.cloth.solver import ClothSimulation, ToolMotion
from skills.planning.plan import plan_folds
from skills.vocabulary import GraspTrajectory, Material, ToolPath

MATERIAL = Material(0.4, 0.03, 0.02, 0.003, 0.6, 0.55, 0.5)
TOWEL = np.array([[-0.3, -0.2], [0.3, -0.2], [0.3, 0.2], [-0.3, 0.2]])
HALF_SHIRT = [(0.08, 0.30), (0.22, 0.26), (0.60, 0.10), (0.57, 0.01), (0.24, 0.12), (0.24, -0.35)]
SHIRT = np.array(HALF_SHIRT + [(-x, y) for x, y in HALF_SHIRT[::-1]])
DURATION, RELEASE, SETTLE = 3.0, 0.3, 1.0
IN = 0.012
"""Grasps so far inside a corner [m]."""

Paths = Mapping[Side, ToolPath]


def arc(
    start: tuple[float, ...], end: tuple[float, ...], heading: float, lift: float = 0.4, duration: float = DURATION
) -> ToolPath:
    """The paper's kind of arc: a cubic Bezier, even in arc length, smooth in time."""
    a, b = np.array(start), np.array(end)
    up = np.array([0.0, 0.0, lift * np.linalg.norm((b - a)[:2])])
    p = np.array([a, a + 0.25 * (b - a) + up, a + 0.75 * (b - a) + up, b])
    t, fine = np.linspace(0.0, duration, 181), np.linspace(0.0, 1.0, 500)

    def at(u: Array) -> Array:
        return np.stack([(1 - u) ** 3, 3 * u * (1 - u) ** 2, 3 * u**2 * (1 - u), u**3], axis=1) @ p

    s = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(at(fine), axis=0), axis=1))])
    q = t / duration
    zero = np.zeros(len(t))
    return ToolPath(
        t, at(np.interp(q**3 * (10 - 15 * q + 6 * q * q), s / s[-1], fine)), zero + heading, zero, zero
    )


def towel_mesh(vertices: int) -> tuple[ClothMesh, Material]:
    """The 0.60 x 0.40 m towel with about so many vertices. Cloth must be thinner than its mesh is fine."""
    edge = float(np.sqrt(0.24 / (0.5 * np.sqrt(3.0) * vertices))) * (0.0262 / 0.02554)
    thickness = min(MATERIAL.thickness, 0.4 * edge)
    return mesh_from_contour(TOWEL, edge), replace(MATERIAL, thickness=thickness)


def towel_half(x: float = 0.3 - IN, y: float = 0.2 - IN) -> Paths:
    """The towel's right half over its left half."""
    q = np.pi / 2
    return {side: arc((x, s * y, 0.001), (-x, s * y, 0.012), q) for side, s in ((Side.LEFT, 1), (Side.RIGHT, -1))}


def shortened(path: ToolPath, seconds: float) -> ToolPath:
    """Its beginning."""
    n = int(np.searchsorted(path.t, seconds)) + 1
    return ToolPath(path.t[:n], path.position[:n], path.heading[:n], path.pitch[:n], path.roll[:n])


def towel_quarter() -> Paths:
    """The folded towel once more."""
    sides = ((Side.LEFT, -0.268), (Side.RIGHT, -0.06))
    return {side: arc((x, 0.188, 0.0005), (x, -0.188, 0.02), 0.0) for side, x in sides}


def shirt_folds() -> list[Paths]:
    """Right sleeve, left sleeve, hem: start and end of each hand."""
    q = np.pi / 2
    return [
        {Side.LEFT: arc(*left, heading), Side.RIGHT: arc(*right, heading)}
        for left, right, heading in (
            (((0.57, 0.06, 5e-4), (-0.25, 0.06, 0.02)), ((0.225, -0.33, 5e-4), (0.095, -0.33, 0.02)), q),
            (((-0.57, 0.06, 5e-4), (0.25, 0.06, 0.03)), ((-0.225, -0.33, 5e-4), (-0.095, -0.33, 0.03)), q),
            (((-0.13, -0.335, 5e-4), (-0.13, 0.25, 0.035)), ((0.13, -0.335, 5e-4), (0.13, 0.25, 0.035)), 0.0),
        )
    ]


def planned_folds(name: str) -> tuple[ClothMesh, Material, list[Paths]]:
    """A shipped garment's mesh, fabric and plan, along arcs from its grasps to its targets."""
    garment = load_garment(name)
    state = garment.flat_state(*garment.poses.middle)
    mesh = mesh_from_contour(state.contour, garment.mesh_edge_m, garment.layers)
    folds: list[Paths] = []
    for step in plan_folds(state, garment).unwrap():
        folds.append({
            side: arc((*grasp.point, 5e-4), tuple(step.targets[side]), grasp.heading)
            for side, grasp in step.grasps.items()
        })  # fmt: skip
    return mesh, garment.material, folds


def timed(
    mesh: ClothMesh, x: Array, material: Material, paths: Paths, settle: float = SETTLE
) -> tuple[FoldPrediction, float]:
    """A fold, and how many times faster than real time its thread computed it (CPU time)."""
    start = time.thread_time()
    result = predict_fold(mesh, x, material, paths, RELEASE, settle)
    seconds = time.thread_time() - start
    return result, (max(float(p.t[-1]) for p in paths.values()) + RELEASE + settle) / seconds


def most_crossings(mesh: ClothMesh, x: Array, material: Material, paths: Paths) -> tuple[int, Array]:
    """The same fold frame by frame: the most edge-triangle crossings at any of them, and the end (n, 3)."""
    worst, positions = 0, x
    for positions in _frames(mesh, x, material, paths):
        worst = max(worst, count_crossings(positions, mesh.triangles))
    return worst, positions


def _frames(mesh: ClothMesh, x: Array, material: Material, paths: Paths) -> Iterator[Array]:
    simulation = ClothSimulation(mesh, material, x)
    frame = simulation.settings.frame
    hands = {side: hand for hand, side in enumerate((Side.LEFT, Side.RIGHT)) if side in paths}

    def pose(side: Side, t: float) -> tuple[Array, Array]:
        path = paths[side]
        p = np.array([np.interp(t, path.t, path.position[:, k]) for k in range(3)])
        return p, path.rotation[0]

    for side, hand in hands.items():
        simulation.grip(hand, *pose(side, 0.0))
    for k in range(round(max(float(p.t[-1]) for p in paths.values()) / frame)):
        simulation.advance(
            1, [ToolMotion(h, *pose(s, k * frame), *pose(s, (k + 1) * frame)) for s, h in hands.items()]
        )
        yield simulation.positions
    for hand in hands.values():
        simulation.release(hand)
    for _ in range(round((RELEASE + SETTLE) / frame)):
        simulation.advance(1)
        yield simulation.positions


@dataclass(frozen=True, eq=False)
class SharedFold:
    """A fold that both simulations make: mesh with a vertex at each grasp; held: that vertex for each hand."""

    mesh: ClothMesh
    material: Material
    paths: Paths
    held: Mapping[Side, int]
    start: Array
    error: Callable[[Array], float]


def grid_mesh(xs: Array, ys: Array) -> ClothMesh:
    """A sheet with vertices on lines xs, ys [m] and alternating diagonals."""
    ny = len(ys)
    points = np.stack(np.meshgrid(xs, ys, indexing="ij"), axis=-1).reshape(-1, 2)
    rows = []
    for i in range(len(xs) - 1):
        for j in range(ny - 1):
            a, b, c, d = i * ny + j, (i + 1) * ny + j, (i + 1) * ny + j + 1, i * ny + j + 1
            rows += [(a, b, c), (a, c, d)] if (i + j) % 2 == 0 else [(a, b, d), (b, c, d)]
    tri: NDArray[np.int32] = np.array(rows, dtype=np.int32)
    zero = np.zeros(len(points), np.int32)
    return ClothMesh(points, zero, tri, np.zeros(len(tri), np.int32), np.zeros((0, 2), np.int32))


def inset_lines(low: float, high: float, inset: float, edge: float) -> Array:
    """Lines from low to high, one `inset` inside each end, the others about `edge` apart [m]."""
    n = max(2, round((high - low - 2 * inset) / edge) + 1)
    return np.concatenate([[low], np.linspace(low + inset, high - inset, n), [high]])


def plain_fold() -> SharedFold:
    """The 0.60 x 0.40 m towel in half."""
    mesh = grid_mesh(inset_lines(-0.3, 0.3, IN, 0.025), inset_lines(-0.2, 0.2, IN, 0.025))
    paths = towel_half()
    target = mesh.lay_flat(MATERIAL.thickness)
    over = target[:, 0] > 0
    target[over] *= (-1.0, 1.0, 1.0)
    target[over, 2] += MATERIAL.thickness
    return SharedFold(
        mesh, replace(MATERIAL, friction_dynamic=MATERIAL.friction_static), paths,
        _held(mesh, paths), mesh.lay_flat(MATERIAL.thickness),
        lambda x: float(np.average(np.linalg.norm(x - target, axis=1), weights=mesh.vertex_area)),
    )  # fmt: skip


def optimised_fold() -> SharedFold:
    """The medium towel's first fold along the trajectory that our predictor found (the shipped library's)."""
    from benchmarks.d_relax import distance_to_target
    from cell.library import load_library
    from skills.trajectory.library import lookup, trajectory_from
    from skills.trajectory.paths import tool_paths

    garment = load_garment("medium_towel")
    state = garment.flat_state(*garment.poses.middle)
    step = plan_folds(state, garment).unwrap()[0]
    entry = lookup(load_library().library, garment.category, step.name, garment.material, garment.size_m)
    if entry is None:
        raise LookupError("the shipped library has no trajectory for the medium towel's first fold")
    trajectory: GraspTrajectory | None = trajectory_from(
        entry, step, garment.material.thickness, garment.max_tool_speed
    )
    if trajectory is None:
        raise LookupError("the library's trajectory is for another number of arms")
    paths = tool_paths(trajectory, step)
    lines = []
    for k in range(2):
        low, high = state.contour[:, k].min(), state.contour[:, k].max()
        inset = min(min(p.position[0, k] - low, high - p.position[0, k]) for p in paths.values())
        lines.append(inset_lines(low, high, float(inset), garment.mesh_edge_m))
    mesh = grid_mesh(lines[0], lines[1])
    return SharedFold(
        mesh, garment.material, paths, _held(mesh, paths), mesh.lay_flat(garment.material.thickness),
        lambda x: distance_to_target(mesh, step.lines, garment.material, x),
    )  # fmt: skip


def _held(mesh: ClothMesh, paths: Paths) -> dict[Side, int]:
    return {
        side: int(np.argmin(np.linalg.norm(mesh.rest - path.position[0, :2], axis=1)))
        for side, path in paths.items()
    }
