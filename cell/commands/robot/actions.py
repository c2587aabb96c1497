"""The actions of `foldcell robot`."""

from __future__ import annotations

import argparse

from cell.commands.robot import check, list, new

__all__ = ["add_options"]


def add_options(parser: argparse.ArgumentParser) -> None:
    actions = parser.add_subparsers(title="actions", metavar="ACTION", required=True)
    for action in (list, check, new):
        action.add_options(actions)
