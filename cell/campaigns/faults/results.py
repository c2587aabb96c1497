"""The results of a campaign of the table of faults: `faults.json` and `faults.html`."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any
from urllib.parse import quote

from cell.campaigns.faults.fault_table import DueEnd, FaultTable
from cell.campaigns.faults.fault_trials import faults_of
from cell.campaigns.faults.judge import Verdict, due_ends, judge
from cell.campaigns.statistics.proportions import wilson_interval
from cell.campaigns.trials.store import CampaignFolder
from cell.campaigns.trials.trial import Trial
from cell.support.files.html_page import page_template
from cell.support.files.whole_file import write_whole
from cell.support.json_values import to_json

__all__ = ["PAGE", "RESULTS", "Group", "fault_results", "write_fault_results"]

RESULTS, PAGE = "faults.json", "faults.html"
SCHEMA = 1
TWO = " and another"


@dataclass(frozen=True)
class Group:
    """Runs of one row, one cell or one kind of due end. runs: those in which the faults happened; due: those of
    them that ended as due; interval: 95 % Wilson interval of their share; not_struck: runs in which a fault did
    not happen, which prove nothing; not_performed: runs without a result."""

    runs: int
    due: int
    interval: tuple[float, float]
    not_struck: int
    not_performed: int


def fault_results(table: FaultTable, trials: Sequence[Trial]) -> dict[str, Any]:
    """Return the results so far. faults: a row for each fault, alone or with another one, with a cell for each
    garment; totals: by due end of single faults, and of two faults; runs: each with its end."""
    judged = [(trial, judge(table, trial)) for trial in sorted(trials, key=lambda t: t.request.key)]
    rows: dict[str, list[tuple[Trial, Verdict]]] = {}
    totals: dict[str, list[tuple[Trial, Verdict]]] = {}
    for trial, verdict in judged:
        names = faults_of(trial.request)
        rows.setdefault(names[0] + (TWO if len(names) > 1 else ""), []).append((trial, verdict))
        ends = due_ends(table, names)
        totals.setdefault("two faults" if len(names) > 1 else " or ".join(ends), []).append((trial, verdict))
    order = [name + suffix for suffix in ("", TWO) for name in table.faults]
    garments = sorted({trial.request.garment for trial, _ in judged})
    return {
        "schema": SCHEMA,
        "simulated": True,
        "garments": garments,
        "faults": [
            {
                "name": name,
                "due_ends": [end.value for end in due_ends(table, faults_of(rows[name][0][0].request))],
                **asdict(_group(rows[name])),
                "by_garment": {
                    garment: asdict(_group([pair for pair in rows[name] if pair[0].request.garment == garment]))
                    for garment in garments
                },
            }
            for name in order
            if name in rows
        ],
        "totals": {
            name: asdict(_group(totals[name])) for name in (*_kinds_of_due(table), "two faults") if name in totals
        },
        "runs": [_run(trial, verdict) for trial, verdict in judged],
    }


def _kinds_of_due(table: FaultTable) -> list[str]:
    found = [" or ".join(due_ends(table, (name,))) for name in table.faults]
    return sorted(
        set(found), key=lambda ends: (" or " in ends, [e.value for e in DueEnd].index(ends.split(" ")[0]))
    )


def _group(pairs: Sequence[tuple[Trial, Verdict]]) -> Group:
    performed = [verdict for trial, verdict in pairs if trial.performed]
    struck = [verdict for verdict in performed if verdict.struck or not verdict.due]
    due = sum(verdict.good for verdict in struck)
    return Group(
        len(struck),
        due,
        wilson_interval(due, len(struck)),
        len(performed) - len(struck),
        len(pairs) - len(performed),
    )


def _run(trial: Trial, verdict: Verdict) -> dict[str, Any]:
    figures = trial.figures or {}
    return {
        "faults": list(faults_of(trial.request)),
        "garment": trial.request.garment,
        "seed": trial.request.seed,
        "end": verdict.end.value if verdict.end else None,
        "due": verdict.due,
        "struck": verdict.struck,
        "why": verdict.why,
        "robot_time_s": figures.get("robot_time_s"),
        "run_dir": figures.get("run_dir"),
    }


def write_fault_results(table: FaultTable, folder: CampaignFolder, trials: list[Trial]) -> None:
    """Write `faults.json` and `faults.html`. Raises StorageError."""
    results = fault_results(table, trials)
    write_whole(folder.path / RESULTS, json.dumps(to_json(results), indent=1) + "\n")
    write_whole(folder.path / PAGE, _page(table, folder, results))


def _page(table: FaultTable, folder: CampaignFolder, results: Mapping[str, Any]) -> str:
    template = page_template(
        Path(__file__).with_name(PAGE), percent=lambda share: f"{100.0 * share:.0f} %",
        words=lambda text: text.replace("_", " "),
    )  # fmt: skip
    runs = [{**run, "report": _report(folder, run)} for run in results["runs"]]
    return template.render(
        name=folder.path.name,
        planned=len(folder.campaign.requests),
        performed=len(runs),
        good=sum(row["due"] for row in results["totals"].values()),
        struck=sum(row["runs"] for row in results["totals"].values()),
        results={**results, "runs": runs},
        why={name: entry.why for name, entry in table.faults.items()},
        **folder.origin,
    )


def _report(folder: CampaignFolder, run: Mapping[str, Any]) -> str:
    """Return the path of the run's report relative to the campaign's folder; empty if there is none. The campaign
    may have been moved since, so only the last part of the stored path is used."""
    if not run["run_dir"]:
        return ""
    request = next(
        r for r in folder.campaign.requests
        if (list(faults_of(r)), r.garment, r.seed) == (run["faults"], run["garment"], run["seed"])
    )  # fmt: skip
    report = folder.folder(request) / Path(run["run_dir"]).name / "report.html"
    return quote(os.path.relpath(report, folder.path)) if report.is_file() else ""
