"""Measures how the arms' errors (lag, jitter, sudden dips) affect a fold, by whole runs with scaled errors.

    foldcell bench execution        or  python -m benchmarks.execution

The lag, the jitter and the depth of sudden dips of an arm (`drop_depth` in cell/simulation/noise.yaml) are
multiplied by 0, 1 and 2. Apart from this, the runs at the three scales are the same: a seed determines the
garment, all other noise, and the times of the dips. Everything is simulated. The sizes of the errors in noise.yaml
are assumed.
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np

from foldcell.cell.config.cell_settings import load_settings
from foldcell.cell.control import loop
from foldcell.cell.control.checks import ExecutionLimits
from foldcell.cell.control.motion import Motion
from foldcell.cell.control.motions import hold_position, trajectory
from foldcell.cell.control.ticks import TICK_S
from foldcell.cell.record.run_record import RunRecord
from foldcell.cell.runs.fold_run import FoldRequest, fold_once
from foldcell.cell.simulation.noise import NoiseTable, Range, load_noise
from foldcell.robots.baxter.robot import load_model
from foldcell.robots.model import RobotModel
from foldcell.robots.ports import Array, JointSetpoint, JointState, Ports, Side, arm_slice
from foldcell.skills.motion.kinematics.ik import tool_pose
from foldcell.skills.vocabulary import Outcome

__all__ = ["measure", "scaled_errors"]

GARMENT = "medium_towel"
SCALES = (0, 1, 2)
SCORES = ("iou", "correspondence_m", "edges_m", "drift_m")


def scaled_errors(noise: NoiseTable, scale: float) -> NoiseTable:
    """Return the noise table with lag, jitter and depth of sudden dips multiplied by `scale`."""
    robot = noise.robot
    lag, depth = (Range(scale * r.low, scale * r.high) for r in (robot.lag, robot.drop_depth))
    return replace(noise, robot=replace(robot, lag=lag, jitter=scale * robot.jitter, drop_depth=depth))


def measure(tell: Callable[[str], None], *, peers: bool, quick: bool) -> dict[str, Any]:
    """Perform the runs. Return one flat mapping of figures with units in the keys, most of them means over the
    seeds at each scale. quick: one seed."""
    seeds = range(1 if quick else 5)
    return compare(tell, seeds)


def compare(tell: Callable[[str], None], seeds: range) -> dict[str, Any]:
    figures: dict[str, Any] = {"garment": GARMENT, "seeds": len(seeds), "simulated": True}
    model = load_model()
    for scale in SCALES:
        runs = [_fold(model, seed, scale) for seed in seeds]
        name = f"errors_x{scale}"
        figures[f"{name}_folded"] = sum(result.result == "folded" for result, _ in runs)
        recovered = [text for result, _ in runs for step in result.steps for text in step.recoveries]
        figures |= {f"{name}_recoveries": len(recovered), f"{name}_recovered_from": recovered}
        scores = [result.score for result, _ in runs if result.score]
        for key in SCORES:
            figures[f"{name}_{key}"] = float(np.mean([getattr(s, key) for s in scores])) if scores else None
        off = 1e3 * np.concatenate([tools for _, tools in runs])
        figures[f"{name}_tool_error_mm_rms"] = float(np.sqrt((off**2).mean()))
        figures[f"{name}_tool_error_mm_p99"] = float(np.quantile(off, 0.99))
        figures[f"{name}_tool_error_mm_max"] = float(off.max())
        tell(f"errors x {scale}: {figures[f'{name}_folded']} of {len(seeds)} folded")
    return figures


def _fold(model: RobotModel, seed: int, scale: float) -> tuple[RunRecord, Array]:
    """Perform one run. Return its result, and the distances (n,) between commanded and measured position of the
    tools [m], two for every tick of the arms' motions."""
    noise = scaled_errors(load_noise(), scale)
    with (
        tempfile.TemporaryDirectory() as folder,
        patch("foldcell.cell.simulation.world.load_noise", lambda: noise),
        _tools_watched(model) as off,
    ):
        request = FoldRequest(GARMENT, seed, "sim", load_settings(), None, Path(folder), quiet=True, record=False)
        result = fold_once(request)
    return result, np.array(off)


@contextmanager
def _tools_watched(model: RobotModel) -> Iterator[list[float]]:
    """Collect, for both tools and every set-point of a motion, the distance between the commanded position and the
    position measured when the command is sent [m]. With ideal arms, only the error of the encoders remains."""
    off: list[float] = []
    before: JointState | None = None
    streamed = False
    judged = loop.followed

    def followed(ports: Ports, q: Array, sent: JointSetpoint, limits: ExecutionLimits) -> Outcome[JointState]:
        nonlocal before
        read = judged(ports, q, sent, limits)
        if not streamed:
            return read
        if before is not None and sent.stamp - before.stamp < TICK_S / 2:  # not the first set-point
            for side in Side:
                cut, chain = arm_slice(side, 14), model.chains[side]
                gap = tool_pose(chain, before.q[cut]) - tool_pose(chain, q[cut])
                off.append(float(np.linalg.norm(gap[:3, 3])))
        before = read.value
        return read

    def noted(motion: Callable[..., Motion[JointState]]) -> Callable[..., Motion[JointState]]:
        """Wrap a motion, so that set-points count only while such a motion runs. Those of the grasping hands do
        not count."""

        def run(*given: Any) -> Motion[JointState]:
            nonlocal streamed
            streamed = True
            try:
                return (yield from motion(*given))
            finally:
                streamed = False

        return run

    with (
        patch.object(loop, "followed", followed),
        patch.object(trajectory, "follow", noted(trajectory.follow)),
        patch.object(hold_position, "stand", noted(hold_position.stand)),
    ):
        yield off


if __name__ == "__main__":
    for name, value in compare(print, range(2)).items():
        print(f"{name:<36} {value:.4g}" if isinstance(value, float) else f"{name:<36} {value}")
