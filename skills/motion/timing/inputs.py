"""Validates the inputs of timing: samples are finite, times increase, and the motion is not too long to be
sampled.

The functions raise `TimingError`; the planners of `foldcell.skills.motion.moves` return it as a failure.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from foldcell.robots.errors import CellError, Failure, FailureKind
from foldcell.robots.ports import Array

__all__ = ["LONGEST_MOTION", "TimingError", "validate_duration", "validate_path", "validate_times"]

LONGEST_MOTION = 600.0
"""Maximum duration of one motion [s]; it has 60 000 samples. Even at the slowest settings of a cell (5 % of the
joints' speed, tools at 0.02 m/s) no motion takes more than about three minutes."""


class TimingError(CellError):
    """Raised when a motion cannot be timed: its samples are not a path, or it would take longer than
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


def validate_path(path: Array, samples: int = 2) -> None:
    """Raises TimingError if a joint path is not at least `samples` vectors of finite numbers."""
    shape = np.shape(path)
    if len(shape) != 2 or shape[0] < samples or shape[1] == 0:
        what = f"a path of shape {shape} cannot be timed: {samples} or more samples are needed"
        raise _bad_input(what, shape=shape)
    _check_finite("joint path", path)


def validate_times(t: Array, samples: int) -> None:
    """Raises TimingError if t does not consist of `samples` finite, increasing times."""
    if np.shape(t) != (samples,):
        raise _bad_input(
            f"{samples} samples of the path do not fit times of shape {np.shape(t)}",
            samples=samples,
            shape=np.shape(t),
        )
    _check_finite("requested times", t)
    step = np.diff(t)
    if step.min() <= 0.0:
        at = int(step.argmin())
        raise _bad_input(
            f"the requested times do not increase: sample {at} is at {t[at]:g} s and sample {at + 1} at"
            f" {t[at + 1]:g} s",
            sample=at,
            step_s=float(step[at]),
        )


def _check_finite(what: str, values: Array) -> None:
    wrong = np.argwhere(~np.isfinite(values))
    if len(wrong):
        first = tuple(int(i) for i in wrong[0])
        raise _bad_input(
            f"the {what} has {len(wrong)} values that are not finite, first {values[first]} at {list(first)}",
            index=list(first),
            count=len(wrong),
        )


def _bad_input(what: str, **values: Any) -> TimingError:
    figures: Mapping[str, Any] = {k: list(v) if isinstance(v, tuple) else v for k, v in values.items()}
    return TimingError(what, "look again at the garment; report this if it repeats", **figures)
