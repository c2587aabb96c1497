"""Plans all folds, and checks the plans by methods that are independent of the planner."""

from __future__ import annotations

import time
from collections import Counter, defaultdict
from collections.abc import Callable
from typing import Any

import numpy as np
import pinocchio as pin
import toppra
import toppra.algorithm
import toppra.constraint
from scipy.interpolate import CubicSpline
from scipy.spatial import cKDTree

from benchmarks.motion.peers import clearance
from benchmarks.motion.workload import Task, tasks
from foldcell.cell.config.cell_settings import CellSettings
from foldcell.robots.model import JointLimits, RobotModel
from foldcell.robots.ports import ArmTrajectory, Array, Side, arm_slice
from foldcell.skills.motion.moves.fold import FoldMotion, plan_hands_motion
from foldcell.skills.motion.timing import timing
from foldcell.skills.motion.validation.collision import CollisionChecker
from foldcell.skills.vocabulary import ToolPath

FINE = 0.001
"""Sampling period at which limits are checked [s]."""
DEVIATION_SAMPLE = 0.005
CLEARANCE_STEP = 0.08
"""Joint motion between two poses at which the clearance is measured [rad]."""
GRID = 200
"""Number of intervals of a path in TOPP-RA."""
PATH_SAMPLES = 120
"""Number of samples of a path of which the fastest motion is computed."""
MEASURED = 12
"""Number of poses of the garment for which the plan of each fold is measured in detail."""


Findings = defaultdict[str, list[float]]
"""What was measured in all folds -> one number per fold, or per part of its motion."""


def measure_folds(
    tell: Callable[[str], None], model: RobotModel, settings: CellSettings, poses: int, measured: int = MEASURED
) -> dict[str, Any]:
    """Plan all folds and return the figures. poses: number per garment; the plans for the first `measured` of them
    are measured in detail."""
    checker = CollisionChecker(model, settings.table)
    limits = model.limits(settings.motion.accelerations, settings.motion.velocity_scale)
    ruler = _Ruler(model, settings, limits)
    found, refused, seen = Findings(list), Counter[str](), Counter[str]()
    first = next(tasks(1, settings.surface))
    _planned(first, model, checker, settings, limits, Findings(list), Counter())  # compiles
    for task in tasks(poses, settings.surface):
        seen[task.name] += 1
        if seen[task.name] == 1:
            tell(f"{task.name}: {poses} poses")
        motion = _planned(task, model, checker, settings, limits, found, refused)
        if motion is not None and seen[task.name] <= measured:
            ruler.measure(task, motion, found)
    return _figures(found, seen.total(), refused)


def _planned(
    task: Task,
    model: RobotModel,
    checker: CollisionChecker,
    settings: CellSettings,
    limits: JointLimits,
    found: Findings,
    refused: Counter[str],
) -> FoldMotion | None:
    start = time.thread_time()
    outcome = plan_hands_motion(
        model, checker, settings.table, task.paths, model.q_park, limits=limits,
        tool_speed=min(task.garment.max_tool_speed, settings.motion.tool_speed),
        approach_height=settings.motion.approach_height, rng=np.random.default_rng(1),
    )  # fmt: skip
    found["cpu_ms"].append(1e3 * (time.thread_time() - start))
    if outcome.failure is None:
        return outcome.unwrap()
    failure = outcome.failure
    binding = failure.values.get("binding")
    why = f"{binding['constraint']} ({binding['what']})" if binding else failure.what
    refused[f"{task.name}: {failure.kind}, {why}"] += 1
    return None


