"""Monitors the forces on the fingertips while hands press on something."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from cell.control.motions.hands import Hands
from robots.errors import Failure
from robots.ports import JointState, Side
from skills.grasping.hand_reading import validate_reading
from skills.grasping.tare import TactileBias

__all__ = ["FingertipForceMonitor"]


class FingertipForceMonitor:
    """Monitors the forces on the fingertips of pressing hands.

    biases: tactile bias of each hand. now: largest force on a tip of each hand in its latest reading [N].
    strongest: largest force on a tip in all readings so far [N].
    """

    def __init__(self, hands: Hands, biases: Mapping[Side, TactileBias]) -> None:
        self._hands, self._biases = hands, biases
        self.now = dict.fromkeys(biases, 0.0)
        self.strongest = 0.0

    def look(self, state: JointState) -> Failure | None:
        """Read the tip forces of all hands. Returns a failure if a force cannot be measured."""
        for side, bias in self._biases.items():
            reading = self._hands.read(side, state)
            failure = validate_reading(reading)
            if failure:
                return failure
            self.now[side] = float(np.max(reading.tactile.tip - bias.tip))
            self.strongest = max(self.strongest, self.now[side])
        return None
