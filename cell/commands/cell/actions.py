"""The actions of `foldcell cell`."""

from __future__ import annotations

import argparse

from cell.commands.cell import check

__all__ = ["add_options"]


def add_options(parser: argparse.ArgumentParser) -> None:
    actions = parser.add_subparsers(title="actions", metavar="ACTION", required=True)
    check.add_options(actions)
