"""`foldcell resume RUN`: go on with a run that was killed, stopped or ended before the garment was folded."""

from __future__ import annotations

import argparse
from typing import Any

from cell.recording.journal import Journal
from cell.subcommands.fold import tell
from cell.support.files.paths import ledger_path, logs_directory, prepare_logs

__all__ = ["run"]


def run(options: argparse.Namespace) -> int:
    """What is left of the run is read and checked before the cell is opened."""
    from cell.runs.checkpoint_writer import interrupted_run
    from cell.runs.fold_run import fold_once

    logs = logs_directory(options.logs)
    changes: dict[str, Any] = {"quiet": options.json, "live": options.live}
    if options.approve:
        changes["approve"] = True
    with Journal.open(ledger_path(logs), readonly=True) as journal:
        interrupted = interrupted_run(journal, options.name, logs, **changes)
    prepare_logs(logs)
    return tell(fold_once(interrupted.request, interrupted=interrupted), options.json)