class _Ruler:
    """Measures a plan: shares of the limits at 1 ms samples, tool positions by Pinocchio, clearance without
    margins, and durations relative to those of TOPP-RA."""

    def __init__(self, model: RobotModel, settings: CellSettings, limits: JointLimits) -> None:
        self.model, self.table, self.limits = model, settings.table, limits
        self.plain = CollisionChecker(
            model, settings.table, body_margin=0.0, table_margin=0.0, fingertip_margin=0.0
        )
        self.data = model.pin_model.createData()
        self.frames = {side: model.pin_model.getFrameId(model.tool_frame[side]) for side in Side}
        self.tool_speed = settings.motion.tool_speed

    def measure(self, task: Task, motion: FoldMotion, found: Findings) -> None:
        parts = {"approach": motion.approach, "fold": motion.fold, "retreat": motion.retreat, "park": motion.park}
        for name, part in parts.items():
            shares = peak_shares(part, self.limits)
            found["velocity"].append(shares[0])
            found["acceleration"].append(shares[1])
            found["jerk"].append(shares[2])
            found["clearance"].append(self._clearance(part.q, fingertips=name in ("fold", "retreat")))
            self._stop(part, found)
        found["clearance"].append(self._clearance(self._down(motion), fingertips=True))
        intended = {side: task.paths[p.path] for side, p in motion.postures.items()}
        found["deviation"].append(self._deviation(motion.fold, intended))
        self._times(task, motion, found)

    def _times(self, task: Task, motion: FoldMotion, found: Findings) -> None:
        """Compare three durations with that of the fastest motion without a jerk limit: (1) the fold's path,
        timed with the arms' limits only; (2) the fold, with the cloth's speed limit as well; (3) each free
        motion, with the arms' limits."""
        path, at = evenly(motion.fold)
        lengths = [_travelled(motion.tool_paths[side].position) for side in motion.postures]
        tools = np.stack([np.interp(at, motion.fold.t, x) for x in lengths], axis=1)
        found["ratio"].append(timing.time_path(path, self.limits).duration / fastest(path, self.limits))
        speed = min(task.garment.max_tool_speed, self.tool_speed)
        found["ratio_cloth"].append(motion.fold.duration / fastest(path, self.limits, tools, speed))
        for free in (motion.approach, motion.park):
            if np.abs(free.q[-1] - free.q[0]).max() > 0.05:
                found["ratio_free"].append(free.duration / fastest(evenly(free)[0], self.limits))

    def _deviation(self, fold: ArmTrajectory, intended: dict[Side, ToolPath]) -> float:
        """Largest distance [m] of a tool's position, computed by Pinocchio, from its intended curve, which is a
        spline through the points of its path."""
        q = hermite(fold, np.arange(0.0, fold.duration, DEVIATION_SAMPLE))[0]
        at = {side: np.empty((len(q), 3)) for side in intended}
        for i, x in enumerate(q):
            pin.forwardKinematics(self.model.pin_model, self.data, self.model.configuration(x))
            for side in intended:
                pin.updateFramePlacement(self.model.pin_model, self.data, self.frames[side])
                at[side][i] = self.data.oMf[self.frames[side]].translation
        worst = 0.0
        for side, path in intended.items():
            curve = path.position + np.array([0.0, 0.0, self.table.height])
            s = _travelled(curve)
            moving = np.concatenate([[True], np.diff(s) > 1e-7])
            fine = CubicSpline(s[moving], curve[moving])(np.linspace(0.0, s[-1], 4000))
            worst = max(worst, _nearest(fine, at[side]))
        return worst

    def _down(self, motion: FoldMotion) -> Array:
        """Sample the joints (n, 14) while both hands descend simultaneously to the planned grasps."""
        q = np.tile(motion.q_above, (30, 1))
        for side, way in motion.descend.items():
            q[:, arm_slice(side, 14)] = [way.at(x) for x in np.linspace(0.0, way.grasp_depth, len(q))]
        return q

    def _clearance(self, q: Array, fingertips: bool) -> float:
        travelled = np.concatenate([[0.0], np.cumsum(np.abs(np.diff(q, axis=0)).max(axis=1))])
        marks = np.searchsorted(travelled, np.arange(0.0, travelled[-1] + CLEARANCE_STEP, CLEARANCE_STEP))
        q = q[np.unique(np.minimum(marks, len(q) - 1))]
        return min(clearance(self.plain, x, allow_fingertips=fingertips) for x in q)

    def _stop(self, part: ArmTrajectory, found: Findings) -> None:
        for share in (0.1, 0.3, 0.5, 0.7, 0.9):
            warp = timing.ClockWarp(share * part.duration, timing.STOP_TIME, 0.0)
            stop = timing.warped(part, timing.warp_clock(part, warp, self.model.protective))
            found["stop_s"].append(stop.duration)
            found["stop_share"].append(max(peak_shares(stop, self.model.protective)))


def evenly(motion: ArmTrajectory) -> tuple[Array, Array]:
    """Sample a motion at even steps along its joint path, so that its timing has no effect. Return the joints
    (n, 14) and the times (n,) [s]."""
    s = _travelled(motion.q)
    at = np.interp(np.linspace(0.0, s[-1], PATH_SAMPLES), s, motion.t)
    return hermite(motion, at)[0], at


def hermite(trajectory: ArmTrajectory, t: Array) -> tuple[Array, Array, Array, Array]:
    """Evaluate the cubic Hermite interpolant at times t (n,), in the power basis: q, qd, qdd, qddd (n, 14)."""
    i = np.clip(np.searchsorted(trajectory.t, t, side="right") - 1, 0, len(trajectory.t) - 2)
    h, x = np.diff(trajectory.t)[i][:, None], (t - trajectory.t[i])[:, None]
    p, v = trajectory.q[i], trajectory.qd[i]
    rise, end = (trajectory.q[i + 1] - p) / h, trajectory.qd[i + 1]
    c2, c3 = (3.0 * rise - 2.0 * v - end) / h, (v + end - 2.0 * rise) / h**2
    return p + x * (v + x * (c2 + x * c3)), v + x * (2 * c2 + 3 * x * c3), 2 * c2 + 6 * x * c3, 6.0 * c3


