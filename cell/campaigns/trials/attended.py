"""Perform a campaign with a person at the cell, who lays each garment and judges each fold.

The runs follow each other in this process. The result of a run is on disk before the person is asked for the
verdict, and the verdict is on disk at once. The campaign may go on another day: a run that waits for its verdict
is then judged first, and a run that was cut off is performed again.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

from foldcell.cell.campaigns.trials.campaign import TrialRequest
from foldcell.cell.campaigns.trials.perform_trial import discard_recordings
from foldcell.cell.campaigns.trials.store import CampaignFolder
from foldcell.cell.campaigns.trials.trial import TRIAL, Trial, read_trial, write_trial
from foldcell.cell.config.trajectory_library.library_file import copy_library
from foldcell.cell.operator.judging import ask_judgement
from foldcell.cell.record.judgement import Judgement
from foldcell.cell.record.run_record import RunRecord
from foldcell.cell.record.words import garment_name
from foldcell.cell.runs.fold_run import Attendance, fold_once
from foldcell.cell.states.fold_request import FoldRequest
from foldcell.cell.support.process.signals import Terminated
from foldcell.robots.errors import DriverError, FailureKind, StorageError

Perform = Callable[[TrialRequest, Path, Attendance], RunRecord]
"""Performs a run in a folder, with a person."""
AskLater = Callable[[str], Judgement | None]
"""Asks for the verdict on a run that ended earlier; the argument names the run."""


class Session:
    """The runs of one day. page, page_port, page_origin: of the operator's page; quiet: no progress lines."""

    def __init__(self, page: bool = False, page_port: int = 0, page_origin: str = "", quiet: bool = False) -> None:
        self._page, self._port, self._origin, self._quiet = page, page_port, page_origin, quiet

    def perform(self, request: TrialRequest, folder: Path, attendance: Attendance) -> RunRecord:
        run = FoldRequest(
            garment=request.garment, seed=request.seed, driver=request.driver,
            settings=request.cell, logs=folder, world=request.world, quiet=self._quiet,
            page=self._page, page_port=self._port, page_origin=self._origin, record_truth=False,
        )  # fmt: skip
        return fold_once(run, attendance=attendance)


def judge_later(about: str) -> Judgement | None:
    return ask_judgement(about, sys.stdin, unseen=True)


def attended_trials(campaign: CampaignFolder, perform: Perform, ask_later: AskLater) -> Iterator[Trial]:
    """Yield each missing run as soon as it is judged, until the person ends the day.

    Raises Terminated if a signal ended a run, StorageError if a run could not be recorded, ConfigurationError if
    the cell cannot be opened, and DriverError if the stop is triggered before a run.
    """
    total = len(campaign.campaign.requests)
    finished = len(campaign.finished())
    for number, request in enumerate(campaign.missing(campaign.finished()), finished + 1):
        folder = campaign.folder(request)
        folder.mkdir(parents=True, exist_ok=True)
        trial = read_trial(folder, request)
        if trial is not None:
            judged = ask_later(f"{request}, performed before")
            if judged is None:
                return
            trial = _judged(folder, trial, judged) if judged.passed is not None else None
        if trial is None:
            trial = _performed(campaign, request, folder, f"run {number} of {total}", perform)
        if trial is None:
            return
        discard_recordings(folder, campaign.campaign.keep, trial)
        yield trial


def _judged(folder: Path, trial: Trial, judgement: Judgement) -> Trial:
    trial = replace(trial, judgement=judgement)
    write_trial(folder, trial)
    return trial


def _performed(
    campaign: CampaignFolder, request: TrialRequest, folder: Path, number: str, perform: Perform
) -> Trial | None:
    """Perform a run. Returns None if the person ended the day before the garment was found, or gave no verdict."""
    name = garment_name(request.garment)
    (folder / TRIAL).unlink(missing_ok=True)
    copy_library(campaign.path, folder)  # trajectories that another run optimised must not affect this run
    trial: Trial | None = None

    def recorded(record: RunRecord) -> None:
        nonlocal trial
        if _counts(record):
            trial = Trial(request, record)
            write_trial(folder, trial)

    def judge(ask: Callable[[], Judgement | None]) -> None:
        nonlocal trial
        judgement = ask() if trial else None
        if trial and judgement:
            trial = _judged(folder, trial, judgement)

    begin = f"{number}, {name}: clear the table and step back, the arms move next"
    lay = f"lay the {name} flat on the table and step back"
    try:
        record = perform(request, folder, Attendance(begin, lay, recorded, judge))
    except DriverError as e:
        if e.kind is FailureKind.ABORTED:
            return None
        raise
    if record.signal is not None:
        raise Terminated(record.signal)
    if record.failure and record.failure.kind is FailureKind.UNRECORDED:
        raise StorageError(record.failure.what, record.failure.hint)
    return None if trial is None or trial.unjudged else trial


def _counts(record: RunRecord) -> bool:
    """Whether a run is a result. It is none if a signal ended it, if it could not be recorded, or if the person
    ended it before the garment was found."""
    kind = record.failure.kind if record.failure else None
    ended_early = kind is FailureKind.ABORTED and record.recognised is None
    return record.signal is None and kind is not FailureKind.UNRECORDED and not ended_early
