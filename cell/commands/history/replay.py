"""`foldcell replay RUN`: opens the recording in the viewer, or prints how to open it. With --decide it checks
whether the present program repeats the decisions of the recorded run."""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
from collections.abc import Sequence
from typing import TYPE_CHECKING

from foldcell.cell.commands.options import json_option, logs_option, run_name
from foldcell.cell.commands.output import print_json, progress_stream
from foldcell.cell.journal.journal import Entry, Journal, JournalRun
from foldcell.cell.support.files.paths import journal_path, logs_directory
from foldcell.cell.view.viewing.viewer import find_viewer, silent_environment
from foldcell.robots.errors import StorageError

if TYPE_CHECKING:
    from foldcell.cell.runs.decide_again import Verdict

__all__ = ["add_options", "run"]


def add_options(parser: argparse.ArgumentParser) -> None:
    parser.set_defaults(run=run)
    run_name(parser)
    parser.add_argument(
        "--decide", action="store_true",
        help="make the run's decisions again from its recorded readings and compare; exit code 2 if one differs",
    )  # fmt: skip
    parser.add_argument("--no-viewer", action="store_true", help="only print where the recording is")
    logs_option(parser)
    json_option(parser)


def run(options: argparse.Namespace) -> int:
    """Open the recording, or decide again. Returns 2 if another decision was taken."""
    with Journal.open(journal_path(logs_directory(options.logs)), readonly=True) as journal:
        record = journal.run(options.name)
        entries = journal.entries(record.id) if options.decide else []
    if options.decide:
        return _decide(record, entries, options.json)
    recording = record.directory / "run.rrd"
    if not recording.is_file():
        raise StorageError(
            f"the run {record.id} ({record.status}) has no recording {recording}",
            f"foldcell report {record.id} shows the journal of the run",
        )
    viewer = find_viewer()
    screen = bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")) or sys.platform == "darwin"
    opened = viewer is not None and screen and not options.no_viewer and not options.json
    if options.json:
        print_json({"run": record.id, "recording": str(recording), "viewer": str(viewer) if viewer else None})
        return 0
    print(f"recording  {recording}")
    if opened:
        subprocess.Popen([str(viewer), str(recording)], start_new_session=True, env=silent_environment())
        print("opened in the Rerun viewer")
    else:
        why = "" if screen else " (this terminal has no display: copy the file to a machine that has one)"
        print(f"open it with   {viewer or 'rerun'} {recording}{why}")
        print(f"or a browser   {viewer or 'rerun'} --web-viewer {recording}")
    return 0


def _decide(run: JournalRun, entries: Sequence[Entry], as_json: bool) -> int:
    """Check whether the present program repeats the decisions of a recorded run."""
    from foldcell.cell.operator.progress.compiling import report_compilation
    from foldcell.cell.operator.progress.lines import ProgressLines
    from foldcell.cell.runs.decide_again import changed_versions, decide_again

    changed = changed_versions(run.versions)
    lines = ProgressLines(progress_stream(as_json))
    lines.note(f"deciding {run.id} again from its recorded readings")
    for name, (then, now) in changed.items():
        lines.note(f"the version of {name} was {then} and is {now} now")
    with report_compilation(lines.note):
        verdict = decide_again(run, entries, (lines,), lines.note, lines.computing)
    if as_json:
        then_and_now = {name: {"then": then, "now": now} for name, (then, now) in changed.items()}
        print_json({"run": run.id, "same": verdict.same, **vars(verdict), "changed_versions": then_and_now})
    else:
        _print_verdict(verdict)
    return 0 if verdict.same else 2


def _print_verdict(verdict: Verdict) -> None:
    compared = (
        f"{verdict.effects} effects, {verdict.set_points} set-points, {verdict.pictures} pictures,"
        f" {verdict.exchanges} exchanges with the cell"
    )
    deviation = verdict.deviation
    if deviation is None:
        print(f"\nthe same decisions: {compared}, in {verdict.wall_time_s:.0f} s")
        if verdict.broken_off:
            print(f"  up to {verdict.cell_time_s:.2f} s: {verdict.broken_off}")
        return
    effect = f", effect {deviation.effect}" if deviation.effect else ""
    print(f"\nANOTHER DECISION at {deviation.cell_time_s:.2f} s, state {deviation.state}{effect}")
    print(f"  then   {deviation.then}")
    print(f"  now    {deviation.now}")
    print(f"  in {deviation.place}; equal before it: {compared}")
