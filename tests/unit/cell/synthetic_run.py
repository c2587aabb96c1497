"""A synthetic run for tests of the recorder: Baxter folds a towel in two folds, without simulation.

The towel turns about its fold line like a stiff sheet, the hands follow its corners by inverse kinematics, and
pictures are drawn. There is no physics.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from foldcell.cell.record.run_record import RecordingLosses
from foldcell.cell.states.transition_table import State
from foldcell.cell.view.recorder import Recorder
from foldcell.robots.baxter.robot import load_model
from foldcell.robots.ports import Array, CameraFrame, GripperState, Intrinsics, JointState, Side, TactileReading
from foldcell.skills.motion.kinematics.ik import solve_seeds
from foldcell.skills.vocabulary import (
    CameraCalibration,
    FoldLine,
    FoldStep,
    GarmentState,
    Grasp,
    GraspId,
    PredictedShape,
    Table,
    tool_rotation,
)

TABLE = Table(-0.10, (0.20, 1.00), (-0.70, 0.70))
DOWN_TO_TABLE = 0.012


def calibration() -> CameraCalibration:
    k = Intrinsics(640, 480, 577.0, 579.0, 319.5, 239.5)
    eye, target = np.array([0.12, 0.0, 1.05]), np.array([0.6, 0.0, 0.0])
    z = (target - eye) / np.linalg.norm(target - eye)
    x = np.array([0.0, -1.0, 0.0])
    T = np.eye(4)
    T[:3, :3] = np.column_stack([x, np.cross(z, x), z])
    T[:3, 3] = eye
    return CameraCalibration(k, T)


@dataclass(frozen=True, eq=False)
class Towel:
    """A grid of nx x ny vertices, 0.40 x 0.60 m, centred on (0.6, 0)."""

    material: Array
    triangles: np.ndarray

    @classmethod
    def make(cls, nx: int = 25, ny: int = 37) -> Towel:
        x, y = np.meshgrid(np.linspace(0.4, 0.8, nx), np.linspace(-0.3, 0.3, ny), indexing="ij")
        i, j = np.meshgrid(np.arange(nx - 1), np.arange(ny - 1), indexing="ij")
        a = (i * ny + j).ravel()
        triangles = np.vstack([np.column_stack([a, a + ny, a + 1]), np.column_stack([a + 1, a + ny, a + ny + 1])])
        return cls(np.column_stack([x.ravel(), y.ravel()]), triangles.astype(np.int32))

    def shape(self, vertices: Array) -> PredictedShape:
        return PredictedShape(vertices, self.triangles, self.material)


def turned(vertices: Array, line: FoldLine, angle: float, lift: float) -> Array:
    """The vertices with the moving part turned about the line by `angle` [rad]. At pi it lies `lift` higher
    [m]."""
    d = line.signed_distance(vertices[:, :2])
    moving = d > 0
    out = vertices.copy()
    bend = angle * np.clip(0.35 + d / 0.12, 0.0, 1.0)[moving]
    out[moving, :2] -= np.outer(d[moving] * (1.0 - np.cos(bend)), line.normal)
    out[moving, 2] += d[moving] * np.sin(bend) + lift * (1.0 - np.cos(angle)) / 2.0
    return out


def steps() -> tuple[FoldStep, FoldStep]:
    """Two folds: far edge onto near edge, then left half onto right half."""
    first = FoldLine(np.array([0.6, 0.0]), np.array([0.0, -1.0]))
    second = FoldLine(np.array([0.5, 0.0]), np.array([1.0, 0.0]))
    return (
        FoldStep(
            "far half over", 0, first, (),
            {GraspId.LEFT: Grasp(np.array([0.79, 0.28]), -0.8, 1, 0.0),
             GraspId.RIGHT: Grasp(np.array([0.79, -0.28]), 0.8, 1, 0.0)},
            {GraspId.LEFT: np.array([0.41, 0.28, 0.01]), GraspId.RIGHT: np.array([0.41, -0.28, 0.01])},
        ),
        FoldStep(
            "left half over", 1, second, (first,),
            {GraspId.LEFT: Grasp(np.array([0.50, 0.29]), 1.57, 2, 0.002)},
            {GraspId.LEFT: np.array([0.50, -0.29, 0.012])},
        ),
    )  # fmt: skip


def arc(step: FoldStep, grasp_id: GraspId, n: int = 40) -> Array:
    """Half circle (n, 3) from grasp to target."""
    s = np.linspace(0.0, 1.0, n)
    p0, p3 = np.append(step.grasps[grasp_id].point, DOWN_TO_TABLE), step.targets[grasp_id]
    radius = np.linalg.norm(p3[:2] - p0[:2]) / 2.0
    u = (1.0 - np.cos(np.pi * s)) / 2.0
    out = p0 + np.outer(u, p3 - p0)
    out[:, 2] += 0.75 * radius * np.sin(np.pi * s)
    return out


def picture(vertices: Array, towel: Towel, sequence: int, t: float, seed: int = 0) -> CameraFrame:
    """A camera picture: the towel's silhouette on a wooden table."""
    c = calibration()
    T = np.linalg.inv(c.T_table_camera)
    p = vertices @ T[:3, :3].T + T[:3, 3]
    uv = (p[:, :2] / p[:, 2:]) * [c.intrinsics.fx, c.intrinsics.fy] + [c.intrinsics.cx, c.intrinsics.cy]
    noise = np.random.default_rng(seed + sequence).integers(-6, 7, (480, 640, 1))
    rgb = np.full((480, 640, 3), (168, 140, 108), dtype=np.int64)
    mask = silhouette(uv, towel.triangles, (480, 640))
    rgb[mask] = (70, 110, 165)
    rgb = cv2.GaussianBlur((rgb + noise).clip(0, 255).astype(np.uint8), (3, 3), 0)
    depth = np.full((480, 640), 1.1, dtype=np.float32)
    depth[:4] = np.nan
    return CameraFrame(t, sequence, rgb, depth, c.intrinsics)


