"""`foldcell garment`: its actions."""

from __future__ import annotations

import argparse

from cell.commands.garment import files, new

__all__ = ["add_options"]


def add_options(parser: argparse.ArgumentParser) -> None:
    actions = parser.add_subparsers(title="actions", metavar="ACTION", required=True)
    files.add_actions(actions)
    new.add_actions(actions)
