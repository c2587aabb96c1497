"""`foldcell dashboard`: serves a page with all runs and campaigns of a logs folder, until it is interrupted."""

from __future__ import annotations

import argparse
import threading

from foldcell.cell.commands.shared import answer, logs_option, port
from foldcell.cell.support.files.paths import logs_directory
from foldcell.robots.errors import StorageError


def add_options(parser: argparse.ArgumentParser) -> None:
    logs_option(parser)
    parser.add_argument("--port", type=port, default=0, metavar="N", help="port of the page (a free one)")


def run(options: argparse.Namespace) -> int:
    """Print the page's address and serve the page until a signal ends the command. Raises StorageError if there is
    no such folder or the port is in use."""
    from foldcell.cell.campaigns.dashboard.server import served_history
    from foldcell.cell.operator.local_server import open_listener

    logs = logs_directory(options.logs)
    if not logs.is_dir():
        raise StorageError(
            f"there is no logs folder {logs}", "foldcell fold makes one; or name another: --logs DIR"
        )
    with served_history(logs, open_listener(options.port)) as address:
        lines = [f"history of {logs}", f"page     {address}", "Ctrl-C ends it"]
        answer(options, {"logs": str(logs), "address": address}, lines)
        threading.Event().wait()
    return 0
