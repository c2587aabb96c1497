"""The actions of `foldcell garment`."""

from __future__ import annotations

import argparse

from cell.commands.garment import check, list, new, show

__all__ = ["add_options"]


def add_options(parser: argparse.ArgumentParser) -> None:
    actions = parser.add_subparsers(title="actions", metavar="ACTION", required=True)
    for action in (list, check, show, new):
        action.add_options(actions)
