"""`foldcell runs`: lists the runs of the journal with their status."""

from __future__ import annotations

import argparse
import shlex
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from foldcell.cell.commands.shared import answer, count, logs_option, table
from foldcell.cell.journal.checkpoint_file import has_checkpoint
from foldcell.cell.journal.journal import Intent, Journal, JournalRun, performed
from foldcell.cell.record.run_record import Ending, ending_of
from foldcell.cell.record.words import plain
from foldcell.cell.support.files.paths import command_for, journal_path, logs_to_read
from foldcell.robots.errors import ConfigurationError

MANIFEST = "campaign.json"
"""Name of the file that marks a campaign's folder. The module of campaigns loads the whole cell, so it is imported
only if there is a campaign."""


@dataclass(frozen=True)
class ListedRun:
    """A run of the journal and how it ended. last: the last effect begun, for a run that has not ended."""

    run: JournalRun
    ending: Ending
    last: Intent | None

    @classmethod
    def of(cls, journal: Journal, run: JournalRun) -> ListedRun:
        begun = performed(journal.entries(run.id)) if run.ended is None else []
        return cls(run, ending_of(run.summary), begun[-1] if begun else None)

    def as_json(self) -> dict[str, Any]:
        run, ending, last = self.run, self.ending, self.last
        return {
            "run": run.id,
            "status": run.status,
            "garment": run.garment,
            "seed": run.seed,
            "driver": run.driver,
            "started": run.started,
            "ended": run.ended,
            "pid": run.pid,
            "robot_time_s": ending.robot_time_s,
            "wall_time_s": ending.wall_time_s,
            "reason": ending.reason.what if ending.reason else None,
            "failure": ending.failure.kind if ending.failure else None,
            "run_dir": run.directory,
            "last_intent": last
            and {
                "name": last.name,
                "state": last.state,
                "cell_time_s": last.begun_s,
                "finished": last.ended_s is not None,
            },
        }

    @property
    def how(self) -> str:
        """How the run ended, or what it does now, in words."""
        run, failure = self.run, self.ending.failure
        if self.last is None:
            why = plain(failure.kind) if failure else self.ending.why
            return run.status + (f": {why}" if why else "")
        where = "during" if self.last.ended_s is None else "after"
        process = f" (process {run.pid})" if run.status == "running" else ""
        return f"{run.status} {where} {self.last.name} at {self.last.begun_s:.1f} s{process}"

    @property
    def row(self) -> tuple[Any, ...]:
        """The cells of the run's line in the table."""
        run, ending = self.run, self.ending
        started = time.strftime("%Y-%m-%d %H:%M:%S", time.localtime(run.started))
        times = ending.robot_time_s, ending.wall_time_s
        return run.id, run.garment, run.seed, run.driver, started, *times, self.how


def add_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--last", type=count, metavar="N", help="list the last N only")
    logs_option(parser)


def run(options: argparse.Namespace) -> int:
    logs = logs_to_read(options.logs)
    runs: list[ListedRun] = []
    if journal_path(logs).exists():
        with Journal.open(journal_path(logs), readonly=True) as journal:
            rows = journal.runs()
            runs = [ListedRun.of(journal, run) for run in (rows[-options.last :] if options.last else rows)]
    folders = [path.parent for path in sorted(logs.glob(f"*/{MANIFEST}"))]
    campaigns = [_campaign_figures(path) for path in (folders[-options.last :] if options.last else folders)]
    figures = {"logs": logs, "runs": [each.as_json() for each in runs], "campaigns": campaigns}
    lines = _lines_of_campaigns(campaigns) if campaigns else []
    if not campaigns and not runs:
        lines = [f"no runs yet in {logs}"]
    if runs:
        names = ("run", "garment", "seed", "driver", "started", "robot s", "wall s", "how it ended")
        lines += table(names, [each.row for each in runs])
        last = runs[-1].run
        if last.status == "interrupted" and has_checkpoint(last.directory):
            lines.append(f"resume the last one: {command_for(f'resume {last.id}', logs)}")
    return answer(options, figures, lines)


def _campaign_figures(path: Path) -> dict[str, Any]:
    """Return the figures of one campaign as a flat mapping. Raises ConfigurationError if the campaign is
    damaged."""
    from foldcell.cell.campaigns.trials.store import CampaignFolder

    try:
        campaign = CampaignFolder.open(path)
    except ConfigurationError as e:
        return {"campaign": path.name, "about": e.what, "begun": None, "runs": 0, "finished": 0, "folded": 0,
                "directory": str(path)}  # fmt: skip
    finished = campaign.finished()
    return {
        "campaign": path.name,
        "about": campaign.campaign.about,
        "begun": campaign.campaign.begun,
        "runs": len(campaign.campaign.requests),
        "finished": len(finished),
        "folded": sum(trial.success for trial in finished),
        "directory": str(path),
    }


def _lines_of_campaigns(campaigns: list[dict[str, Any]]) -> list[str]:
    rows = [
        (c["campaign"], c["begun"], f"{c['finished']} of {c['runs']}", c["folded"], c["about"] or "-")
        for c in campaigns
    ]
    lines = [*table(("campaign", "begun", "finished", "folded", "about"), rows)]
    unfinished = [shlex.quote(c["directory"]) for c in campaigns if c["finished"] < c["runs"]]
    if unfinished:
        lines.append(f"continue the last unfinished one: foldcell trials --resume {unfinished[-1]}")
    return [*lines, ""]
