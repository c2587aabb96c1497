"""Which recordings of old runs may go when the disk is wanted."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from cell.recording.checkpoint.run_checkpoint import CHECKPOINT, has_checkpoint
from cell.recording.frame_store import FRAMES
from cell.recording.journal import Journal, RunRecord
from cell.runs.checkpoint_writer import WORLD
from cell.runs.resumable import resumable
from cell.runs.run_inputs import BEGAN_WITH
from cell.support.files.paths import LEDGER
from robots.errors import StorageError

__all__ = ["PrunableRun", "prunable_runs", "prune"]

HEAVY = ("run.rrd", "run.transcript", FRAMES, CHECKPOINT, BEGAN_WITH, WORLD)
"""Of a run's folder: recording, transcript, pictures, what it would have been gone on with from, and what it had
itself gone on from, which the transcript needs. What remains
(report, result, settings, and the journal) tells what became of it."""


@dataclass(frozen=True)
class PrunableRun:
    """A run whose recordings may go. paths: these; bytes: what they take."""

    run: RunRecord
    paths: tuple[Path, ...]
    bytes: int


def prunable_runs(logs: Path, keep: int, unfinished: bool = False) -> tuple[PrunableRun, ...]:
    """All runs in the folder and in its campaigns that have recordings, oldest first, but the newest `keep`, those
    under way, and, unless `unfinished`, those that can be gone on with. Raises StorageError, or ConfigurationError
    for a bad journal."""
    runs = sorted(_runs(logs, unfinished), key=lambda run: run[0])
    found = []
    for _, record, needed in runs[: max(0, len(runs) - keep)]:
        paths = tuple(path for path in (record.directory / name for name in HEAVY) if path.exists())
        if paths and not needed:
            found.append(PrunableRun(record, paths, sum(_size(path) for path in paths)))
    return tuple(found)


def prune(heavy: PrunableRun) -> None:
    """Remove the recordings of one run. Raises StorageError."""
    try:
        for path in heavy.paths:
            shutil.rmtree(path) if path.is_dir() else path.unlink()
    except OSError as e:
        raise StorageError(
            f"cannot remove {e.filename}: {e.strerror}",
            "see whose file it is, and whether its disk may be written",
        ) from e


def _runs(logs: Path, unfinished: bool) -> Iterator[tuple[float, RunRecord, bool]]:
    """Every run, with when it began [s since 1970] and whether its recordings are needed. In a journal each began
    after those before it, whatever the clock said."""
    for journal_file in [logs / LEDGER, *sorted(logs.glob(f"*/{LEDGER}")), *sorted(logs.glob(f"*/*/{LEDGER}"))]:
        if journal_file.is_file():
            with Journal.open(journal_file, readonly=True) as journal:
                began = 0.0
                for record in journal.runs():
                    going = record.status == "running"
                    hopeful = not unfinished and has_checkpoint(record.directory)
                    began = max(began, record.started)
                    yield began, record, going or (hopeful and resumable(journal, record.id))


def _size(path: Path) -> int:
    files = path.rglob("*") if path.is_dir() else [path]
    return sum(file.stat().st_size for file in files if file.is_file())
