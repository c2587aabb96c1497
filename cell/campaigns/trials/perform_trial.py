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
from collections.abc import Callable, Mapping
from concurrent.futures import BrokenExecutor
from pathlib import Path
from typing import Any

from cell.campaigns.trials.campaign import Keep, TrialRequest
from cell.campaigns.trials.trial import MANIFEST, TRIAL, digest, load_trial
from cell.config.trajectory_library.library_file import user_library_path
from cell.runs.pruning import RECORDINGS
from cell.support.files.whole_file import write_whole
from cell.support.json_values import to_json
from cell.support.process.lock import CellBusyError, OwnerLock
from cell.support.process.memory import return_free_memory
from robots.errors import CellError, FailureKind, StorageError

__all__ = ["Fold", "perform_trial"]

LOCK = "trial.lock"
WAIT_S = 0.5
PR_SET_PDEATHSIG = 1
"""Option of Linux's prctl(2)."""

Fold = Callable[[TrialRequest, Path], Mapping[str, Any]]
"""Performs a run in a folder and returns the output of `foldcell fold --json`."""


def perform_trial(request: TrialRequest, folder: Path, keep: Keep, fold: Fold | None = None) -> dict[str, Any]:
    """Perform the run in `folder`, or return its result if the folder already has it. Returns the content of
    `trial.json`: the request's digest, figures and error.

    Each run has its own folder. If another process performs the same run (left behind by a client that was
    killed), this function waits for it. The remains of a run that was cut off are removed first. fold: performs
    the run and returns its figures; None: the run is performed by this program, or by the version that the request
    names.

    Raises BrokenExecutor if a signal ended the run, and StorageError if the run could not be recorded: neither is
    a result of the request, so nothing is written.
    """
    folder.mkdir(parents=True, exist_ok=True)
    with _only_one(folder / LOCK):
        done = load_trial(folder, request)
        if done is None:
            _clear(folder)
            done = _perform(request, folder, fold or (_other_version if request.python else _this_version))
            _refuse_cut_off(done["figures"] or {})
            _discard_recordings(folder, keep, done)
            write_whole(folder / TRIAL, json.dumps(to_json(done)) + "\n")
            return_free_memory()
    return done


def _refuse_cut_off(figures: Mapping[str, Any]) -> None:
    """A worker that is told to end stops its run first. That run is not finished, however tidily it ended."""
    if figures.get("signal") is not None:
        raise BrokenExecutor(f"the run was ended by signal {figures['signal']}")
    failure = figures.get("failure") or {}
    if failure.get("kind") == FailureKind.UNRECORDED.value:
        raise StorageError(str(failure.get("what")), str(failure.get("hint")))


def _perform(request: TrialRequest, folder: Path, fold: Fold) -> dict[str, Any]:
    """Perform the run. An exception counts as a result without figures, because the same request would raise it
    again."""
    began = time.monotonic()
    figures, error = None, ""
    try:
        _copy_library(folder)
        figures = fold(request, folder)
    except OSError as e:
        if isinstance(e, StorageError) or e.errno is not None:  # e.g. a full disk: not the request's fault
            raise
        error = f"{type(e).__name__}: {e}"
    except (StorageError, MemoryError):
        raise
    except Exception as e:
        error = f"{type(e).__name__}: {e.what if isinstance(e, CellError) else e}"
    return {
        "request": digest(request),
        "figures": figures,
        "error": error,
        "seconds": time.monotonic() - began,
    }


