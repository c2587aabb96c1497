"""Which runs can be gone on with, read off the journal and the run's folder."""

from __future__ import annotations

from cell.hardware.driver import is_simulated
from cell.recording.checkpoint.run_checkpoint import has_checkpoint
from cell.recording.journal import Journal
from robots.errors import ConfigurationError

__all__ = ["RESUMED_FROM", "check_resumable", "last_begun", "resumable"]

RESUMED_FROM = "resumed_from"
"""The event in the journal of a run that goes on with another one."""
CALIBRATION = "calibrate-"
"""How the journal's garment of a calibration begins."""


def resumable(journal: Journal, name: str) -> bool:
    """Whether `foldcell resume` would take the run, its files being sound."""
    try:
        check_resumable(journal, name)
    except ConfigurationError:
        return False
    return True


def last_begun(journal: Journal) -> str:
    """The newest run that came so far as to do something; the newest of all where none did."""
    runs = journal.runs()
    return next((run.id for run in reversed(runs) if journal.began_to_act(run.id)), journal.run("last").id)


def check_resumable(journal: Journal, name: str) -> None:
    """Raises ConfigurationError, with the reason, for a run (its id) that cannot be gone on with."""
    runs = journal.runs()
    place = next(n for n, r in enumerate(runs) if r.id == name)
    record, later = runs[place], runs[place + 1 :]
    if record.status == "running":
        raise ConfigurationError(f"the run {name} is still going (process {record.pid})", "stop it first")
    if record.status == "folded":
        raise ConfigurationError(f"the run {name} has folded its garment", "there is nothing to go on with")
    if record.garment.startswith(CALIBRATION):
        raise ConfigurationError(f"{name} is a calibration: it cannot be gone on with", "begin it again")
    if not record.directory.is_dir():
        raise ConfigurationError(f"the folder of the run {name} is gone", "start a new one: foldcell fold")
    successors = [run for run, entry in journal.named(RESUMED_FROM) if entry.payload["run"] == name]
    if successors:
        newest = successors[-1]
        raise ConfigurationError(f"the run {name} was gone on with as {newest}", f"foldcell resume {newest}")
    used = [
        other.id
        for other in later
        if other.driver == record.driver and not is_simulated(record.driver) and journal.began_to_act(other.id)
    ]
    if used:
        raise ConfigurationError(
            f"the cell has done other runs since {name} (the last is {used[-1]})",
            "lay the garment flat and start a new one",
        )
    if not has_checkpoint(record.directory):
        raise ConfigurationError(
            f"the run {name} has kept nothing to go on with: it came no further than preparing, or left folds out",
            "start a new one: foldcell fold",
        )
