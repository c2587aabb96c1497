"""Removes the recordings of old runs to free disk space."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from foldcell.cell.journal.checkpoint_file import CHECKPOINT, has_checkpoint
from foldcell.cell.journal.frame_store import FRAMES
from foldcell.cell.journal.journal import Journal, JournalRun
from foldcell.cell.runs.checkpoint_writer import WORLD
from foldcell.cell.runs.request_file import BEGAN_WITH
from foldcell.cell.runs.resumable import resumable
from foldcell.cell.support.files.paths import JOURNAL_FILE
from foldcell.robots.errors import StorageError

RECORDINGS = ("run.rrd", "run.transcript", FRAMES, CHECKPOINT, BEGAN_WITH, WORLD)
"""Files and folders of a run that may be removed: recording, transcript, pictures, checkpoint, saved world, and
initial checkpoint (which only the transcript needs). Report, result, settings and the journal stay."""


@dataclass(frozen=True)
class PrunableRun:
    """A run whose recordings may be removed. paths: the files and folders of its recordings; bytes: their total
    size."""

    run: JournalRun
    paths: tuple[Path, ...]
    bytes: int


def prunable_runs(logs: Path, keep: int, unfinished: bool = False) -> tuple[PrunableRun, ...]:
    """Return the runs in the folder and its campaigns whose recordings may be removed, oldest first. Not
    included: the newest `keep` runs, running runs, and, unless `unfinished` is true, runs that can be resumed.

    Raises StorageError, or ConfigurationError for a bad journal.
    """
    runs = sorted(_runs(logs, unfinished), key=lambda run: run[0])
    prunable = []
    for _, record, needed in runs[: max(0, len(runs) - keep)]:
        paths = tuple(path for path in (record.directory / name for name in RECORDINGS) if path.exists())
        if paths and not needed:
            prunable.append(PrunableRun(record, paths, sum(_size(path) for path in paths)))
    return tuple(prunable)


def prune(run: PrunableRun) -> None:
    """Remove the recordings of one run. Raises StorageError."""
    try:
        for path in run.paths:
            shutil.rmtree(path) if path.is_dir() else path.unlink()
    except OSError as e:
        raise StorageError(
            f"cannot remove {e.filename}: {e.strerror}",
            "check the file's owner and whether the disk is writable",
        ) from e


def _runs(logs: Path, unfinished: bool) -> Iterator[tuple[float, JournalRun, bool]]:
    """Yield every run: (start [s since 1970], record, whether its recordings are needed). The yielded start never
    decreases within a journal, even if the clock was set back."""
    # each run of a campaign has its own journal, in CAMPAIGN/GARMENT-seedN or CAMPAIGN/VARIANT/GARMENT-seedN
    for journal_file in (path for depth in range(4) for path in sorted(logs.glob("*/" * depth + JOURNAL_FILE))):
        if journal_file.is_file():
            with Journal.open(journal_file, readonly=True) as journal:
                began = 0.0
                for record in journal.runs():
                    running = record.status == "running"
                    may_resume = not unfinished and has_checkpoint(record.directory)
                    began = max(began, record.started)
                    yield began, record, running or (may_resume and resumable(journal, record.id))


def _size(path: Path) -> int:
    files = path.rglob("*") if path.is_dir() else [path]
    return sum(file.stat().st_size for file in files if file.is_file())
