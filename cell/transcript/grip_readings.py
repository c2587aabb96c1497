"""The grip forces that the pads measured in a run as arrays, read from its transcript."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from foldcell.cell.transcript.channels import Channel
from foldcell.cell.transcript.transcript import Transcript
from foldcell.robots.ports import Array, TactileReading, frozen

__all__ = ["read_grips"]


def read_grips(transcript: Transcript) -> Mapping[str, Array]:
    """Return 'left' and 'right' -> (k, 2), rows of time [s] and grip force [N], one for each reading of a hand's
    pads. Raises StorageError for a damaged transcript."""
    rows: dict[str, list[tuple[float, float]]] = {side: [] for side in transcript.constants.max_opening}
    for exchange in transcript:
        answer = exchange.answer
        if exchange.channel is Channel.TACTILE and isinstance(answer, TactileReading):
            rows[answer.side.value].append((answer.stamp, answer.grip))
    return {side: frozen(np.array(values, float).reshape(-1, 2)) for side, values in rows.items()}
