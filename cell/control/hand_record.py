"""The measured course of the hands while they carry cloth."""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from foldcell.robots.ports import Array, JointState, Side

LONGEST = 12000
"""Largest number of recorded readings; older ones are dropped."""


@dataclass(eq=False)
class HandRecord:
    """The measured joints and the openings of both grippers since the hands lifted cloth.

    The set-points tell where the hands should be. After an arm has fallen or hung, only these readings tell where
    they were, and when the cloth was lost.
    """

    _begun: bool = False
    _readings: deque[tuple[float, Array, tuple[float, ...]]] = field(default_factory=lambda: deque(maxlen=LONGEST))
    clung_until: dict[Side, float] = field(default_factory=dict)
    """The time until which cloth clung to a finger of each open hand [s]."""

    def begin(self) -> None:
        """Record from now on, because the hands lift cloth."""
        self.forget()
        self._begun = True

    def end(self) -> None:
        """Record no more, because the hands are open and leave the cloth. The readings are kept."""
        self._begun = False

    def freed(self, side: Side) -> None:
        """Note that this hand came free of cloth just now, although it was open before."""
        if self._readings:
            self.clung_until[side] = self._readings[-1][0]

    def forget(self) -> None:
        """Forget the readings, and record no others."""
        self._readings.clear()
        self.clung_until.clear()
        self._begun = False

    def add(self, state: JointState, openings: Mapping[Side, float]) -> None:
        """Record the arms' state and the gripper openings [m], unless the state is not newer than the last one or
        is not finite."""
        newer = not self._readings or state.stamp > self._readings[-1][0]
        if self._begun and newer and np.isfinite(state.q).all():
            self._readings.append((state.stamp, np.array(state.q), tuple(openings[side] for side in Side)))

    def readings(self) -> tuple[Array, Array, Array]:
        """Return times (n,) [s], joints (n, joints) [rad] and openings (n, 2) [m], in the order of Side."""
        if not self._readings:
            return np.zeros(0), np.zeros((0, 0)), np.zeros((0, len(Side)))
        t, q, openings = zip(*self._readings, strict=True)
        return np.array(t), np.array(q), np.array(openings)
