"""`foldcell supervise`: performs a run in which an operator approves each fold."""

from __future__ import annotations

import argparse

from foldcell.cell.commands.run.fold import run
from foldcell.cell.commands.shared import page_options, run_options

__all__ = ["add_options", "run"]


def add_options(parser: argparse.ArgumentParser) -> None:
    run_options(parser)
    parser.add_argument("--no-page", dest="page", action="store_false", help="do not serve the operator's page")
    page_options(parser)
    parser.set_defaults(approve=True, realtime=True)