def silhouette(uv: Array, triangles: np.ndarray, shape: tuple[int, int]) -> np.ndarray:
    mask = np.zeros(shape, dtype=np.uint8)
    cv2.fillPoly(mask, list(np.round(uv[triangles]).astype(np.int32)), 1)
    mask = cv2.morphologyEx(mask, cv2.MORPH_CLOSE, np.ones((3, 3), np.uint8))
    return mask.astype(bool)


class Puppet:
    """Joint angles that bring the tools to the places of the synthetic run."""

    def __init__(self) -> None:
        self.model = load_model()
        left = np.array([0.9, -0.9, -0.3, 1.9, 0.3, 0.6, 0.0])
        self.park = np.concatenate([left, left * [-1, 1, -1, 1, -1, 1, -1]])
        self.q = self.park.copy()

    def reach(self, side: Side, point: Array, heading: float) -> Array:
        """Joint angles (7,) nearest to the present ones. The arm stays where it is if the point is out of
        reach."""
        part = slice(0, 7) if side is Side.LEFT else slice(7, 14)
        T = np.eye(4)
        T[:3, :3] = tool_rotation(np.array([heading]), np.array([0.0]), np.array([0.0]))[0]
        T[:3, 3] = point + np.array([0.0, 0.0, TABLE.height])
        rng = np.random.default_rng(5)
        seeds = self.q[part] + np.vstack([np.zeros(7), rng.normal(0, 0.5, (40, 7))])
        found = solve_seeds(self.model, side, T, seeds)
        if len(found) == 0:
            return self.q[part]
        return found[np.argmin(np.linalg.norm(found - self.q[part], axis=1))]


def play(
    recorder: Recorder, folds: int = 2, rate: float = 100.0, truth_rate: float = 30.0
) -> tuple[float, list[Array]]:
    """Record a whole run. Returns its length [s] and the towel at the end of each fold."""
    show = _Show(recorder, rate, truth_rate)
    show.begin()
    for step in steps()[:folds]:
        show.fold(step)
    show.state(State.FOLDED)
    show.wait(1.0)
    return show.t, show.ends