def peak_shares(trajectory: ArmTrajectory, limits: JointLimits) -> tuple[float, float, float]:
    """Compute the largest shares of the limits of velocity, acceleration and jerk that a motion uses, at 1 ms
    samples."""
    t = np.append(np.arange(0.0, trajectory.duration, FINE), trajectory.duration)
    _, qd, qdd, jerk = hermite(trajectory, t)
    return (
        float((np.abs(qd) / limits.velocity).max()),
        float((np.abs(qdd) / limits.acceleration).max()),
        float((np.abs(jerk) / limits.jerk).max()),
    )


def fastest(path: Array, limits: JointLimits, tools: Array | None = None, speed: float = 1.0) -> float:
    """Shortest duration [s] by TOPP-RA along the spline through path (n, 14), without jerk limit; NaN if it fails.
    tools: (n, k) distances that k tools have travelled [m], none of them faster than `speed` [m/s]."""
    extra = np.zeros((len(path), 0)) if tools is None else tools
    v = np.append(limits.velocity, np.full(extra.shape[1], speed))
    a = np.append(limits.acceleration, np.full(extra.shape[1], 1e3))
    step = np.maximum(np.abs(np.diff(path, axis=0) / limits.velocity).max(axis=1), 1e-9)
    s = np.concatenate([[0.0], np.cumsum(step)])
    constraints = [
        toppra.constraint.JointVelocityConstraint(np.stack([-v, v], axis=1)),
        toppra.constraint.JointAccelerationConstraint(np.stack([-a, a], axis=1)),
    ]
    curve = toppra.SplineInterpolator(s, np.hstack([path, extra]))
    solver = toppra.algorithm.TOPPRA(constraints, curve, gridpoints=np.linspace(0.0, s[-1], GRID + 1))
    data = solver.compute_parameterization(0.0, 0.0, return_data=True)
    rate = data[1] if data is not None else None
    if rate is None or not np.all(np.isfinite(rate)):
        return float("nan")
    return float((2.0 * (s[-1] / GRID) / np.maximum(rate[1:] + rate[:-1], 1e-9)).sum())


def _travelled(position: Array) -> Array:
    return np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(position, axis=0), axis=1))])


def _nearest(curve: Array, points: Array) -> float:
    """Largest distance of points (n, 3) from the polyline `curve` (m, 3) [m]."""
    _, nearest = cKDTree(curve).query(points)
    gaps = []
    for k in (np.clip(nearest - 1, 0, len(curve) - 2), np.clip(nearest, 0, len(curve) - 2)):
        a, d = curve[k], curve[k + 1] - curve[k]
        u = np.clip(((points - a) * d).sum(axis=1) / np.maximum((d**2).sum(axis=1), 1e-18), 0.0, 1.0)
        gaps.append(np.linalg.norm(points - a - u[:, None] * d, axis=1))
    return float(np.min(gaps, axis=0).max())


def _figures(found: Findings, folds: int, refused: Counter[str]) -> dict[str, Any]:
    def at(name: str, share: float) -> float:
        return float(np.nanpercentile(found[name], share)) if found[name] else float("nan")

    return {
        "folds": folds,
        "planned_rate": 1.0 - refused.total() / folds,
        "binding_constraints": dict(refused),
        "planning_ms_median": at("cpu_ms", 50),
        "planning_ms_p90": at("cpu_ms", 90),
        "planning_ms_max": at("cpu_ms", 100),
        "time_ratio_median": at("ratio", 50),
        "time_ratio_p90": at("ratio", 90),
        "time_ratio_as_cloth_bears_median": at("ratio_cloth", 50),
        "time_ratio_free_moves_median": at("ratio_free", 50),
        "velocity_utilisation_max": at("velocity", 100),
        "acceleration_utilisation_max": at("acceleration", 100),
        "jerk_utilisation_max": at("jerk", 100),
        "utilisation_max": max(at(name, 100) for name in ("velocity", "acceleration", "jerk")),
        "path_deviation_mm_max": 1e3 * at("deviation", 100),
        "path_deviation_mm_median": 1e3 * at("deviation", 50),
        "clearance_m_min": at("clearance", 0),
        "stop_s_max": at("stop_s", 100),
        "stop_utilisation_max": at("stop_share", 100),
    }
