"""The pressure cells of a gripper's pads over ROS."""

from __future__ import annotations

from typing import Any

import numpy as np

from foldcell.robots.baxter.ros.messages import load_messages
from foldcell.robots.baxter.ros.ports.latest_message import LatestMessage
from foldcell.robots.baxter.ros.topics import TACTILE
from foldcell.robots.ports import Clock, Side, TactileReading, frozen
from foldcell.robots.ros.node import Node


class RosTactile:
    """The tactile pads of one gripper. rows: rows of cells on each pad."""

    def __init__(self, node: Node, clock: Clock, side: Side, rows: int) -> None:
        self.side, self._rows = side, rows
        self._shape: tuple[int, ...] | None = None
        """Shape of the pads in the first message."""
        kind = load_messages().tactile_state
        self.hearing = LatestMessage(node, clock, TACTILE.format(side), kind, self._read, in_order=True)

    def reading(self) -> TactileReading:
        """Return the latest reading, with its time of arrival. Before the first message its values are NaN and its
        stamp is -inf."""
        unknown = np.full((2, self._rows, 1), np.nan), np.full(2, np.nan)
        return self.hearing.newest or TactileReading(-np.inf, self.side, *map(frozen, unknown))

    def _read(self, message: Any, stamp: float) -> TactileReading | None:
        """Read a message. Returns None if a channel is missing, a value is not finite, or the shape differs from
        the first message. The shape must not change, because a tare and a reading need the same cells."""
        channels = {c.name: np.asarray(c.values, dtype=np.float64) for c in message.sensors}
        try:
            pads = np.stack([channels["pad_0"], channels["pad_1"]]).reshape(2, self._rows, -1)
            tips = channels["tips"].reshape(2)
        except (KeyError, ValueError):
            return None
        if pads.size == 0 or not (np.isfinite(pads).all() and np.isfinite(tips).all()):
            return None
        self._shape = self._shape or pads.shape
        if pads.shape != self._shape:
            return None
        return TactileReading(stamp, self.side, frozen(pads), frozen(tips))
