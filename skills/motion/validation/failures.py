"""Ways of the hands that cannot be gone, told as failures: out of reach, or too near to something."""

from __future__ import annotations

import numpy as np

from robots.errors import Failure, FailureKind
from robots.ports import Array, Side
from skills.vocabulary import Table

__all__ = ["out_of_reach", "too_near"]


def out_of_reach(table: Table, side: Side, what: str, point: Array) -> Failure:
    """UNREACHABLE: an arm does not come to `point` (3,), base frame [m], on its way along `what`."""
    where = [round(float(x), 3) for x in point - np.array([0.0, 0.0, table.height])]
    return Failure(
        FailureKind.UNREACHABLE,
        f"the {side} arm does not reach {what} at {where} (table frame, m)",
        "lay the garment nearer to the middle of the table",
        {"side": str(side), "where_m": where},
    )


def too_near(what: str, pair: str) -> Failure:
    """IN_COLLISION: on the way called `what`, two bodies come nearer to each other than they may."""
    return Failure(
        FailureKind.IN_COLLISION,
        f"{what} comes too near: {pair}",
        "take hold further apart, or with another tilt",
        {"pair": pair},
    )
