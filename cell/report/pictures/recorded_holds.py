"""Recorded frames of a simulated garment, divided into holds: the times during which a hand held the garment."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from foldcell.cell.states.stages import FoldNote
from foldcell.robots.ports import Array, Side

__all__ = ["TrueFrame", "held_during", "holds", "spread"]

TrueFrame = tuple[float, Array, Mapping[Side, Array]]
"""(cell time [s], vertices (n, 3), tool positions (3,)) of a simulated garment, for pictures only."""

BREAK_S = 3.0
"""If the time between two frames of the held garment is longer than this [s], the frames belong to different
attempts."""


def holds(frames: Sequence[TrueFrame]) -> list[list[TrueFrame]]:
    """Divide the frames at the breaks. Every part is one attempt at a fold."""
    parts: list[list[TrueFrame]] = []
    last = -np.inf
    for frame in frames:
        if frame[0] - last > BREAK_S:
            parts.append([])
        parts[-1].append(frame)
        last = frame[0]
    return parts


def held_during(note: FoldNote, frames: Sequence[TrueFrame]) -> list[TrueFrame]:
    """Return the recorded frames of the attempt during which the fold's pictures were taken. The frames of other
    attempts are left out, because those attempts failed."""
    taken = [p.stamp for p in note.attempt.pictures]
    parts = holds(frames)
    return next((h for h in parts if taken and h[0][0] <= max(taken) and min(taken) <= h[-1][0]), [])


def spread(count: int, most: int) -> list[int]:
    """Return up to `most` indices below `count`, evenly spaced, with the first and the last."""
    return [int(i) for i in np.unique(np.linspace(0, count - 1, min(count, most)).round())] if count else []
