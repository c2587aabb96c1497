"""Records of runs for tests. A test names only the values that it is about."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from foldcell.cell.config.cell_settings import load_settings
from foldcell.cell.operator.console.run_status import RunStatus
from foldcell.cell.record.run_record import RunRecord, ScoreRecord
from foldcell.cell.record.run_record_builder import RunRecordBuilder
from foldcell.cell.states.fold_request import FoldRequest
from foldcell.cell.states.transition_table import State


def run_record(**changes: Any) -> RunRecord:
    """The record of a simulated run that folded a towel, without folds and score."""
    values: dict[str, Any] = {
        "garment": "medium_towel", "seed": 7, "driver": "sim", "simulated": True, "world": "xpbd",
        "result": "folded", "state": State.FOLDED, "failure": None, "score": None, "steps": (),
        "robot_time_s": 81.4, "wall_time_s": 33.2, "stage_times_s": {}, "run_dir": "/logs/run-1",
    }  # fmt: skip
    return RunRecord(**{**values, **changes})


def score_record(limits: dict[str, float] | None = None, **figures: Any) -> ScoreRecord:
    """A score that is passed unless `figures` say otherwise."""
    return ScoreRecord(**{"passed": True, "shape": True, "flat": True, "limits": limits or {}, **figures})


def record_builder(
    garment: str = "small_towel", seed: int = 3, simulated: bool = True, resumed_from: str | None = None
) -> RunRecordBuilder:
    request = FoldRequest(garment, seed, "sim" if simulated else "ros", load_settings(), Path("/logs"))
    return RunRecordBuilder(request, simulated, Path("/logs/run-1"), 0.0, resumed_from)


def run_status(garment: str = "small_towel", seed: int = 3, simulated: bool = True) -> RunStatus:
    """The status of a run, without observers of the runner before it."""
    return RunStatus(record_builder(garment, seed, simulated))
