"""The frame of what moves a cell, a fold or a calibration: the cell is this process's, and the journal has it."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from importlib import metadata
from pathlib import Path

from cell.config.cell_settings import CellSettings
from cell.recording.journal import Journal, RunJournal
from cell.support.files.paths import journal_path
from cell.support.process.interrupts import Interrupts, taking_signals
from cell.support.process.lock import OwnerLock
from robots.errors import CellError

__all__ = ["VERSIONED", "begun_run", "owned_cell"]

VERSIONED = (
    "foldcell", "pin", "coal", "ruckig", "toppra", "numpy", "scipy", "numba", "opencv-python-headless", "pybullet",
    "transitions", "rerun-sdk",
)  # fmt: skip
"""Packages whose versions a run is kept with."""


@contextmanager
def owned_cell(logs: Path) -> Iterator[tuple[Interrupts, Journal]]:
    """Signals may be taken (`Interrupts.stop`), and `logs` is nobody else's, until it ends. Raises
    ConfigurationError when the cell is in use, StorageError for a journal that cannot be opened."""
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
    """A new run in the journal. A CellError before its first line (the cell does not answer) ends it as not begun,
    with the reason; whatever else is raised before its end leaves it open: it shows as interrupted."""
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
