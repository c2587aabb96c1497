"""Creates the failures of hand motions: out of reach, or in collision."""

from __future__ import annotations

import numpy as np

from foldcell.robots.errors import Failure, FailureKind
from foldcell.robots.ports import Array, Side
from foldcell.skills.vocabulary import Table

__all__ = ["out_of_reach", "too_near"]


def out_of_reach(table: Table, side: Side, what: str, point: Array) -> Failure:
    """Create the failure UNREACHABLE: an arm cannot reach `point` (3,) [m], base frame. what: the part of the
    motion, in words."""
    where = [round(float(x), 3) for x in point - np.array([0.0, 0.0, table.height])]
    return Failure(
        FailureKind.UNREACHABLE,
        f"the {side} arm does not reach {what} at {where} (table frame, m)",
        "lay the garment nearer to the middle of the table",
        {"side": str(side), "where_m": where},
    )


def too_near(what: str, pair: str) -> Failure:
    """Create the failure IN_COLLISION: two bodies are nearer than allowed. what: the part of the motion, in words.
    pair: the bodies' names."""
    return Failure(
        FailureKind.IN_COLLISION,
        f"{what} is in collision: {pair}",
        "grasp further apart, or with another lean",
        {"pair": pair},
    )
