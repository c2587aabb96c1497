"""The actions of `foldcell calibrate`."""

from __future__ import annotations

import argparse

from cell.commands.calibrate import (
    bending,
    board,
    camera,
    crease,
    friction,
    hand_eye,
    paper,
    shear,
    table,
    tactile,
)

__all__ = ["add_options"]


def add_options(parser: argparse.ArgumentParser) -> None:
    actions = parser.add_subparsers(title="actions", metavar="ACTION", required=True)
    for action in (board, table, camera, hand_eye, tactile, shear, friction, bending, crease, paper):
        action.add_options(actions)
