"""`foldcell replay RUN`: opens the recording in the viewer, or prints how to open it."""

from __future__ import annotations

import argparse
import os
import subprocess
import sys

from cell.commands.options import json_option, logs_option, run_name
from cell.commands.output import print_json
from cell.journal.journal import Journal
from cell.support.files.paths import journal_path, logs_directory
from cell.view.viewing.viewer import find_viewer, silent_environment
from robots.errors import StorageError

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
    if options.decide:
        from cell.commands.history.decide import run as decide

        return decide(options)
    logs = logs_directory(options.logs)
    with Journal.open(journal_path(logs), readonly=True) as journal:
        record = journal.run(options.name)
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
