"""`foldcell report RUN`: prints the effects of a run, from the journal, and the path of its report page."""

from __future__ import annotations

import argparse
from typing import Any

from foldcell.cell.commands.history.runs import ListedRun
from foldcell.cell.commands.shared import answer, logs_option, run_name
from foldcell.cell.journal.journal import NOT_BEGUN, Intent, Journal, JournalRun, performed
from foldcell.cell.runs.resumable import resumable
from foldcell.cell.support.files.paths import command_for, journal_path, logs_of_run


def add_options(parser: argparse.ArgumentParser) -> None:
    run_name(parser)
    logs_option(parser)


def run(options: argparse.Namespace) -> int:
    logs = logs_of_run(options.name, options.logs)
    with Journal.open(journal_path(logs), readonly=True) as journal:
        run = journal.run(options.name)
        listed = ListedRun.of(journal, run)
        effects = performed(journal.entries(run.id))
        may_resume = resumable(journal, run.id)
    page = run.directory / "report.html"
    figures = {
        **listed.as_json(),
        "resumable": may_resume,
        "summary": run.summary,
        "effects": [_figures(effect) for effect in effects],
        "report": page if page.is_file() else None,
    }
    lines = [f"{run.id}: {run.status}"]
    lines += [f"  {effect.begun_s:8.1f} s  {effect.name:<20} {_ending(effect)}" for effect in effects]
    if run.status == "interrupted":
        lines.append(
            "  the process ended here without ending the run (killed, machine down, or the journal's disk full)"
        )
    if reason := listed.ending.reason:
        lines.append(f"  the run did not begin: {reason.what}" + (f"\n  {reason.hint}" if reason.hint else ""))
    if may_resume:
        lines.append(f"resume  {command_for(f'resume {run.id}', run.directory.parent)}")
    return answer(options, figures, [*lines, f"report  {page if page.is_file() else _no_page(run)}"])


def _no_page(run: JournalRun) -> str:
    """Return the reason why there is no page, and the command that opens the recording if there is one."""
    recorded = (run.directory / "run.rrd").is_file()
    command = command_for(f"replay {run.id}", run.directory.parent)
    replay = f"\n        {command} opens the recording" if recorded else ""
    if run.status == "running":
        return f"none yet: the run has not ended (pid {run.pid}); fold --live shows a run while it lasts{replay}"
    if run.status == NOT_BEGUN:
        return "none: nothing was done"
    if run.status == "interrupted":
        return f"none: the run was interrupted before the report was written{replay}"
    if not (run.directory / "result.json").is_file():
        return "none: the run has ended, but its report is still being written or was interrupted"
    return f"none: see {run.directory}"


def _figures(effect: Intent) -> dict[str, Any]:
    names = ("name", "state", "begun_s", "ended_s", "event", "failure", "what")
    return {name: getattr(effect, name) for name in names}


def _ending(effect: Intent) -> str:
    if effect.ended_s is None:
        return "begun, not finished"
    took = f"{effect.ended_s - effect.begun_s:.1f} s"
    if effect.failure:
        return f"{took}  {effect.failure}: {effect.what}"
    return took if effect.event in (None, "done") else f"{took}  {effect.event}"
