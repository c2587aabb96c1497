"""`foldcell runs`: lists the runs of the journal with their status."""

from __future__ import annotations

import argparse
import shlex
import time
from pathlib import Path
from typing import Any

from cell.commands.options import count, json_option, logs_option
from cell.commands.output import print_json, print_table
from cell.journal.checkpoint_file import has_checkpoint
from cell.journal.journal import Journal, JournalRun
from cell.support.files.paths import command_for, journal_path, logs_directory
from robots.errors import ConfigurationError

__all__ = ["add_options", "run", "run_figures"]

MANIFEST = "campaign.json"
"""Name of the file that marks a campaign's folder. The module of campaigns loads the whole cell, so it is imported
only if there is a campaign."""


def add_options(parser: argparse.ArgumentParser) -> None:
    parser.set_defaults(run=run)
    parser.add_argument("--last", type=count, metavar="N", help="list the last N only")
    logs_option(parser)
    json_option(parser)


def run(options: argparse.Namespace) -> int:
    logs = logs_directory(options.logs)
    rows = _read(journal_path(logs), options.last)
    folders = [path.parent for path in sorted(logs.glob(f"*/{MANIFEST}"))]
    campaigns = [_campaign_figures(path) for path in (folders[-options.last :] if options.last else folders)]
    if options.json:
        print_json({"logs": str(logs), "runs": rows, "campaigns": campaigns})
        return 0
    if campaigns:
        _print_campaigns(campaigns)
    if not rows and campaigns:
        return 0
    if not rows:
        print(f"no runs yet in {logs}")
        return 0
    table = [
        (
            r["run"],
            r["garment"],
            r["seed"],
            r["driver"],
            _when(r["started"]),
            r["robot_time_s"],
            r["wall_time_s"],
            _how(r),
        )
        for r in rows
    ]
    print_table(("run", "garment", "seed", "driver", "started", "robot s", "wall s", "how it ended"), table)
    if rows[-1]["status"] == "interrupted" and has_checkpoint(Path(rows[-1]["run_dir"])):
        last = Path(rows[-1]["run_dir"])
        print(f"resume the last one: {command_for(f'resume {last.name}', last.parent)}")
    return 0


def _campaign_figures(path: Path) -> dict[str, Any]:
    """Return the figures of one campaign as a flat mapping. Raises ConfigurationError if the campaign is
    damaged."""
    from cell.campaigns.trials.store import CampaignFolder

    try:
        campaign = CampaignFolder.open(path)
    except ConfigurationError as e:
        return {"campaign": path.name, "about": e.what, "begun": None, "runs": 0, "finished": 0, "folded": 0,
                "directory": str(path)}  # fmt: skip
    finished = campaign.finished()
    return {
        "campaign": path.name,
        "about": campaign.campaign.about,
        "begun": campaign.origin["begun"],
        "runs": len(campaign.campaign.requests),
        "finished": len(finished),
        "folded": sum(trial.success for trial in finished),
        "directory": str(path),
    }


def _print_campaigns(campaigns: list[dict[str, Any]]) -> None:
    print_table(
        ("campaign", "begun", "finished", "folded", "about"),
        [
            (c["campaign"], c["begun"], f"{c['finished']} of {c['runs']}", c["folded"], c["about"] or "-")
            for c in campaigns
        ],
    )
    unfinished = [c for c in campaigns if c["finished"] < c["runs"]]
    if unfinished:
        last = shlex.quote(unfinished[-1]["directory"])
        print(f"continue the last unfinished one: foldcell trials --resume {last}")
    print()


def _read(journal_file: Path, last: int | None) -> list[dict[str, Any]]:
    if not journal_file.exists():
        return []
    with Journal.open(journal_file, readonly=True) as journal:
        records = journal.runs()
        return [run_figures(journal, r) for r in (records[-last:] if last else records)]


def run_figures(journal: Journal, record: JournalRun) -> dict[str, Any]:
    """Return the figures of one run. `last_intent` is the last effect that a run without an end has begun."""
    figures: dict[str, Any] = {
        "run": record.id,
        "status": record.status,
        "garment": record.garment,
        "seed": record.seed,
        "driver": record.driver,
        "started": record.started,
        "ended": record.ended,
        "pid": record.pid,
        "robot_time_s": record.summary.get("robot_time_s"),
        "wall_time_s": record.summary.get("wall_time_s"),
        "reason": (record.summary.get("reason") or {}).get("what"),
        "failure": (record.summary.get("failure") or {}).get("kind"),
        "run_dir": str(record.directory),
        "last_intent": None,
    }
    if record.ended is None:
        intent = journal.last_intent(record.id)
        if intent is not None:
            figures["last_intent"] = {
                "name": intent.begun.name,
                "state": intent.begun.state,
                "cell_time_s": intent.begun.cell_time,
                "finished": intent.result is not None,
            }
    return figures


def _when(started: float) -> str:
    return time.strftime("%Y-%m-%d %H:%M:%S", time.localtime(started))


def _how(row: dict[str, Any]) -> str:
    intent = row["last_intent"]
    if intent is None:
        why = row["reason"] or (row["failure"] or "").replace("_", " ")
        return str(row["status"]) + (f": {why}" if why else "")
    where = "after" if intent["finished"] else "during"
    return f"{row['status']} {where} {intent['name']} at {intent['cell_time_s']:.1f} s" + (
        f" (process {row['pid']})" if row["status"] == "running" else ""
    )
