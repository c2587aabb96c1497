"""Campaigns with quick runs, for tests of the engine."""

from __future__ import annotations

import os
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from foldcell.cell.campaigns.trials.campaign import Campaign, TrialRequest
from foldcell.cell.campaigns.trials.trial import Trial
from foldcell.cell.record.run_record import FailureRecord, FoldRecord, RunRecord, RunResult
from foldcell.cell.states.transition_table import State
from foldcell.robots.errors import FailureKind
from tests.builders.records import run_record, score_record

FINISHED = "finished.log"
"""File in the campaign's folder with one line for each run that `logged_fold` finished."""


def request(seed: int = 1, garment: str = "towel", variant: str = "shipped") -> TrialRequest:
    return TrialRequest(variant, garment, seed, "sim", "xpbd", {})


def trials_campaign(
    seeds: Sequence[int], garments: Sequence[str] = ("towel",), variants: Sequence[str] = ("shipped",)
) -> Campaign:
    requests = tuple(request(s, g, v) for s in seeds for v in variants for g in garments)
    return Campaign("", "all", requests, dict.fromkeys(variants, ""))


def record(
    result: RunResult = "folded",
    passed: bool | None = True,
    height_m: float = 0.015,
    failure: FailureKind | None = None,
    what: str = "it slipped",
    **values: Any,
) -> RunRecord:
    """The record of a run of two folds, the first with two recoveries. passed: None without a score."""
    limits = {"iou": 0.9, "height_m": 0.02}
    score = score_record(limits, passed=passed, iou=0.95 if passed else 0.85, height_m=height_m)
    folds = (FoldRecord("half", recoveries=("lower", "inward")), FoldRecord("quarter"))
    given = {
        "garment": "towel", "seed": 1, "result": result, "state": State(result), "robot_time_s": 60.0,
        "failure": failure and FailureRecord(failure, what, "look again"), "steps": folds,
        "score": None if passed is None else score, **values,
    }  # fmt: skip
    return run_record(**given)


def trial(seed: int = 1, garment: str = "towel", variant: str = "shipped", **values: Any) -> Trial:
    return Trial(request(seed, garment, variant), record(**values))


def logged_fold(request: TrialRequest, folder: Path) -> Trial:
    """A run of a fifth of a second. Its record depends on the request alone; its end is logged."""
    time.sleep(0.2)
    log = os.open(folder.parent / FINISHED, os.O_WRONLY | os.O_CREAT | os.O_APPEND)
    os.write(log, f"{request.seed}\n".encode())
    os.close(log)
    return Trial(request, record(robot_time_s=30.0 + request.seed))
