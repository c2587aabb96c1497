"""Campaigns with quick runs, for tests of the engine."""

from __future__ import annotations

import os
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from cell.campaigns.trials.campaign import Campaign, TrialRequest
from cell.campaigns.trials.trial import Trial

__all__ = ["FINISHED", "figures", "logged_fold", "request", "trial", "trials_campaign"]

FINISHED = "finished.log"
"""File in the campaign's folder with one line for each run that `logged_fold` finished."""


def request(seed: int = 1, garment: str = "towel", variant: str = "shipped") -> TrialRequest:
    return TrialRequest(variant, garment, seed, "sim", "xpbd", {})


def trials_campaign(
    seeds: Sequence[int], garments: Sequence[str] = ("towel",), variants: Sequence[str] = ("shipped",), **more: Any
) -> Campaign:
    requests = tuple(request(s, g, v) for s in seeds for v in variants for g in garments)
    return Campaign("", more.get("keep", "all"), requests, dict.fromkeys(variants, ""))


def figures(
    result: str = "folded",
    passed: bool | None = True,
    robot_time_s: float = 60.0,
    height_m: float = 0.015,
    failure: str | None = None,
) -> dict[str, Any]:
    """Output of `foldcell fold --json`, as far as campaigns use it."""
    score = None
    if passed is not None:
        limits = {"iou": 0.9, "height_m": 0.02}
        score = {"passed": passed, "iou": 0.95 if passed else 0.85, "height_m": height_m, "limits": limits}
    return {
        "result": result,
        "failure": None if failure is None else {"kind": failure},
        "score": score,
        "robot_time_s": robot_time_s,
        "wall_time_s": 1.0,
        "steps": [{"recoveries": ["lower", "inward"]}, {"recoveries": []}],
    }


def trial(seed: int = 1, garment: str = "towel", variant: str = "shipped", **more: Any) -> Trial:
    return Trial(request(seed, garment, variant), figures(**more))


def logged_fold(request: TrialRequest, folder: Path) -> Mapping[str, Any]:
    """A run of a fifth of a second. Its figures depend on the request alone; its end is logged."""
    time.sleep(0.2)
    log = os.open(folder.parent / FINISHED, os.O_WRONLY | os.O_CREAT | os.O_APPEND)
    os.write(log, f"{request.seed}\n".encode())
    os.close(log)
    return figures(robot_time_s=30.0 + request.seed)
