"""The actions of `foldcell library`."""

from __future__ import annotations

import argparse

from cell.commands.library import build, show

__all__ = ["add_options"]


def add_options(parser: argparse.ArgumentParser) -> None:
    actions = parser.add_subparsers(title="actions", metavar="ACTION", required=True)
    for action in (build, show):
        action.add_options(actions)
