"""Context managers of a fold or calibration run: they reserve the cell and record the run in the journal."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from importlib import metadata
from pathlib import Path

from foldcell.cell.config.cell_settings import CellSettings
from foldcell.cell.journal.journal import Journal, RunJournal
from foldcell.cell.support.files.paths import journal_path
from foldcell.cell.support.process.lock import OwnerLock
from foldcell.cell.support.process.signals import Interrupts, taking_signals
from foldcell.robots.errors import CellError

VERSIONED = (
    "foldcell", "pin", "coal", "ruckig", "toppra", "numpy", "scipy", "numba", "opencv-python-headless", "pybullet",
    "transitions", "rerun-sdk",
)  # fmt: skip
"""Packages whose versions are written to the journal with each run."""


@contextmanager
def owned_cell(logs: Path) -> Iterator[tuple[Interrupts, Journal]]:
    """Reserve the cell that belongs to this log folder. Yields the signal handling, to be used with
    `Interrupts.stop`, and the open journal. Raises ConfigurationError if the cell is in use, StorageError if the
    journal cannot be opened."""
    with (
        taking_signals() as interrupts,
        OwnerLock(logs / "cell.lock"),
        Journal.open(journal_path(logs)) as journal,
    ):
        yield interrupts, journal


@contextmanager
def begun_run(
    journal: Journal,
    garment: str,
    seed: int,
    driver: str,
    settings: CellSettings,
    packages: Sequence[str] = VERSIONED,
) -> Iterator[RunJournal]:
    """Begin a run in the journal. If a CellError occurs before the run's first line (for example because the cell
    does not respond), the run ends as not begun, with the reason. After any other exception the run has no end and
    counts as interrupted."""
    run = journal.begin_run(
        garment=garment,
        seed=seed,
        driver=driver,
        settings_hash=settings.fingerprint(),
        versions={name: metadata.version(name) for name in packages},
    )
    try:
        yield run
    except CellError as e:
        run.refuse(e)
        raise
    except BaseException:
        run.abandon()
        raise
