"""Request and result of a run: the contract of `foldcell fold`."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from cell.config.cell_settings import CellSettings
from cell.support.json_values import to_json
from cell.support.process.terminations import BY_SIGNAL

__all__ = ["EXIT_CODES", "FoldRequest", "FoldResult"]

EXIT_CODES = {"folded": 0, "not_folded": 2, "fault": 3}


@dataclass(frozen=True)
class FoldRequest:
    """The request for a run.

    garment: a name, a file, or 'auto'. approve: an operator approves each fold and is asked after failures.
    terminal: letters typed in the terminal are commands. page: serve the operator's page, with the live view, on
    page_port (0: a free port). quiet: no progress lines. record: write recording, transcript and report.
    record_truth: record and score the true state of a simulated cell, which does not change the run's decisions.
    """

    garment: str
    seed: int
    driver: str
    settings: CellSettings
    settings_path: Path | None
    logs: Path
    live: bool | str = False
    approve: bool = False
    terminal: bool = True
    page: bool = False
    page_port: int = 0
    realtime: bool = False
    world: str = "xpbd"
    quiet: bool = False
    record: bool = True
    record_truth: bool = True


@dataclass(frozen=True)
class FoldResult:
    """The result of a run: the fields of `fold --json`.

    state: last state of the machine; signal: the signal that interrupted the run. world: cloth model of the
    simulated garment, None on hardware. robot_time_s: cell time of the run without waiting for an operator;
    stage_times_s: cell time spent in each state, including such waiting.
    """

    garment: str
    seed: int
    driver: str
    simulated: bool
    world: str | None
    result: str
    state: str
    failure: Mapping[str, Any] | None
    score: Mapping[str, Any] | None
    steps: tuple[Mapping[str, Any], ...]
    robot_time_s: float
    wall_time_s: float
    stage_times_s: Mapping[str, float]
    run_dir: str
    signal: int | None = None
    recording: Mapping[str, Any] = field(default_factory=dict)
    resumed_from: str | None = None
    """The run that was resumed by this one, else None. If there is one, `steps` has the folds of both runs, but
    the times are of this run only."""
    unwritten: tuple[str, ...] = ()
    """Messages about results that could not be written after the run's end."""
    claim: Mapping[str, Any] | None = None
    """What the executive says of the fold, from the camera alone: `shape`, `flat`, `reliability` and the figures
    that decided. None if the last fold was not inspected."""
    recognised: Mapping[str, Any] | None = None
    """The recognised `garment` and the `confidence` (0..1); None if nothing was recognised."""

    @property
    def exit_code(self) -> int:
        if self.signal is not None:
            return BY_SIGNAL + self.signal
        return EXIT_CODES[self.result]

    def as_json(self) -> dict[str, Any]:
        return {k: to_json(v) for k, v in self.__dict__.items()}
