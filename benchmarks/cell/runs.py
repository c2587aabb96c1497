"""Measures the wall time of whole runs by activity, and the cost of recording, live display and checkpoints."""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any
from unittest.mock import patch

from foldcell.cell.config.cell_settings import load_settings
from foldcell.cell.record.run_record import RunRecord
from foldcell.cell.runs.checkpoint_writer import CheckpointWriter
from foldcell.cell.runs.fold_run import fold_once
from foldcell.cell.states.fold_request import FoldRequest
from foldcell.cell.states.observers import Step
from foldcell.cell.states.run_context import Result
from foldcell.cell.states.transition_table import Effect

GARMENT, SEED = "small_towel", 1
KINDS: dict[str, dict[str, Any]] = {
    "run": {},
    "bare_run": {"record": False, "record_truth": False},
    "shown_run": {"live": True},
}
"""The kinds of run that are compared: one with all its output; one without recording, report, truth and score; and
one with a live stream that nobody reads."""
SEEING = frozenset({Effect.PHOTOGRAPH_TABLE, Effect.LOOK, Effect.RECOGNISE, Effect.INSPECT})
THINKING = frozenset({Effect.PLAN_FOLDS, Effect.CHOOSE_TRAJECTORY, Effect.PLAN_MOTION})


class _Walls:
    """Observer of the runner that measures the wall time within effects, by kind of effect [s]."""

    def __init__(self) -> None:
        self.seconds = {"seeing": 0.0, "thinking": 0.0, "moving": 0.0}
        self.effects = 0
        self._began = 0.0

    def entered(self, t: float, step: Step) -> None:
        self._began = time.perf_counter()

    def performed(self, t: float, step: Step, result: Result) -> None:
        does = "seeing" if step.effect in SEEING else "thinking" if step.effect in THINKING else "moving"
        self.seconds[does] += time.perf_counter() - self._began
        self.effects += 1


def measure(tell: Callable[[str], None], rounds: int) -> dict[str, Any]:
    """Perform `rounds` rounds, each with one run of each kind, after a run that warms up. Return the figures of
    the fastest run of each kind."""
    _fold({}, _Walls())
    best: dict[str, tuple[float, RunRecord, _Walls, list[float]]] = {}
    for n in range(rounds):
        for kind, options in KINDS.items():
            walls = _Walls()
            with _keeping_timed() as kept:
                began = time.perf_counter()
                result = _fold(options, walls)
                took = time.perf_counter() - began
            if kind not in best or took < best[kind][0]:
                best[kind] = took, result, walls, kept
        tell(f"round {n + 1} of {rounds}: " + ", ".join(f"{k} {took:.1f} s" for k, (took, *_) in best.items()))
    wall, result, walls, kept = best["run"]
    figures: dict[str, Any] = {"garment": GARMENT, "seed": SEED, "result": result.result, "rounds": rounds}
    figures |= {f"{kind}_wall_s": took for kind, (took, *_) in best.items()}
    figures |= {"robot_s": result.robot_time_s, "robot_over_wall_x": result.robot_time_s / wall}
    figures |= {f"{does}_wall_s": seconds for does, seconds in walls.seconds.items()}
    figures["around_effects_wall_s"] = wall - sum(walls.seconds.values())
    figures["recording_costs_percent"] = 100.0 * (wall / figures["bare_run_wall_s"] - 1.0)
    figures["showing_costs_percent"] = 100.0 * (figures["shown_run_wall_s"] / wall - 1.0)
    figures["keeping_ms_per_effect"] = 1e3 * sum(kept) / len(kept)
    figures["keeping_costs_percent"] = 100.0 * sum(kept) / wall
    return figures


def _fold(options: dict[str, Any], walls: _Walls) -> RunRecord:
    with tempfile.TemporaryDirectory() as folder:
        request = FoldRequest(GARMENT, SEED, "sim", load_settings(), Path(folder), quiet=True, **options)
        return fold_once(request, observers=(walls,))


@contextmanager
def _keeping_timed() -> Iterator[list[float]]:
    """Collect the duration of each write of a checkpoint [s] while the context is open."""
    took: list[float] = []
    keep = CheckpointWriter.keep

    def timed(self: CheckpointWriter, context: Any) -> None:
        began = time.perf_counter()
        keep(self, context)
        took.append(time.perf_counter() - began)

    with patch.object(CheckpointWriter, "keep", timed):
        yield took
