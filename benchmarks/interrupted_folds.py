"""Folds of the simulated world that are interrupted, each with pictures: for tests and figures of the state
estimate.

The garment is the world's: its outline, mesh and fabric are drawn, and it lies with wrinkles. The tools follow the
planned paths without arms. The believed shapes are the predictor's, from the picture of the flat garment.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from benchmarks.perception.scenes import TABLE, Studio, open_studio
from benchmarks.shipped_settings import PERCEPTION
from foldcell.cell.config.garments.garment_file import load_garment
from foldcell.cell.config.trajectory_library.library_file import load_library
from foldcell.cell.hardware.camera import nominal_calibration
from foldcell.cell.simulation.garment.cloth_body import FRAME_RATE
from foldcell.cell.simulation.garment.fabric import garment_uv
from foldcell.cell.simulation.garment.garment import WorldGarment
from foldcell.cell.simulation.noise import load_noise
from foldcell.robots.baxter.robot import MOUNT
from foldcell.skills.cloth.mesh import ClothMesh
from foldcell.skills.cloth.predict import HANDS, predict_fold, sample_paths
from foldcell.skills.fold_plan.crease_mesh import predictor_mesh
from foldcell.skills.fold_plan.plan import plan_folds
from foldcell.skills.garments.garment import Garment
from foldcell.skills.perception.perceive import perceive
from foldcell.skills.perception.rectification.camera_refinement import refine_calibration
from foldcell.skills.state_estimate.hand_course import HandCourse
from foldcell.skills.state_estimate.hypothesis import FoldState
from foldcell.skills.trajectory.arcs.paths import LIFT_HEIGHT, lifted, tool_paths
from foldcell.skills.trajectory.trajectory_library import lookup, trajectory_from
from foldcell.skills.vocabulary import (
    Array,
    CameraCalibration,
    CameraFrame,
    FoldStep,
    GraspId,
    PredictedShape,
    ToolPath,
    tool_rotation,
)

STROKE, FORCE, DEEPER = 0.030, 20.0, 0.001
"""Opening of the pads before they close [m], their force [N], and the depth by which the tips are lower [m]."""
SETTLE_FRAMES = round(1.5 * FRAME_RATE)
SAME, NEARLY_ALL = 0.030, 0.98
"""If this share of the vertices lies nearer than this [m] to their places before or after the fold, after a rigid
alignment, that is the true state."""


@dataclass(frozen=True, eq=False)
class WorldFold:
    """One fold of a world garment. before, after, paths, mesh: as the executive believes and plans them. top:
    height of the flat garment as the camera sees it [m]."""

    garment: Garment
    step: FoldStep
    mesh: ClothMesh
    before: PredictedShape
    after: PredictedShape
    paths: Mapping[GraspId, ToolPath]
    top: float
    calibration: CameraCalibration
    reference: CameraFrame
    world: WorldGarment
    studio: Studio
    start: Mapping[str, np.ndarray]

    @property
    def lift(self) -> float:
        """Height by which the camera sees the flat garment above its mesh [m]."""
        return max(self.top - 0.5 * self.garment.material.thickness, 0.0)

    @property
    def _frames(self) -> float:
        """Duration of the motion in frames."""
        return max(float(path.t[-1]) for path in self.paths.values()) * FRAME_RATE

    def shoot(self, vertices: Array) -> CameraFrame:
        """Take a picture of the world's garment at `vertices` (n, 3)."""
        return self.studio.shoot(vertices)

    def at_start(self) -> Array:
        """Lay the garment as before the fold. Returns its vertices (n, 3)."""
        self.world.restore(self.start)
        return self.world.seen

    def interrupted(self, lost: Mapping[GraspId, float], end: float = 1.0, laid_back: bool = False) -> Array:
        """Fold the world's garment. lost: share of the motion's time at which a hand loses its cloth; end: the
        same at which the other hands open. laid_back: from `end`, they return to the grasps first. Returns the
        vertices (n, 3) at rest."""
        self.world.restore(self.start)
        last = round(self._frames)
        p, r = sample_paths(self.paths, last, 1.0 / FRAME_RATE)
        self._grip(p[0], r[0])
        course = list(range(round(end * last) + 1))
        if laid_back:
            course += course[-2::-1]
        for now, following in pairwise(course):
            for grasp_id, share in lost.items():
                if now == round(share * last):
                    self.world.release(HANDS.index(grasp_id))
            self.world.frame(p[[now, following]], r[[now, following]], None)
        self._let_go(p[course[-1]], r[course[-1]])
        return self.world.seen

    def swerving(self, share: float, aside: float) -> tuple[Array, HandCourse]:
        """Fold the world's garment until `share` of the motion's time. From there the hands fall onto the table
        within 0.3 s, while they swerve by `aside` [m] along the fold line, and lose the cloth. Returns the
        vertices (n, 3) at rest, and the course of the hands as an ideal sensor measures it."""
        self.world.restore(self.start)
        p, r = sample_paths(self.paths, round(self._frames), 1.0 / FRAME_RATE)
        last = round(share * self._frames)
        sink = np.linspace(0.0, 1.0, round(0.3 * FRAME_RATE) + 1)[1:]
        fallen = np.repeat(p[last : last + 1], len(sink), axis=0)
        fallen[..., :2] += (aside * sink)[:, None, None] * self.step.line.direction
        fallen[..., 2] += sink[:, None] * (p[0, :, 2] - p[last, :, 2])
        p, r = (
            np.vstack([p[: last + 1], fallen]),
            np.vstack([r[: last + 1], np.repeat(r[last : last + 1], len(sink), 0)]),
        )
        self._grip(p[0], r[0])
        for k in range(len(p) - 1):
            self.world.frame(p[k : k + 2], r[k : k + 2], None)
        self._let_go(p[-1], r[-1])
        hands = {grasp_id: HANDS.index(grasp_id) for grasp_id in self.paths}
        t = np.arange(len(p)) / FRAME_RATE
        course = HandCourse(
            t, {g: p[:, h] for g, h in hands.items()}, {g: r[:, h] for g, h in hands.items()},
            dict.fromkeys(hands, float(t[-1])),
        )  # fmt: skip
        return self.world.seen, course

    def heaped(self, rng: np.random.Generator) -> Array:
        """Lift the garment by a random point and drop it. Returns the vertices (n, 3) at rest."""
        self.world.restore(self.start)
        x = self.world.positions
        inner = x[rng.integers(len(x))]
        heading, height = rng.uniform(0.0, np.pi), rng.uniform(0.15, 0.35)
        aside = rng.uniform(-0.10, 0.10, 2)
        turned = tool_rotation(np.full(1, heading), np.zeros(1), np.zeros(1))[0]
        frames = round(2.0 * FRAME_RATE)
        share = np.linspace(0.0, 1.0, frames)
        p = np.zeros((frames, 2, 3))
        p[:, 1] = (0.0, 0.0, 2.0)
        p[:, 0, :2] = inner[:2] + np.outer(share, aside)
        p[:, 0, 2] = height * np.sin(0.5 * np.pi * share)
        r = np.tile(turned, (frames, 2, 1, 1))
        self.world.grip(0, p[0, 0], turned, STROKE, FORCE)
        for k in range(frames - 1):
            self.world.frame(p[k : k + 2], r[k : k + 2], None)
        self._let_go(p[-1], r[-1])
        return self.world.seen

    def true_state(self, vertices: Array, completed: Array) -> FoldState:
        """Return the state of the world's garment at `vertices` (n, 3). completed: its vertices after the complete
        fold."""
        for state, end in ((FoldState.AFTER, completed), (FoldState.BEFORE, self.at_start())):
            distance = np.linalg.norm(_aligned(vertices, end) - end, axis=1)
            if np.quantile(distance, NEARLY_ALL) < SAME:
                return state
        return FoldState.HALF_WAY

    def _grip(self, position: Array, rotation: Array) -> None:
        for hand, grasp_id in enumerate(HANDS):
            if grasp_id in self.paths:
                self.world.grip(hand, position[hand] - (0.0, 0.0, DEEPER), rotation[hand], STROKE, FORCE)

    def _let_go(self, position: Array, rotation: Array) -> None:
        for hand in range(len(HANDS)):
            self.world.release(hand)
        p, r = np.stack([position] * 2), np.stack([rotation] * 2)
        for _ in range(SETTLE_FRAMES):
            self.world.frame(p, r, None)


