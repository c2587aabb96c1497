"""How hard fingertips are pushed while a hand presses on something."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from cell.control.motions.hands import Hands
from robots.errors import Failure
from robots.ports import JointState, Side
from skills.grasping.hand_reading import validate_reading
from skills.grasping.settings import GraspSettings
from skills.grasping.tare import TactileBias

__all__ = ["FingertipForceMonitor"]


class FingertipForceMonitor:
    """zeros: of the hands that press. now, strongest: the greater of each hand's tips' rises over its zero, at the
    last look and at any so far [N]."""

    def __init__(self, hands: Hands, settings: GraspSettings, zeros: Mapping[Side, TactileBias]) -> None:
        self._hands, self._settings, self._zeros = hands, settings, zeros
        self.now = dict.fromkeys(zeros, 0.0)
        self.strongest = 0.0

    def look(self, state: JointState) -> Failure | None:
        """Read the tips; why nobody can say how hard they are pushed, or None."""
        for side, zeroed in self._zeros.items():
            reading = self._hands.read(side, state)
            bad = validate_reading(reading, self._settings)
            if bad:
                return bad
            self.now[side] = float(np.max(reading.tactile.tip - zeroed.tip))
            self.strongest = max(self.strongest, self.now[side])
        return None
