"""Fold a garment in one run of the cell."""

from __future__ import annotations

from pathlib import Path
from threading import Lock

from foldcell.arguments import flag, own_numeric_state, path, text, whole
from foldcell.cell.config.garments.garment_file import load_garment
from foldcell.cell.record.run_record import RunRecord
from foldcell.cell.runs.fold_run import fold_once
from foldcell.cell.states.fold_request import FoldRequest
from foldcell.cell.support.files.paths import logs_directory, prepare_logs
from foldcell.robots.errors import ConfigurationError
from foldcell.settings import Settings, cell_settings

LARGEST_SEED = 2**31 - 1
_ONE_RUN = Lock()
"""A run uses signals, terminal and physics engine, which a process has only once."""


@own_numeric_state
def fold(
    garment: str | Path,
    *,
    seed: int = 0,
    settings: Settings = None,
    driver: str = "sim",
    logs: str | Path | None = None,
    approve: bool = False,
    record: bool = True,
    quiet: bool = True,
) -> RunRecord:
    """Fold a garment once, as the command `fold` does, and wait for the end of the run.

    garment: a shipped name, a garment file, or 'auto' (the cell recognises it). seed: seed of the simulated cell,
    0 to 2147483647; it alone determines a simulated run. driver: 'sim', 'emulator' or 'ros' (the robot that
    ROS_MASTER_URI names). logs: folder of journal and runs; None: FOLDCELL_LOGS, else the default folder. approve:
    ask at the terminal before each fold; with a robot the cell always asks. record: save recording, transcript and
    report in the run's folder. quiet: print no progress lines on standard output.

    The record has the keys of `fold --json` as attributes (times [s], lengths [m]): `result` is 'folded',
    'not_folded' or 'fault'; `failure` is the reason; `claim` is what the camera shows of the last fold; `score`
    holds the scorer's figures (None on hardware); `steps` has one `FoldRecord` per fold; `run_dir` is the folder
    for `load_run`. If the function is called on the main thread, SIGINT and SIGTERM stop the cell during the run,
    and `signal` of the record is the number of that signal.

    A process performs one run at a time. Raises ConfigurationError and StorageError before anything moves.
    """
    seed = whole(seed, "seed")
    if not 0 <= seed <= LARGEST_SEED:
        raise ConfigurationError(f"{seed} is no seed", f"a whole number from 0 to {LARGEST_SEED} is")
    named = str(path(garment, "garment"))
    checked = cell_settings(settings)
    if named != "auto":
        load_garment(named, checked.surface)
    request = FoldRequest(
        garment=named,
        seed=seed,
        driver=text(driver, "driver"),
        settings=checked,
        approve=flag(approve, "approve"),
        record=flag(record, "record"),
        quiet=flag(quiet, "quiet"),
        logs=prepare_logs(logs_directory(None if logs is None else path(logs, "logs"))),
    )
    if not _ONE_RUN.acquire(blocking=False):
        raise ConfigurationError(
            "another thread of this process performs a run", "wait for it, or use a process each"
        )
    try:
        return fold_once(request)
    finally:
        _ONE_RUN.release()