def _this_version(request: TrialRequest, folder: Path) -> dict[str, Any]:
    from cell.campaigns.hil.director import Director
    from cell.campaigns.hil.script import Script
    from cell.config.cell_settings import CellSettings
    from cell.hardware.robot_model import load_robot
    from cell.runs.fold_run import FoldRequest, fold_once
    from cell.states.transition_table import TERMINAL

    settings = CellSettings.model_validate_json(json.dumps(request.settings))
    run = FoldRequest(
        garment=request.garment, seed=request.seed, driver=request.driver, settings=settings, settings_path=None,
        logs=folder, live=False, approve=False, realtime=False, world=request.world, quiet=True,
    )  # fmt: skip
    if not request.actions:
        return dict(to_json(fold_once(run).as_json()))
    script = Script.model_validate(
        {
            "about": request.variant,
            "garment": request.garment,
            "seed": request.seed,
            "do": list(request.actions),
            "expect": {"end": sorted(TERMINAL)},
        }
    )
    director = Director(script, load_robot(settings).q_park, lambda line: None)
    try:
        figures = dict(to_json(fold_once(run, director.begin, (director,)).as_json()))
        seen = director.seen()
        return {
            **figures,
            "script_missed": [*map(str, seen.missed), *seen.trouble],
            "parked": seen.parked,
            "overdue": seen.overdue,
            "sent_after_stop": seen.sent_after_stop,
        }
    finally:
        director.close()


def _other_version(request: TrialRequest, folder: Path) -> dict[str, Any]:
    """Perform the run with the `foldcell fold` of another virtual environment. Its flags and its JSON output are a
    stable interface."""
    import yaml

    assert request.python is not None
    settings = folder / "cell.yaml"
    write_whole(settings, yaml.safe_dump({"schema": 1, **request.settings}))
    line = [
        request.python, "-m", "cell.commands.main", "fold", request.garment, "--seed", str(request.seed),
        "--driver", request.driver, "--world", request.world, "--cell", str(settings), "--logs", str(folder),
        "--json", ]  # fmt: skip
    environment = {k: v for k, v in os.environ.items() if k not in ("PYTHONPATH", "FOLDCELL_LOGS")}
    with tempfile.TemporaryDirectory() as elsewhere:  # Python would import from the present folder
        ended = subprocess.run(
            line, cwd=elsewhere, env=environment, stdin=subprocess.DEVNULL, capture_output=True, text=True,
            preexec_fn=_end_with_parent,
        )  # fmt: skip
    try:
        figures = json.loads(ended.stdout.splitlines()[-1])
        if "result" in figures:
            return dict(figures)
    except (LookupError, ValueError, TypeError):
        pass
    last = (ended.stderr.strip() or ended.stdout.strip()).splitlines()[-1:]
    raise RuntimeError(f"foldcell of {request.python} ended with {ended.returncode}: {' '.join(last)}")


def _end_with_parent() -> None:
    """Called in the new process: it gets SIGTERM when the worker that started it dies, however it dies."""
    ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, signal.SIGTERM)


def _copy_library(folder: Path) -> None:
    """Copy the campaign's library into the run's folder, so that trajectories which another run optimised do not
    affect this run. Raises StorageError."""
    source = next((user_library_path(f) for f in folder.parents if (f / MANIFEST).is_file()), None)
    if source is None or not source.is_file():
        return
    try:
        shutil.copyfile(source, user_library_path(folder))
    except OSError as error:
        hint = "check the permissions of both folders and whether the disk is full"
        raise StorageError(f"{source} cannot be copied to {folder}: {error.strerror}", hint) from None


def _clear(folder: Path) -> None:
    for path in folder.iterdir():
        if path.name != LOCK:
            shutil.rmtree(path) if path.is_dir() else path.unlink()


def _discard_recordings(folder: Path, keep: Keep, done: Mapping[str, Any]) -> None:
    """Remove the recordings that the campaign does not keep. Report, result, settings and journal stay."""
    figures = done["figures"]
    failed = figures is None or not (
        figures.get("result") == "folded" and (figures.get("score") or {}).get("passed", True)
    )
    if keep == "all" or (keep == "failures" and failed):
        return
    for run in folder.iterdir():
        for path in (run / name for name in RECORDINGS) if run.is_dir() else ():
            if path.exists():
                shutil.rmtree(path) if path.is_dir() else path.unlink()


class _only_one:
    """Holds the lock of a run's folder. Waits while another process performs the run."""

    def __init__(self, path: Path) -> None:
        self._lock = OwnerLock(path, "the run")

    def __enter__(self) -> None:
        while True:
            try:
                self._lock.acquire()
                return
            except CellBusyError:
                time.sleep(WAIT_S)

    def __exit__(self, *_: object) -> None:
        self._lock.release()
