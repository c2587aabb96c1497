"""Refuses motions that are too long to be sampled, by a `TimingError`, which the planners of
`foldcell.skills.motion.moves` return as a failure. They also validate the paths and times that they pass here
(validation/inputs.py)."""

from __future__ import annotations

import numpy as np

from foldcell.robots.errors import CellError, Failure, FailureKind

__all__ = ["LONGEST_MOTION", "TimingError", "validate_duration"]

LONGEST_MOTION = 600.0
"""Maximum duration of one motion [s]; it has 60 000 samples. Even at the slowest settings of a cell (5 % of the
joints' speed, tools at 0.02 m/s) no motion takes more than about three minutes."""


class TimingError(CellError):
    """Raised when a motion cannot be timed: no motion keeps its limits, or it would take longer than
    LONGEST_MOTION."""

    kind = FailureKind.LIMIT_EXCEEDED

    def failure(self) -> Failure:
        """The error as a value, for an `Outcome`."""
        return Failure(self.kind, self.what, self.hint, self.values)


def validate_duration(seconds: float, what: str = "the motion") -> None:
    """Raises TimingError if `seconds` is not finite, or above LONGEST_MOTION. Call it before sampling."""
    if not seconds <= LONGEST_MOTION:  # also true for NaN
        raise TimingError(
            f"{what} would take {seconds:.4g} s; the longest motion takes {LONGEST_MOTION:.0f} s",
            "raise the limits on the joints' velocity, acceleration and jerk and on the tools' speed",
            duration_s=float(seconds) if np.isfinite(seconds) else None,
            longest_s=LONGEST_MOTION,
        )
