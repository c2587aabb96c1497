"""How hard fingertips are pushed while a hand presses on something."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from cell.executive.effects.hands import read_hand
from cell.hardware.workcell import Workcell
from robots.errors import Failure
from robots.ports import JointState, Side
from skills.grasping.hand_reading import fault
from skills.grasping.tare import Zero

__all__ = ["Pushes"]


class Pushes:
    """zeros: of the hands that press. now, strongest: the greater of each hand's tips' rises over its zero, at the
    last look and at any so far [N]."""

    def __init__(self, cell: Workcell, zeros: Mapping[Side, Zero]) -> None:
        self._cell, self._zeros = cell, zeros
        self.now = dict.fromkeys(zeros, 0.0)
        self.strongest = 0.0

    def look(self, state: JointState) -> Failure | None:
        """Read the tips; why nobody can say how hard they are pushed, or None."""
        for side, zeroed in self._zeros.items():
            reading = read_hand(self._cell, side, state)
            bad = fault(reading, self._cell.grasp)
            if bad:
                return bad
            self.now[side] = float(np.max(reading.tactile.tip - zeroed.tip))
            self.strongest = max(self.strongest, self.now[side])
        return None