def _aligned(vertices: Array, to: Array) -> Array:
    """Move vertices (n, 3) rigidly on the table, by least squares, onto others (n, 3) (Kabsch 1976)."""
    a, b = vertices[:, :2].mean(axis=0), to[:, :2].mean(axis=0)
    u, _, v = np.linalg.svd((vertices[:, :2] - a).T @ (to[:, :2] - b))
    turn = u @ np.diag([1.0, np.linalg.det(u @ v)]) @ v
    return np.column_stack([(vertices[:, :2] - a) @ turn + b, vertices[:, 2]])


def shoved(vertices: Array, distance: float, angle: float, direction: float) -> Array:
    """Move a garment (n, 3) as a whole by `distance` [m] in `direction` [rad], and turn it by `angle` [rad]."""
    c, s = np.cos(angle), np.sin(angle)
    centre = vertices[:, :2].mean(axis=0)
    moved = vertices.copy()
    moved[:, :2] = (vertices[:, :2] - centre) @ np.array([[c, s], [-s, c]]) + centre
    moved[:, :2] += distance * np.array([np.cos(direction), np.sin(direction)])
    return moved


@contextmanager
def open_fold(name: str, seed: int, index: int = 0) -> Iterator[WorldFold]:
    """Lay a world garment, look at it, plan its folds, and make the folds before fold `index`."""
    garment = load_garment(name)
    world = WorldGarment(garment, load_noise().garment, np.random.default_rng(seed), False)
    world.lay()
    library = load_library().library
    with open_studio(garment_uv(world.mesh.rest, world.mesh.layer), world.mesh.triangles, seed) as studio:
        reference, flat = studio.shoot(None), studio.shoot(world.seen)
        nominal = nominal_calibration(MOUNT, TABLE)
        calibration = refine_calibration(reference, nominal, TABLE).value or nominal
        seen = perceive(flat, calibration, TABLE, reference, [garment], name, settings=PERCEPTION).unwrap()
        mesh, steps = predictor_mesh(seen.state, garment), plan_folds(seen.state, garment).unwrap()
        x = mesh.lay_flat(garment.material.thickness)
        for step in steps[: index + 1]:
            entry = lookup(library, garment.category, step.name, garment.material, garment.size_m,
                           arms=len(step.grasps))  # fmt: skip
            found = None if entry is None else trajectory_from(entry, step, garment.material.thickness)
            if found is None:
                raise LookupError(f"the library has no trajectory for {name}, {step.name}")
            arcs = tool_paths(found, step, garment.max_tool_speed)
            paths = {grasp_id: lifted(path, LIFT_HEIGHT) for grasp_id, path in arcs.items()}
            after = predict_fold(mesh, x, garment.material, paths).vertices
            start = world.checkpoint()
            assert start is not None
            fold = WorldFold(
                garment, step, mesh, PredictedShape(x, mesh.triangles, mesh.rest),
                PredictedShape(after, mesh.triangles, mesh.rest), paths, seen.top, calibration, reference, world,
                studio, start,
            )  # fmt: skip
            if step.index == index:
                yield fold
                return
            fold.interrupted({})
            x = after
