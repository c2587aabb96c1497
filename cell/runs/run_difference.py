"""Find the differences between two runs: settings, versions, decisions and figures."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from foldcell.cell.journal.journal import Entry, JournalRun, performed
from foldcell.cell.runs.request_file import SETTINGS
from foldcell.cell.support.json_values import flattened

NOT_COMPARED = ("wall_time_s", "run_dir", "stage_times_s", "events")
"""Figures that are not compared, because they differ between any two runs or are contained in other figures."""


@dataclass(frozen=True)
class Difference:
    """A value that differs between two runs. first, second: the value in each run; None if the run does not have
    it."""

    name: str
    first: Any
    second: Any


@dataclass(frozen=True)
class Decision:
    """One effect of a run: its name, the state in which it was performed, the fold (from 0), and its outcome: an
    event and, after a failure, its kind."""

    effect: str
    state: str
    fold: int | None
    event: str | None
    failure: str | None

    def __str__(self) -> str:
        fold = "" if self.fold is None else f" of fold {self.fold + 1}"
        outcome = self.failure or self.event or "cut off"
        return f"{self.effect} in {self.state}{fold}: {outcome}"


@dataclass(frozen=True)
class RunDifference:
    """Differences between two runs. alike: number of equal decisions before the first difference. then: the
    first pair of decisions that differ. In the pair, None means that this run had already ended. `then` itself is
    None if all decisions are the same."""

    settings: tuple[Difference, ...]
    versions: tuple[Difference, ...]
    alike: int
    then: tuple[Decision | None, Decision | None] | None
    figures: tuple[Difference, ...]


def run_difference(
    first: JournalRun, first_entries: Sequence[Entry], second: JournalRun, second_entries: Sequence[Entry]
) -> RunDifference:
    """Compare two runs of the journal. Raises StorageError if a run's settings cannot be read."""
    a, b = (
        [Decision(x.name, x.state, x.fold, x.event, x.failure) for x in performed(entries)]
        for entries in (first_entries, second_entries)
    )
    alike = next((n for n, (x, y) in enumerate(zip(a, b, strict=False)) if x != y), min(len(a), len(b)))
    then = None
    if alike < max(len(a), len(b)):
        then = (a[alike] if alike < len(a) else None, b[alike] if alike < len(b) else None)
    return RunDifference(
        tuple(_differences(_settings(first), _settings(second))),
        tuple(_differences(dict(first.versions), dict(second.versions))),
        alike,
        then,
        tuple(_differences(_figures(first), _figures(second))),
    )


def _settings(record: JournalRun) -> dict[str, Any]:
    """Return the settings by dotted key. Driver, garment and seed count as settings."""
    from foldcell.cell.config.yaml_file import read_yaml

    path = record.directory / SETTINGS
    stated = dict(flattened(read_yaml(path, "cell settings file").data)) if path.is_file() else {}
    return {"garment": record.garment, "seed": record.seed, "driver": record.driver, **stated}


def _figures(record: JournalRun) -> dict[str, Any]:
    kept = {k: v for k, v in record.summary.items() if k not in NOT_COMPARED}
    return {"status": record.status, **dict(flattened(kept))}


def _differences(first: Mapping[str, Any], second: Mapping[str, Any]) -> Iterator[Difference]:
    for name in [*first, *(n for n in second if n not in first)]:
        a, b = first.get(name), second.get(name)
        if a != b:
            yield Difference(name, a, b)
