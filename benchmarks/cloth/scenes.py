"""Creates the garments, folds and arcs of the cloth benchmarks."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from foldcell.cell.config.garments.garment_file import load_garment
from foldcell.robots.ports import Array
from foldcell.skills.cloth.mesh import ClothMesh, mesh_from_contour
from foldcell.skills.cloth.predict import FoldPrediction, predict_fold, sample_paths
from foldcell.skills.cloth.solver import ClothSimulation
from foldcell.skills.fold_plan.plan import plan_folds
from foldcell.skills.garments.garment import Garment
from foldcell.skills.plane import lengths_along
from foldcell.skills.vocabulary import GraspId, GraspTrajectory, Material, ToolPath

MATERIAL = Material(0.4, 0.03, 0.02, 0.003, 0.6, 0.55, 0.5)
TOWEL = np.array([[-0.3, -0.2], [0.3, -0.2], [0.3, 0.2], [-0.3, 0.2]])
HALF_SHIRT = [(0.08, 0.30), (0.22, 0.26), (0.60, 0.10), (0.57, 0.01), (0.24, 0.12), (0.24, -0.35)]
SHIRT = np.array(HALF_SHIRT + [(-x, y) for x, y in HALF_SHIRT[::-1]])
SHIRT_EDGE = 0.0255  # [m]: about 1300 vertices
DURATION, RELEASE, SETTLE = 3.0, 0.3, 1.0
TIMES = 3
"""Number of repetitions of a speed measurement; the fastest counts."""
IN = 0.012
"""Distance of a grasp from the two edges at a corner [m]."""

HANDS = {GraspId.LEFT: 0, GraspId.RIGHT: 1}

Paths = Mapping[GraspId, ToolPath]


def arc(
    start: tuple[float, ...], end: tuple[float, ...], heading: float, lift: float = 0.4, duration: float = DURATION
) -> ToolPath:
    """Create an arc as in the paper: a cubic Bezier curve, parametrised by arc length, with a smooth time law.

    start, end: (3,) [m]. lift: height of the inner control points above the straight line, in units of its
    horizontal length.
    """
    a, b = np.array(start), np.array(end)
    up = np.array([0.0, 0.0, lift * np.linalg.norm((b - a)[:2])])
    p = np.array([a, a + 0.25 * (b - a) + up, a + 0.75 * (b - a) + up, b])
    t, fine = np.linspace(0.0, duration, 181), np.linspace(0.0, 1.0, 500)

    def at(u: Array) -> Array:
        return np.stack([(1 - u) ** 3, 3 * u * (1 - u) ** 2, 3 * u**2 * (1 - u), u**3], axis=1) @ p

    s = lengths_along(at(fine))
    q = t / duration
    zero = np.zeros(len(t))
    return ToolPath(
        t, at(np.interp(q**3 * (10 - 15 * q + 6 * q * q), s / s[-1], fine)), zero + heading, zero, zero
    )


def towel_mesh(vertices: int) -> tuple[ClothMesh, Material]:
    """Create the 0.60 x 0.40 m towel with about `vertices` vertices, and its fabric. The cloth must be thinner
    than the mesh's edge length, so it is thinner on a fine mesh."""
    edge = float(np.sqrt(0.24 / (0.5 * np.sqrt(3.0) * vertices))) * (0.0262 / 0.02554)
    thickness = min(MATERIAL.thickness, 0.4 * edge)
    return mesh_from_contour(TOWEL, edge), replace(MATERIAL, thickness=thickness)


def stacked(sheets: Sequence[ClothMesh]) -> ClothMesh:
    """Join sheets of one layer to one mesh, in which each sheet is a layer. The first sheet is the lowest."""
    starts = np.cumsum([0, *(len(s.rest) for s in sheets)])
    numbers = np.arange(len(sheets), dtype=np.int32)
    return ClothMesh(
        np.vstack([s.rest for s in sheets]),
        np.repeat(numbers, [len(s.rest) for s in sheets]),
        np.vstack([s.triangles + start for s, start in zip(sheets, starts[:-1], strict=True)]).astype(np.int32),
        np.repeat(numbers, [len(s.triangles) for s in sheets]),
        np.zeros((0, 2), np.int32),
    )


