"""The runs and campaigns of a logs folder, as the dashboard lists them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

from cell.campaigns.trials.trial import failed_figures
from cell.hardware.driver import is_simulated

__all__ = ["DAMAGED", "FALSE_CLAIM", "CampaignEntry", "LogsContent", "RunEntry", "mapping", "run_entry"]

DAMAGED, FALSE_CLAIM = "damaged", "false claim"


@dataclass(frozen=True)
class RunEntry:
    """One run. key: path of its folder relative to the logs, which names it in addresses. status: as in the
    journal, or `damaged`. started: seconds since 1970, or None. campaign, variant: empty for a run by itself.
    failed: figures of the score beyond their limits. damage: what is wrong with its files, or empty."""

    key: str
    folder: Path
    garment: str
    seed: int | None
    driver: str
    status: str
    started: float | None
    failure: str = ""
    reason: str = ""
    passed: bool | None = None
    failed: tuple[str, ...] = ()
    robot_time_s: float | None = None
    wall_time_s: float | None = None
    campaign: str = ""
    variant: str = ""
    damage: str = ""

    @property
    def simulated(self) -> bool:
        return bool(self.driver) and is_simulated(self.driver)

    @property
    def verdict(self) -> str:
        """The status, or `false claim` if the run claims a fold that the score does not pass."""
        return FALSE_CLAIM if self.status == "folded" and self.passed is False else self.status

    @cached_property
    def text(self) -> str:
        """Everything in which a reader may search, in lower case."""
        parts = (self.key, self.garment, self.driver, self.verdict, self.failure, self.reason, self.variant)
        return " ".join((*parts, *self.failed, self.damage)).replace("_", " ").lower()


@dataclass(frozen=True)
class CampaignEntry:
    """A campaign, or another folder with runs (scripted runs, endurance). begun: as text. runs: number of planned
    runs; pages: names of its result pages. damage: what is wrong with its files, or empty."""

    name: str
    about: str
    begun: str
    runs: int
    finished: int
    folded: int
    pages: tuple[str, ...] = ()
    damage: str = ""


@dataclass(frozen=True)
class LogsContent:
    """runs: newest first; campaigns: newest first; notices: files that could not be read, in words."""

    runs: Sequence[RunEntry]
    campaigns: Sequence[CampaignEntry]
    notices: Sequence[str]

    @cached_property
    def by_key(self) -> Mapping[str, RunEntry]:
        return {run.key: run for run in self.runs}


def mapping(value: Any) -> Mapping[str, Any]:
    """Return the value if it is a mapping, else an empty one: files of a damaged run may hold anything."""
    return value if isinstance(value, Mapping) else {}


def run_entry(
    logs: Path,
    folder: Path,
    status: str,
    figures: Mapping[str, Any],
    *,
    garment: str,
    seed: int | None,
    driver: str,
    started: float | None,
    **more: Any,
) -> RunEntry:
    """Return the entry of the run in `folder`. figures: its result (`foldcell fold --json`), possibly empty or
    damaged."""
    failure, score = mapping(figures.get("failure")), mapping(figures.get("score"))
    passed = score.get("passed")
    reason = failure.get("what") or mapping(figures.get("reason")).get("what") or ""
    damage = "" if folder.is_dir() else "its folder is missing"
    more = {"damage": damage, **more}
    return RunEntry(
        key=folder.relative_to(logs).as_posix(),
        folder=folder,
        garment=str(garment),
        seed=seed,
        driver=str(driver),
        status=str(status),
        started=started,
        failure=str(failure.get("kind") or ""),
        reason=str(reason),
        passed=passed if isinstance(passed, bool) else None,
        failed=_failed(score) if passed is False else (),
        robot_time_s=_number(figures.get("robot_time_s")),
        wall_time_s=_number(figures.get("wall_time_s")),
        **more,
    )


def _failed(score: Mapping[str, Any]) -> tuple[str, ...]:
    try:
        return tuple(dict.fromkeys(failed_figures(score)))  # drift is named twice: as a way and as an angle
    except (TypeError, AttributeError, LookupError):
        return ()


def _number(value: Any) -> float | None:
    return float(value) if isinstance(value, int | float) and not isinstance(value, bool) else None
