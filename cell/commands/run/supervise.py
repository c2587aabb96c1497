"""`foldcell supervise`: performs a run in which an operator approves each fold."""

from __future__ import annotations

import argparse

from foldcell.cell.commands.options import json_option, page_options, run_options
from foldcell.cell.commands.run.fold import run

__all__ = ["add_options"]


def add_options(parser: argparse.ArgumentParser) -> None:
    parser.set_defaults(run=run)
    run_options(parser)
    parser.add_argument("--no-page", dest="page", action="store_false", help="do not serve the operator's page")
    page_options(parser)
    parser.set_defaults(approve=True, realtime=True)
    json_option(parser)