def towel_half(lift: float = 0.4) -> Paths:
    """Return the hands' paths that fold the towel's right half over its left half."""
    x, y, q = 0.3 - IN, 0.2 - IN, np.pi / 2
    return {
        i: arc((x, s * y, 0.001), (-x, s * y, 0.012), q, lift) for i, s in ((GraspId.LEFT, 1), (GraspId.RIGHT, -1))
    }


def mirrored(mesh: ClothMesh, material: Material, x: Array) -> float:
    """Mean distance [m] of the towel at x (n, 3) from the exact shape, in which one half lies on the other."""
    target = mesh.lay_flat(material.thickness)
    over = target[:, 0] > 0
    target[over, 0] *= -1.0
    target[over, 2] += material.thickness
    return float(np.average(np.linalg.norm(x - target, axis=1), weights=mesh.vertex_area))


def shortened(path: ToolPath, seconds: float) -> ToolPath:
    """Return the first `seconds` of a path."""
    n = int(np.searchsorted(path.t, seconds)) + 1
    return ToolPath(path.t[:n], path.position[:n], path.heading[:n], path.pitch[:n], path.roll[:n])


def towel_quarter() -> Paths:
    """Return the hands' paths of the towel's second fold, to a quarter."""
    grasps = ((GraspId.LEFT, -0.268), (GraspId.RIGHT, -0.06))
    return {i: arc((x, 0.188, 0.0005), (x, -0.188, 0.02), 0.0) for i, x in grasps}


def shirt_folds(material: Material = MATERIAL, speed: float = 1.0) -> tuple[ClothMesh, list[Paths]]:
    """Return the mesh of the two-layer shirt SHIRT, and the hands' paths of its three folds, planned as for
    long-sleeve shirts.

    The right and then the left sleeve are folded onto the body. Then two hands fold the hem over both sleeves.
    speed: factor on the speed of the hands.
    """
    planned = load_garment("long_sleeve_shirt_large")
    # From hem to collar, at y < 0. The collar is at +x.
    side = np.array(HALF_SHIRT[::-1]) @ [[0.0, -1.0], [1.0, 0.0]]
    outline = np.vstack([side, side[::-1] * (1.0, -1.0)])
    outline[:, 0] -= 0.5 * (outline[:, 0].min() + outline[:, 0].max())
    garment = replace(planned, name="shirt", template=outline, material=material)
    return _planned(garment, SHIRT_EDGE, speed)


def sides_folds() -> list[Paths]:
    """Return the hands' paths of three folds of SHIRT that are harder than any shipped plan: the left and the
    right sleeve, each together with a side that is too narrow to stay folded, so that one sleeve lies on the
    other; then the hem. The numbers in the code are start and end of each hand."""
    q = np.pi / 2
    return [
        {i: arc(*ends, heading) for i, ends in ((GraspId.LEFT, left), (GraspId.RIGHT, right))}
        for left, right, heading in (
            (((0.57, 0.06, 5e-4), (-0.25, 0.06, 0.02)), ((0.225, -0.33, 5e-4), (0.095, -0.33, 0.02)), q),
            (((-0.57, 0.06, 5e-4), (0.25, 0.06, 0.03)), ((-0.225, -0.33, 5e-4), (-0.095, -0.33, 0.03)), q),
            (((-0.13, -0.335, 5e-4), (-0.13, 0.25, 0.035)), ((0.13, -0.335, 5e-4), (0.13, 0.25, 0.035)), 0.0),
        )
    ]


def planned_folds(name: str, speed: float = 1.0, **made: float) -> tuple[ClothMesh, Material, list[Paths]]:
    """Return a shipped garment's mesh and fabric, and the hands' paths of its planned folds: arcs from grasps to
    targets.

    speed: factor on the speed of the hands. made: values that replace those of the shipped fabric. They also
    change the heights at which the hands release.
    """
    shipped = load_garment(name)
    garment = replace(shipped, material=replace(shipped.material, **made))
    mesh, folds = _planned(garment, garment.mesh_edge_m, speed)
    return mesh, garment.material, folds


