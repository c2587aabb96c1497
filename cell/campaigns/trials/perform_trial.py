"""Performs one run of a campaign, in a worker process. The result is on disk before the worker returns it."""

from __future__ import annotations

import ctypes
import json
import os
import shutil
import signal
import subprocess
import tempfile
import time
from collections.abc import Callable, Iterator
from concurrent.futures import BrokenExecutor
from contextlib import contextmanager
from pathlib import Path

from foldcell.cell.campaigns.trials.campaign import Keep, TrialRequest
from foldcell.cell.campaigns.trials.store import MANIFEST
from foldcell.cell.campaigns.trials.trial import Trial, read_trial, write_trial
from foldcell.cell.config.trajectory_library.library_file import copy_library
from foldcell.cell.record.run_record import RunRecord, record_of
from foldcell.cell.runs.pruning import RECORDINGS
from foldcell.cell.states.fold_request import FoldRequest
from foldcell.cell.support.files.whole_file import write_whole
from foldcell.cell.support.process.lock import CellBusyError, OwnerLock
from foldcell.cell.support.process.memory import return_free_memory
from foldcell.cell.support.process.signals import Terminated
from foldcell.robots.errors import CellError, DriverError, FailureKind, StorageError

LOCK = "trial.lock"
WAIT_S = 0.5
PR_SET_PDEATHSIG = 1
"""Option of Linux's prctl(2)."""

Fold = Callable[[TrialRequest, Path], Trial]
"""Performs a run in a folder."""


def perform_trial(request: TrialRequest, folder: Path, keep: Keep, fold: Fold | None = None) -> Trial:
    """Perform the run in `folder`, or return its result if the folder already has it.

    Each run has its own folder. A killed client may have left a process behind that performs the same run. This
    function then waits for that process. The remains of a run that was cut off are removed first. fold: performs
    the run; None: the run is performed by this program, or by the version that the request names.

    Raises BrokenExecutor if a signal ended the run, StorageError if the run could not be recorded, and DriverError
    if its robot did not start: none is a result of the request, so nothing is written.
    """
    folder.mkdir(parents=True, exist_ok=True)
    with _only_one(folder / LOCK):
        trial = read_trial(folder, request)
        if trial is None:
            _clear(folder)
            trial = _perform(request, folder, fold or (_other_version if request.python else _this_version))
            _refuse_cut_off(trial.record)
            discard_recordings(folder, keep, trial)
            write_trial(folder, trial)
            return_free_memory()
    return trial


def _refuse_cut_off(record: RunRecord | None) -> None:
    """Raise BrokenExecutor for a run that a signal ended, and StorageError for a run that could not be recorded.
    Neither run counts as finished, even if it ended in order."""
    if record is None:
        return
    if record.signal is not None:
        raise BrokenExecutor(f"the run was ended by signal {record.signal}")
    if record.failure and record.failure.kind is FailureKind.UNRECORDED:
        raise StorageError(record.failure.what, record.failure.hint)


def _perform(request: TrialRequest, folder: Path, fold: Fold) -> Trial:
    """Perform the run. An exception counts as a result without a record if the same request would raise it again;
    the others, e.g. that the robot does not start, are passed on."""
    campaign = next((f for f in folder.parents if (f / MANIFEST).is_file()), None)
    try:
        if campaign is not None:  # trajectories that another run optimised must not affect this run
            copy_library(campaign, folder)
        return fold(request, folder)
    except (DriverError, StorageError, MemoryError):  # e.g. the emulated robot cannot be started
        raise
    except Terminated as e:
        raise BrokenExecutor(f"the run was ended by {e}") from None
    except Exception as e:
        if isinstance(e, OSError) and e.errno is not None:  # e.g. a full disk: not the request's fault
            raise
        return Trial(request, None, f"{type(e).__name__}: {e.what if isinstance(e, CellError) else e}")


def _this_version(request: TrialRequest, folder: Path) -> Trial:
    from foldcell.cell.campaigns.hil.script import Action
    from foldcell.cell.campaigns.hil.script_run import fold_scripted
    from foldcell.cell.runs.fold_run import fold_once

    run = FoldRequest(
        garment=request.garment, seed=request.seed, driver=request.driver,
        settings=request.cell, logs=folder,
        world=request.world, quiet=True,
    )  # fmt: skip
    if not request.actions:
        return Trial(request, fold_once(run))
    actions = [Action.model_validate(action) for action in request.actions]
    record, seen = fold_scripted(run, actions, lambda line: None)
    return Trial(request, record, seen=seen)


def _other_version(request: TrialRequest, folder: Path) -> Trial:
    """Perform the run with the `foldcell fold` of another virtual environment, whose output must be a record that
    this version can read."""
    import yaml

    assert request.python is not None
    settings = folder / "cell.yaml"
    write_whole(settings, yaml.safe_dump({"schema": 1, **request.settings}))
    line = [
        request.python, "-m", "foldcell.cell.commands.main", "fold", request.garment, "--seed", str(request.seed),
        "--driver", request.driver, "--world", request.world, "--cell", str(settings), "--logs", str(folder),
        "--json", ]  # fmt: skip
    environment = {k: v for k, v in os.environ.items() if k not in ("PYTHONPATH", "FOLDCELL_LOGS")}
    with tempfile.TemporaryDirectory() as elsewhere:  # Python would import from the present folder
        ended = subprocess.run(
            line, cwd=elsewhere, env=environment, stdin=subprocess.DEVNULL, capture_output=True, text=True,
            preexec_fn=_end_with_parent,
        )  # fmt: skip
    try:
        record = record_of(json.loads(ended.stdout.splitlines()[-1]))
    except (LookupError, ValueError):
        record = None
    if record is None:
        last = (ended.stderr.strip() or ended.stdout.strip()).splitlines()[-1:]
        raise RuntimeError(f"foldcell of {request.python} ended with {ended.returncode}: {' '.join(last)}")
    return Trial(request, record)


def _end_with_parent() -> None:
    """Called in the new process. Makes the kernel send it SIGTERM when its worker dies for any reason."""
    ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, signal.SIGTERM)


def _clear(folder: Path) -> None:
    for path in folder.iterdir():
        if path.name != LOCK:
            shutil.rmtree(path) if path.is_dir() else path.unlink()


def discard_recordings(folder: Path, keep: Keep, trial: Trial) -> None:
    """Remove the recordings that the campaign does not keep. Report, record, settings and journal stay."""
    if keep == "all" or (keep == "failures" and not trial.success):
        return
    for run in folder.iterdir():
        for path in (run / name for name in RECORDINGS) if run.is_dir() else ():
            if path.exists():
                shutil.rmtree(path) if path.is_dir() else path.unlink()


@contextmanager
def _only_one(path: Path) -> Iterator[None]:
    """Hold the lock of a run's folder. Wait while another process performs the run."""
    lock = OwnerLock(path, "the run")
    while True:
        try:
            lock.acquire()
            break
        except CellBusyError:
            time.sleep(WAIT_S)
    try:
        yield
    finally:
        lock.release()
