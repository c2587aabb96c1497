"""`foldcell resume RUN`: resumes a run that was killed, stopped or ended before the garment was folded."""

from __future__ import annotations

import argparse
from typing import Any

from foldcell.cell.commands.run.fold import tell
from foldcell.cell.commands.shared import logs_option, run_name
from foldcell.cell.journal.journal import Journal
from foldcell.cell.support.files.paths import journal_path, logs_of_run, prepare_logs


def add_options(parser: argparse.ArgumentParser) -> None:
    run_name(parser)
    logs_option(parser)
    parser.add_argument("--live", action="store_true", help="show the run in a Rerun viewer while it lasts")
    parser.add_argument("--approve", action="store_true", help="ask before each fold, even if the run did not")


def run(options: argparse.Namespace) -> int:
    """Read and check the interrupted run, then open the cell and resume the run. Raises ConfigurationError,
    StorageError."""
    from foldcell.cell.runs.checkpoint_writer import interrupted_run
    from foldcell.cell.runs.fold_run import fold_once

    logs = logs_of_run(options.name, options.logs)
    changes: dict[str, Any] = {"quiet": options.json, "live": options.live}
    if options.approve:
        changes["approve"] = True
    with Journal.open(journal_path(logs), readonly=True) as journal:
        interrupted = interrupted_run(journal, options.name, logs, **changes)
    prepare_logs(logs)
    return tell(fold_once(interrupted.request, interrupted=interrupted), options)
