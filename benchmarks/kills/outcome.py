"""What became of a killed run: whether its journal holds all that was acknowledged, and how its resume ended."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from benchmarks.kills.durable_writes import DurableWrite
from foldcell.cell.journal.journal import Entry, JournalRun
from foldcell.cell.runs.resumable import RESUMED_FROM

NOTHING_BEGUN, ALREADY_FOLDED = "nothing begun", "folded before the kill"


@dataclass(frozen=True)
class Resumed:
    """How `foldcell resume` of a killed run ended. exit_code: of the command; figures: its JSON line, empty if it
    refused; event: the event with which it resumed, empty if it did not; said: its last line of text."""

    exit_code: int
    figures: Mapping[str, Any]
    event: str = ""
    said: str = ""

    @property
    def passed(self) -> bool:
        """Whether the run ended as folded, and the scorer passes the fold."""
        return self.exit_code == 0 and self.figures.get("result") == "folded" and _passes(self.figures)


@dataclass(frozen=True)
class Outcome:
    """One boundary.

    number: of the durable write before the kill, from 1; place: that write; state: the last state in the journal;
    lost: what the journal lacks, empty if nothing; event: the event with which the run was resumed; end: how the
    resume ended; passed: None if there was nothing to resume; seconds: wall time of both processes; commit: the
    version of the program.
    """

    number: int
    place: str
    state: str
    lost: Sequence[str]
    event: str
    end: str
    passed: bool | None
    seconds: float
    commit: str = ""

    @classmethod
    def of(
        cls, number: int, acknowledged: Sequence[DurableWrite], run: JournalRun, entries: Sequence[Entry],
        problems: Sequence[str], resumed: Resumed, seconds: float,
    ) -> Outcome:  # fmt: skip
        """Judge a killed run. run, entries: its journal after the kill; problems: those found already."""
        state = entries[-1].state if entries else ""
        missing = [*problems, *lost(acknowledged, run, entries)]
        end, passed = _end(run, entries, resumed)
        return cls(number, place_of(acknowledged), state, missing, resumed.event, end, passed, seconds)


def lost(acknowledged: Sequence[DurableWrite], run: JournalRun, entries: Sequence[Entry]) -> list[str]:
    """Return what the journal lacks of the acknowledged writes, and what in it is inconsistent."""
    found = {entry.sequence: entry for entry in entries}
    missing = []
    for write in acknowledged:
        if write.what != "entry":
            continue
        entry = found.get(write.sequence)
        if entry is None:
            missing.append(f"entry {write.sequence} ({write.kind} {write.name}) is missing")
        elif (entry.kind, entry.state, entry.name) != (write.kind, write.state, write.name) or any(
            entry.payload.get(key) != value for key, value in write.payload.items()
        ):
            missing.append(f"entry {write.sequence} ({write.kind} {write.name}) differs from what was written")
    if sorted(found) != list(range(1, len(entries) + 1)):
        missing.append("the sequence numbers have gaps")
    if sum(1 for e in entries if e.kind == "intent") - sum(1 for e in entries if e.kind == "result") > 1:
        missing.append("more than one effect has no result")
    if any(write.what == "end" for write in acknowledged):
        if run.result is None:
            missing.append("the run's result is missing")
    elif run.status != "interrupted":
        missing.append(f"the killed run is listed as {run.status}")
    return missing


def place_of(acknowledged: Sequence[DurableWrite]) -> str:
    """Describe the last write in words. A checkpoint's files are described with the effect that they follow."""
    last = acknowledged[-1]
    if last.what == "entry":
        return f"{last.kind} `{last.name}`" if last.kind != "event" else f"event `{last.name}` to {last.state}"
    if last.what in {"run", "end"}:
        return {"run": "the run's row", "end": "the run's result"}[last.what]
    effect = next((w for w in reversed(acknowledged) if w.what == "entry"), None)
    about = "before the first effect" if effect is None else f"after {effect.name} ({effect.kind})"
    return f"checkpoint's {last.what} {about}"


def resume_event(entries: Sequence[Entry]) -> str:
    """Return the event with which a resumed run left the state `resuming`; empty if it did not get there."""
    if not any(entry.name == RESUMED_FROM for entry in entries):
        return ""
    left = (e.name for e in entries if e.kind == "event" and e.payload.get("from") == "resuming")
    return next(left, "")


def _end(run: JournalRun, entries: Sequence[Entry], resumed: Resumed) -> tuple[str, bool | None]:
    """Describe the end, and whether the fold passed; None if there was nothing to resume."""
    if run.result == "folded" and resumed.exit_code == 64:
        return f"{ALREADY_FOLDED}, {'passed' if _passes(run.summary) else 'NOT PASSED'}", None
    if not entries and resumed.exit_code == 64:
        return NOTHING_BEGUN, None
    if not resumed.figures:
        return f"exit code {resumed.exit_code}: {resumed.said}", False
    end = str(resumed.figures.get("result")).replace("_", " ")
    failure = resumed.figures.get("failure") or {}
    if resumed.passed:
        return "folded, passed", True
    return f"{end}, {'not passed' if not failure else failure.get('what')}", False


def _passes(figures: Mapping[str, Any]) -> bool:
    return bool((figures.get("score") or {}).get("passed"))
