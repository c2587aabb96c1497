"""Read all runs and campaigns of a logs folder, without changing anything in it.

Files that have not changed since they were read are not read again. A run or campaign that cannot be read is
listed with its damage; it never hides the others.
"""

from __future__ import annotations

import os
import re
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from foldcell.cell.campaigns.dashboard.entries import DAMAGED, CampaignEntry, LogsContent, RunEntry
from foldcell.cell.campaigns.page.campaign_page import PAGE as CAMPAIGN_PAGE
from foldcell.cell.campaigns.page.fault_page import PAGE as FAULTS_PAGE
from foldcell.cell.campaigns.trials.campaign import TrialRequest
from foldcell.cell.campaigns.trials.store import MANIFEST, CampaignFolder, is_campaign
from foldcell.cell.campaigns.trials.trial import TRIAL, read_trial
from foldcell.cell.journal.journal import NOT_BEGUN, Journal
from foldcell.cell.record.run_record import RECORD, Ending, Refusal, RunRecord, ending_of, read_record, record_of
from foldcell.cell.record.words import plain
from foldcell.cell.support.files.paths import journal_path
from foldcell.robots.errors import CellError, StorageError

RUN_NAME = re.compile(r"(\d{8}T\d{6}Z)-")
"""Beginning of the name of a run's folder: the time (UTC) at which the run began."""
LEAST_AGE_S = 1.0
"""The folder is not read again within this time [s]."""
UNFINISHED = {"running", "interrupted", DAMAGED, NOT_BEGUN}

Signature = tuple[tuple[int, int] | None, ...]


class History:
    """The content of a logs folder. Thread-safe."""

    def __init__(self, logs: Path) -> None:
        self.logs = logs
        self._kept: dict[Path, tuple[Signature, Any]] = {}
        self._content: tuple[float, LogsContent] | None = None
        self._notices: list[str] = []
        """What the present reading could not read."""
        self._mutex = threading.Lock()

    def read(self) -> LogsContent:
        """Return the present content of the folder, at most LEAST_AGE_S old."""
        with self._mutex:
            if self._content is None or time.monotonic() - self._content[0] > LEAST_AGE_S:
                content = self._read()
                self._content = time.monotonic(), content
            return self._content[1]

    def _read(self) -> LogsContent:
        campaigns: list[CampaignEntry] = []
        self._notices = []
        runs = [*self._journal(self.logs, "")]
        known = {run.folder.name for run in runs}
        try:
            folders = sorted(
                Path(e.path)
                for e in os.scandir(self.logs)
                if e.name not in known and e.is_dir(follow_symlinks=False)
            )
        except OSError as e:
            self._notices.append(f"the logs folder {self.logs} cannot be read: {e.strerror}")
            folders = []
        for folder in folders:
            if RUN_NAME.match(folder.name):
                runs.append(self._unlisted(folder, ""))
            elif is_campaign(folder):
                campaign, own = self._campaign(folder)
                campaigns.append(campaign)
                runs += own
            elif own := self._runs_below(folder):
                campaigns.append(_folder_entry(folder, own))
                runs += own
        runs.sort(key=lambda run: (run.started or 0.0, run.key), reverse=True)
        campaigns.sort(key=lambda c: (c.begun, c.name), reverse=True)
        return LogsContent(tuple(runs), tuple(campaigns), tuple(self._notices))

    def _journal(self, folder: Path, campaign: str, variant: str = "") -> Sequence[RunEntry]:
        """Return the runs of the journal in `folder`. If the journal cannot be read, there are none, and a notice
        says so."""
        path = journal_path(folder)
        if not path.is_file():
            return ()
        try:
            runs: Sequence[RunEntry] = self._unchanged(
                path,
                lambda: self._journal_runs(path, campaign, variant),
                keep=lambda runs: all(run.status != "running" for run in runs),
            )
        except (CellError, ValueError, LookupError, TypeError) as e:
            self._notices.append(e.what if isinstance(e, CellError) else f"the journal {path} is damaged: {e}")
            return ()
        return runs

    def _journal_runs(self, path: Path, campaign: str, variant: str) -> list[RunEntry]:
        with Journal.open(path, readonly=True, traceless=True) as journal:
            runs = journal.runs()
        return [
            self._entry(
                r.directory, r.garment, r.seed, r.driver, r.status, r.started, record_of(r.summary),
                ending_of(r.summary), campaign=campaign, variant=variant,
            )
            for r in runs
        ]  # fmt: skip

    def _entry(
        self, folder: Path, garment: str, seed: int | None, driver: str, status: str, started: float | None,
        record: RunRecord | None, ending: Ending | None = None, **more: Any,
    ) -> RunEntry:  # fmt: skip
        damage = "" if folder.is_dir() else "its folder is missing"
        key = folder.relative_to(self.logs).as_posix()
        if ending is None:
            ending = Ending(record.failure, record.robot_time_s, record.wall_time_s) if record else Ending()
        return RunEntry(
            key, folder, garment, seed, driver, status, started, ending, record, **{"damage": damage, **more}
        )

    def _unlisted(self, folder: Path, campaign: str) -> RunEntry:
        """Return the entry of a run whose folder is in no journal, with its record if the record can be read."""
        damage = "the journal has no such run"
        record: RunRecord | None = self._unchanged(folder / RECORD, lambda: _record(folder))
        if record is None:
            return self._entry(
                folder, _garment(folder), None, "", DAMAGED, _stamp(folder), None, campaign=campaign, damage=damage
            )
        damage += f"; its {RECORD} says {plain(record.result)}"
        return self._entry(
            folder, record.garment, record.seed, record.driver, DAMAGED, _stamp(folder), record, campaign=campaign,
            damage=damage,
        )  # fmt: skip

    def _runs_below(self, folder: Path) -> list[RunEntry]:
        """Return the runs of a folder that is a damaged campaign or none (scripted runs, endurance)."""
        runs = [*self._journal(folder, folder.name)]
        known = {run.folder for run in runs}
        for path in _folders(folder):
            if RUN_NAME.match(path.name):
                runs += [] if path in known else [self._unlisted(path, folder.name)]
                continue
            for place in (path, *(p for p in _folders(path) if not RUN_NAME.match(p.name))):
                runs += self._journal(place, folder.name)
        return runs

    def _campaign(self, folder: Path) -> tuple[CampaignEntry, list[RunEntry]]:
        try:
            campaign: CampaignFolder = self._unchanged(folder / MANIFEST, lambda: CampaignFolder.open(folder))
        except CellError as e:
            runs = self._runs_below(folder)
            return _folder_entry(folder, runs, e.what), runs
        plan = campaign.campaign
        runs, finished = [], 0
        for request in plan.requests:
            own, done = self._trial(campaign, request)
            runs += own
            finished += done
        entry = CampaignEntry(
            folder.name, plan.about, plan.begun, len(plan.requests), finished,
            sum(run.verdict == "folded" for run in runs), _pages(folder),
        )  # fmt: skip
        return entry, runs

    def _trial(self, campaign: CampaignFolder, request: TrialRequest) -> tuple[Sequence[RunEntry], bool]:
        """Return the runs of one request, and whether the request is finished."""
        folder = campaign.folder(request)
        path = folder / TRIAL
        entry = self._unchanged(path, lambda: self._finished_trial(campaign, request))
        if entry is not None:
            return (entry,), True
        if path.is_file():
            self._notices.append(f"{path} is damaged, or belongs to another request")
        return self._journal(folder, campaign.path.name, request.variant), False

    def _finished_trial(self, campaign: CampaignFolder, request: TrialRequest) -> RunEntry | None:
        trial = read_trial(campaign.folder(request), request)
        if trial is None:
            return None
        folder = campaign.run_folder(trial) or campaign.folder(request)
        ending = None if trial.record else Ending(reason=Refusal(trial.error or "the run has no record", ""))
        entry = self._entry(
            folder, request.garment, request.seed, request.driver, trial.result, _stamp(folder), trial.record,
            ending, campaign=campaign.path.name, variant=request.variant,
        )  # fmt: skip
        return replace(entry, judged=trial.passed if request.attended else None)

    def _unchanged(self, path: Path, read: Callable[[], Any], keep: Callable[[Any], bool] | None = None) -> Any:
        """Return the value that `read` makes of the file. If the file has not changed since the last call, the
        value comes from memory. keep: whether a value may be kept in memory."""
        signature = tuple(_file_signature(p) for p in (path, path.with_name(path.name + "-wal")))
        kept = self._kept.get(path)
        if kept is not None and kept[0] == signature:
            return kept[1]
        value = read()
        if signature[0] is not None and (keep is None or keep(value)):
            self._kept[path] = signature, value
        else:
            self._kept.pop(path, None)
        return value


