"""Tells joint states that have stopped changing although the arms are being moved."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from robots.errors import Failure, FailureKind
from robots.ports import Array, JointState

__all__ = ["FROZEN_S", "FrozenStateWatch"]

FROZEN_S = 0.1
"""Positions of moving arms that are the same for longer than this are no readings [s]. Encoders have noise, and no
arm follows its set-points without turning a joint by their resolution."""
FROZEN_RAD = 0.005
"""Smallest motion of the set-points meanwhile [rad]. Encoders of arms at rest may repeat their positions."""


@dataclass(eq=False)
class FrozenStateWatch:
    """The last position that differed from the one before, the time of its reading, and the set-point then.

    The tracking error finds such a state only when the set-points have gone far enough, and never near the end of
    a motion.
    """

    _q: Array | None = None
    _since: float = 0.0
    _setpoint: Array | None = None

    def check(self, state: JointState, setpoint: Array) -> Failure | None:
        """Return STALE_STATE if the positions (joints,) have been exactly the same for more than FROZEN_S, by
        their stamps, while the set-points (joints,) have moved by FROZEN_RAD. Called once per set-point."""
        if self._q is None or self._setpoint is None or not np.array_equal(state.q, self._q):
            self._q, self._since, self._setpoint = state.q, state.stamp, setpoint
            return None
        seconds, moved = state.stamp - self._since, float(np.abs(setpoint - self._setpoint).max())
        if seconds <= FROZEN_S or moved < FROZEN_RAD:
            return None
        return Failure(
            FailureKind.STALE_STATE,
            f"the arms' positions have been exactly the same for {seconds * 1e3:.0f} ms, "
            f"while the set-points moved by {np.rad2deg(moved):.1f} degrees",
            "check the connection to the robot, and that its encoders are read",
            {"frozen_s": seconds, "moved_rad": moved},
        )
