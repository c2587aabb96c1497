"""Decide from the journal and the run's folder whether a run can be resumed."""

from __future__ import annotations

from foldcell.cell.hardware.driver_names import is_simulated
from foldcell.cell.journal.checkpoint_file import has_checkpoint
from foldcell.cell.journal.journal import Journal
from foldcell.robots.errors import ConfigurationError

RESUMED_FROM = "resumed_from"
"""Name of the journal event that marks a run as the continuation of another run."""
CALIBRATION = "calibrate-"
"""Prefix in the journal's garment field that marks a calibration."""


def resumable(journal: Journal, name: str) -> bool:
    """Whether `foldcell resume` accepts the run, if the run's files are undamaged."""
    try:
        check_resumable(journal, name)
    except ConfigurationError:
        return False
    return True


def last_begun(journal: Journal) -> str:
    """Return the id of the newest run that began to act, or of the newest run if none did."""
    runs = journal.runs()
    return next((run.id for run in reversed(runs) if journal.began_to_act(run.id)), journal.run("last").id)


def check_resumable(journal: Journal, name: str) -> None:
    """Check that a run can be resumed. Raises ConfigurationError with the reason if it cannot. name: id of the
    run."""
    runs = journal.runs()
    index = next(n for n, r in enumerate(runs) if r.id == name)
    record, later = runs[index], runs[index + 1 :]
    if record.status == "running":
        raise ConfigurationError(f"the run {name} is still running (process {record.pid})", "stop it first")
    if record.status == "folded":
        raise ConfigurationError(f"the run {name} has folded its garment", "there is nothing to resume")
    if record.garment.startswith(CALIBRATION):
        raise ConfigurationError(f"{name} is a calibration: it cannot be resumed", "start it again")
    if not record.directory.is_dir():
        raise ConfigurationError(f"the folder of the run {name} is gone", "start a new one: foldcell fold")
    successors = [run for run, entry in journal.named(RESUMED_FROM) if entry.payload["run"] == name]
    if successors:
        newest = successors[-1]
        raise ConfigurationError(f"the run {name} was already resumed as {newest}", f"foldcell resume {newest}")
    runs_since = [
        other.id
        for other in later
        if other.driver == record.driver and not is_simulated(record.driver) and journal.began_to_act(other.id)
    ]
    if runs_since:
        raise ConfigurationError(
            f"the cell has done other runs since {name} (the last is {runs_since[-1]})",
            "lay the garment flat and start a new one",
        )
    if not has_checkpoint(record.directory):
        raise ConfigurationError(
            f"the run {name} has no checkpoint: it had not begun, or ended with folds skipped",
            "start a new one: foldcell fold",
        )