def _planned(garment: Garment, edge: float, speed: float) -> tuple[ClothMesh, list[Paths]]:
    state = garment.flat_state(*garment.poses.middle)
    mesh = mesh_from_contour(state.contour, edge, garment.layers)
    folds: list[Paths] = []
    for step in plan_folds(state, garment).unwrap():
        folds.append({
            i: arc((*grasp.point, 5e-4), tuple(step.targets[i]), grasp.heading, duration=DURATION / speed)
            for i, grasp in step.grasps.items()
        })  # fmt: skip
    return mesh, folds


def timed(
    mesh: ClothMesh, x: Array, material: Material, paths: Paths, settle: float = SETTLE, times: int = 1
) -> tuple[FoldPrediction, float]:
    """Simulate a fold. Return its result, and the speed of its thread relative to real time (CPU time).

    The speed is the fastest of `times` repetitions. All repetitions are the same computation to the last bit;
    their times differ only because of other load on the machine.
    """
    seconds = np.inf
    for _ in range(times):
        start = time.thread_time()
        result = predict_fold(mesh, x, material, paths, RELEASE, settle)
        seconds = min(seconds, time.thread_time() - start)
    return result, seconds_of(paths, settle) / seconds


def seconds_of(paths: Paths, settle: float = SETTLE) -> float:
    """Duration of a fold: motion, release and settling [s]."""
    return max(float(path.t[-1]) for path in paths.values()) + RELEASE + settle


def frames_of(mesh: ClothMesh, x: Array, material: Material, paths: Paths) -> Iterator[Array]:
    """Yield the vertices (n, 3) of a fold after each frame. They are bit-identical to those in `predict_fold`."""
    simulation = ClothSimulation(mesh, material, x, at_rest=True)
    frame = simulation.settings.frame
    frames = round(max(float(path.t[-1]) for path in paths.values()) / frame)
    p, r = sample_paths(paths, frames, frame)
    for i in paths:
        simulation.grip(HANDS[i], p[0, HANDS[i]], r[0, HANDS[i]])
    for k in range(frames):
        simulation.advance_along(p[k : k + 2], r[k : k + 2])
        yield simulation.positions
    for i in paths:
        simulation.release(HANDS[i])
    for _ in range(round((RELEASE + SETTLE) / frame)):
        simulation.advance(1)
        yield simulation.positions


@dataclass(frozen=True, eq=False)
class SharedFold:
    """A fold of flat cloth that all simulations make. error: function that returns the error [m] of the cloth's
    shape (n, 3) at the end."""

    mesh: ClothMesh
    material: Material
    paths: Paths
    error: Callable[[Array], float]

    @property
    def start(self) -> Array:
        return self.mesh.lay_flat(self.material.thickness)

    @property
    def seconds(self) -> float:
        """Duration of the fold, including settling [s]."""
        return seconds_of(self.paths)


def plain_fold(friction: float = MATERIAL.friction_static) -> SharedFold:
    """Return the fold in half of the 0.60 x 0.40 m towel of 425 vertices."""
    mesh, material = towel_mesh(425)
    # The peers have only one friction coefficient per contact.
    material = replace(material, friction_static=friction, friction_dynamic=friction)
    return SharedFold(mesh, material, towel_half(), lambda x: mirrored(mesh, material, x))


def optimised_fold() -> SharedFold:
    """Return the medium towel's first fold along the shipped library's trajectory, which our predictor found."""
    from benchmarks.attainable_dissimilarity import distance_to_target
    from foldcell.cell.config.trajectory_library.library_file import load_library
    from foldcell.skills.trajectory.arcs.paths import tool_paths
    from foldcell.skills.trajectory.trajectory_library import lookup, trajectory_from

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
    mesh = mesh_from_contour(state.contour, garment.mesh_edge_m)
    return SharedFold(
        mesh, garment.material, tool_paths(trajectory, step),
        lambda x: distance_to_target(mesh, step.lines, garment.material, x),
    )  # fmt: skip