def _folder_entry(folder: Path, runs: Sequence[RunEntry], damage: str = "") -> CampaignEntry:
    began = min((run.started for run in runs if run.started is not None), default=None)
    begun = "" if began is None else datetime.fromtimestamp(began, UTC).strftime("%Y-%m-%d %H:%M UTC")
    finished = sum(run.status not in UNFINISHED for run in runs)
    about = "scripted runs" if folder.name.startswith("hil-") else ""
    folded = sum(run.verdict == "folded" for run in runs)
    return CampaignEntry(folder.name, about, begun, len(runs), finished, folded, _pages(folder), damage)


def _pages(folder: Path) -> tuple[str, ...]:
    return tuple(name for name in (CAMPAIGN_PAGE, FAULTS_PAGE) if (folder / name).is_file())


def _folders(folder: Path) -> Iterator[Path]:
    try:
        yield from sorted(Path(entry.path) for entry in os.scandir(folder) if entry.is_dir(follow_symlinks=False))
    except OSError:
        return


def _file_signature(path: Path) -> tuple[int, int] | None:
    try:
        found = path.stat()
    except OSError:
        return None
    return found.st_mtime_ns, found.st_size


def _record(folder: Path) -> RunRecord | None:
    try:
        return read_record(folder)
    except StorageError:
        return None


def _stamp(folder: Path) -> float | None:
    """Return the time at which the run began, from its folder's name [s since 1970]."""
    found = RUN_NAME.match(folder.name)
    try:
        return datetime.strptime(found[1], "%Y%m%dT%H%M%SZ").replace(tzinfo=UTC).timestamp() if found else None
    except ValueError:
        return None


def _garment(folder: Path) -> str:
    """Return the garment in the name of a run's folder: `20261120T235416Z-medium_towel-seed3`."""
    return re.sub(r"-seed\d+(-\d+)?$", "", RUN_NAME.sub("", folder.name))
