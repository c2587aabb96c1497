"""`foldcell replay RUN`: opens the recording in the viewer, or prints how to open it. With --decide it checks
whether the present program repeats the decisions of the recorded run."""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING

from foldcell.cell.commands.shared import answer, logs_option, progress_stream, run_name
from foldcell.cell.journal.journal import Entry, Journal, JournalRun
from foldcell.cell.support.files.paths import journal_path, logs_of_run
from foldcell.cell.view.viewer import find_viewer, silent_environment
from foldcell.robots.errors import StorageError

if TYPE_CHECKING:
    from foldcell.cell.runs.decide_again import Verdict


def add_options(parser: argparse.ArgumentParser) -> None:
    run_name(parser)
    parser.add_argument(
        "--decide", action="store_true",
        help="make the run's decisions again from its recorded readings and compare; exit code 2 if one differs",
    )  # fmt: skip
    parser.add_argument("--no-viewer", action="store_true", help="only print where the recording is")
    logs_option(parser)


def run(options: argparse.Namespace) -> int:
    """Open the recording, or decide again. Returns 2 if another decision was taken."""
    with Journal.open(journal_path(logs_of_run(options.name, options.logs)), readonly=True) as journal:
        record = journal.run(options.name)
        entries = journal.entries(record.id) if options.decide else []
    if options.decide:
        return _decide(record, entries, options)
    recording = record.directory / "run.rrd"
    if not recording.is_file():
        raise StorageError(
            f"the run {record.id} ({record.status}) has no recording {recording}",
            f"foldcell report {record.id} shows the journal of the run",
        )
    viewer = find_viewer()
    screen = bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")) or sys.platform == "darwin"
    why = "" if screen else " (this terminal has no display: copy the file to a machine that has one)"
    lines = [
        f"open it with   {viewer or 'rerun'} {recording}{why}",
        f"or a browser   {viewer or 'rerun'} --web-viewer {recording}",
    ]
    if viewer is not None and screen and not options.no_viewer and not options.json:
        subprocess.Popen([str(viewer), str(recording)], start_new_session=True, env=silent_environment())
        lines = ["opened in the Rerun viewer"]
    figures = {"run": record.id, "recording": str(recording), "viewer": str(viewer) if viewer else None}
    return answer(options, figures, [f"recording  {recording}", *lines])


def _decide(run: JournalRun, entries: Sequence[Entry], options: argparse.Namespace) -> int:
    """Check whether the present program repeats the decisions of a recorded run."""
    from foldcell.cell.operator.progress.compiling import report_compilation
    from foldcell.cell.operator.progress.lines import ProgressLines
    from foldcell.cell.runs.decide_again import changed_versions, decide_again

    changed = changed_versions(run.versions)
    lines = ProgressLines(progress_stream(options.json))
    lines.note(f"deciding {run.id} again from its recorded readings")
    for name, (then, now) in changed.items():
        lines.note(f"the version of {name} was {then} and is {now} now")
    with report_compilation(lines.note):
        verdict = decide_again(run, entries, (lines,), lines.note, lines.computing)
    then_and_now = {name: {"then": then, "now": now} for name, (then, now) in changed.items()}
    figures = {"run": run.id, "same": verdict.same, **vars(verdict), "changed_versions": then_and_now}
    return answer(options, figures, _lines_of(verdict), 0 if verdict.same else 2)


def _lines_of(verdict: Verdict) -> Iterator[str]:
    compared = (
        f"{verdict.effects} effects, {verdict.set_points} set-points, {verdict.pictures} pictures,"
        f" {verdict.exchanges} exchanges with the cell"
    )
    deviation = verdict.deviation
    if deviation is None:
        yield f"\nthe same decisions: {compared}, in {verdict.wall_time_s:.0f} s"
        if verdict.broken_off:
            yield f"  up to {verdict.cell_time_s:.2f} s: {verdict.broken_off}"
        return
    effect = f", effect {deviation.effect}" if deviation.effect else ""
    yield f"\nANOTHER DECISION at {deviation.cell_time_s:.2f} s, state {deviation.state}{effect}"
    yield f"  then   {deviation.then}"
    yield f"  now    {deviation.now}"
    yield f"  in {deviation.place}; equal before it: {compared}"
