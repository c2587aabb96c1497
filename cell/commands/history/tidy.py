"""`foldcell tidy`: removes the recordings of old runs to free disk space."""

from __future__ import annotations

import argparse

from foldcell.cell.commands.shared import answer, count, logs_option, table
from foldcell.cell.runs.pruning import prunable_runs, prune
from foldcell.cell.support.files.paths import logs_to_read

MEBI = 2.0**20


def add_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--keep", type=count, default=50, metavar="N", help="keep the newest N runs complete (50)")
    parser.add_argument("--unfinished", action="store_true", help="include runs that could still be resumed")
    parser.add_argument(
        "--yes", action="store_true", help="remove the recordings; without this they are only listed"
    )
    logs_option(parser)


def run(options: argparse.Namespace) -> int:
    """List the removable recordings; with --yes remove them."""
    logs = logs_to_read(options.logs)
    heavy = prunable_runs(logs, options.keep, options.unfinished)
    if options.yes:
        for each in heavy:
            prune(each)
    total = sum(each.bytes for each in heavy)
    figures = {
        "logs": str(logs),
        "removed": bool(options.yes),
        "bytes": total,
        "runs": [{"run": each.run.id, "bytes": each.bytes} for each in heavy],
    }
    if not heavy:
        return answer(options, figures, [f"nothing to remove in {logs} beyond the newest {options.keep} runs"])
    rows = [(e.run.id, e.run.status, f"{e.bytes / MEBI:.0f}") for e in heavy]
    result = "can be freed (recordings, pictures, transcripts); --yes removes them"
    if options.yes:
        result = "freed; reports, results, settings and the journal stay"
    lines = [*table(("run", "how it ended", "MiB"), rows), f"{total / MEBI:.0f} MiB {result}"]
    return answer(options, figures, lines)
