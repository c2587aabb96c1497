"""`foldcell calibrate`: its actions."""

from __future__ import annotations

import argparse

from cell.commands.calibrate import board, cell, material

__all__ = ["add_options"]


def add_options(parser: argparse.ArgumentParser) -> None:
    actions = parser.add_subparsers(title="actions", metavar="ACTION", required=True)
    board.add_actions(actions)
    cell.add_actions(actions)
    material.add_actions(actions)