class _Show:
    def __init__(self, recorder: Recorder, rate: float, truth_rate: float) -> None:
        self.r, self.dt, self.every = recorder, 1.0 / rate, max(1, round(rate / truth_rate))
        self.t, self.tick, self.sequence = 0.0, 0, 0
        self.towel, self.puppet = Towel.make(), Puppet()
        m = self.towel.material
        self.vertices = np.column_stack([m, np.full(len(m), 0.001)])
        self.grip = {s: 0.0 for s in Side}
        self.opening = {s: 0.04 for s in Side}
        self.ends: list[Array] = []
        self.rng = np.random.default_rng(1)

    def state(self, state: State) -> None:
        self.r.state(self.t, state.value)
        self.r.event(self.t, f"-> {state.value}")

    def advance(self) -> None:
        self.t += self.dt
        self.tick += 1
        q = self.puppet.q
        self.r.joints(JointState(self.t, q.copy(), np.zeros(14), np.zeros(14), 0.0))
        for s in Side:
            noise = self.rng.normal(0, 0.02, 8)
            self.r.gripper(GripperState(self.t, s, self.opening[s], self.grip[s], False, True))
            cells = np.full((2, 3, 2), self.grip[s] / 6.0) + noise[:6].reshape(3, 2) * 0.1
            self.r.tactile(TactileReading(self.t, s, cells, np.abs(noise[6:])))
        if self.tick % self.every == 0:
            self.r.garment_truth(self.t, self.vertices, self.towel.triangles)

    def wait(self, seconds: float) -> None:
        for _ in range(round(seconds / self.dt)):
            self.advance()

    def move(self, q: Array, seconds: float) -> None:
        q0, n = self.puppet.q.copy(), max(1, round(seconds / self.dt))
        for k in range(1, n + 1):
            s = 0.5 - 0.5 * np.cos(np.pi * k / n)
            self.puppet.q = q0 + s * (q - q0)
            self.advance()

    def look(self, state: State) -> CameraFrame:
        self.state(state)
        self.wait(0.4)
        self.sequence += 1
        frame = picture(self.vertices, self.towel, self.sequence, self.t)
        self.r.camera(self.t, frame, calibration())
        return frame

    def begin(self) -> None:
        for state in (State.PREPARING, State.PHOTOGRAPHING, State.AWAITING_GARMENT):
            self.state(state)
            self.wait(0.5)
        frame = self.look(State.LOOKING)
        self.state(State.RECOGNISING)
        self.wait(1.0)
        self.r.perception(self.t, *seen(frame), frame.rgb, lambda: frame.rgb)
        self.state(State.PLANNING)
        self.wait(0.3)

    def fold(self, step: FoldStep) -> None:
        self.r.plan(self.t, step)
        self.state(State.OPTIMISING)
        for k in range(8):
            best = 0.03 * np.exp(-0.5 * k) + 0.006
            tried = {i: arc(step, i) * (1.0, 1.0, 1.0 + 0.05 * k) for i in step.grasps}
            own = best if k % 2 == 0 else 1.3 * best
            self.r.candidate(self.t, 6 * k, tried, (own, 1.4 + 1e3 * own), (best, 1.4 + 1e3 * best))
            self.wait(0.2)
        start = self.vertices
        end = turned(start, step.line, np.pi, 0.003 * (step.index + 1))
        self.r.predicted(self.t, self.towel.shape(end + np.array([0.004, 0.006, 0.002])))
        arcs = {i.planned_arm: arc(step, i) for i in step.grasps}
        self.r.arcs(self.t, arcs)
        self.state(State.PLANNING_MOTION)
        self.wait(0.5)
        self.state(State.APPROACHING)
        self.move(self.hands({s: a[0] + [0, 0, 0.12] for s, a in arcs.items()}, step), 2.0)
        self.state(State.GRASPING)
        self.move(self.hands({s: a[0] for s, a in arcs.items()}, step), 1.0)
        for s in arcs:
            self.opening[s], self.grip[s] = 0.001, 6.0
        if step.index == 0:
            self.r.event(self.t, "right: missed_grasp: 0.1 N between the pads, 2.1 N expected", "WARN")
        self.wait(0.4)
        self.state(State.FOLDING)
        n = 40
        for k in range(n):
            angle = np.pi * (k + 1) / n
            self.vertices = turned(start, step.line, angle, 0.003 * (step.index + 1))
            self.move(self.hands({s: a[k] for s, a in arcs.items()}, step), 0.1)
        self.vertices = end
        self.state(State.RELEASING)
        for s in arcs:
            self.opening[s], self.grip[s] = 0.02, 0.0
        self.wait(0.4)
        self.state(State.RETREATING)
        self.move(self.hands({s: a[-1] + [0, 0, 0.12] for s, a in arcs.items()}, step), 0.8)
        self.move(self.puppet.park, 1.5)
        self.look(State.LOOKING_AFTER)
        self.state(State.INSPECTING)
        self.wait(0.4)
        hull = cv2.convexHull(end[:, :2].astype(np.float32))[:, 0, :].astype(np.float64)
        self.r.observed(self.t, hull)
        self.r.event(self.t, f"{step.name}: accepted, IoU 0.94")
        self.wait(0.4)
        self.ends.append(self.vertices)

    def hands(self, points: dict[Side, Array], step: FoldStep) -> Array:
        q = self.puppet.park.copy()
        headings = {i.planned_arm: grasp.heading for i, grasp in step.grasps.items()}
        for s, p in points.items():
            q[slice(0, 7) if s is Side.LEFT else slice(7, 14)] = self.puppet.reach(s, p, headings[s])
        return q


def seen(frame: CameraFrame) -> tuple[GarmentState, np.ndarray]:
    """The towel before the first fold."""
    corners = {
        "near_left": (0.4, 0.3), "near_right": (0.4, -0.3), "far_right": (0.8, -0.3), "far_left": (0.8, 0.3)
    }  # fmt: skip
    keypoints = {k: np.array(v) for k, v in corners.items()}
    contour = np.array([corners[k] for k in ("near_right", "far_right", "far_left", "near_left")])
    mask = (frame.rgb[:, :, 2] > frame.rgb[:, :, 0]) & (frame.rgb[:, :, 2] > 120)
    return GarmentState("towel", contour, keypoints, 0.97), mask


def record(path, live=False, robot=None, folds=2) -> RecordingLosses:  # type: ignore[no-untyped-def]
    """A complete recording of the synthetic run."""
    recorder = Recorder.open(path, "synthetic", TABLE, live=live, robot=robot)
    play(recorder, folds)
    return recorder.close()
