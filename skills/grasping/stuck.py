"""After release and retreat: does cloth still cling to a finger?

Open pads in the air should read their zero. What is left over on one pad is cloth when it exceeds what noise
and drift since the zero can explain.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from skills.grasping.reading import HandReading, fault
from skills.grasping.settings import GraspSettings
from skills.grasping.zero import Zero
from skills.vocabulary import Array, Failure, FailureKind, Outcome

__all__ = ["Clear", "StuckCheck", "check_stuck", "start_stuck_check"]


@dataclass(frozen=True)
class Clear:
    """The larger residual of the two pads and the bound that it was held against [N]."""

    residual: float
    bound: float


@dataclass(frozen=True, eq=False)
class StuckCheck:
    settings: GraspSettings
    zero: Zero
    stamp: float = -np.inf
    pads: tuple[Array, ...] = ()


def start_stuck_check(settings: GraspSettings, zero: Zero) -> StuckCheck:
    """`zero`: the one from before the grasp."""
    return StuckCheck(settings, zero)


def check_stuck(reading: HandReading, state: StuckCheck) -> StuckCheck | Outcome[Clear]:
    """One tick, hand open and clear of the stack. Failures: STUCK_ON_FINGER, and as `fault` says."""
    s = state.settings
    bad = fault(reading, s)
    if bad:
        return Outcome(failure=bad)
    if reading.tactile.stamp <= state.stamp:
        return state
    state = replace(state, stamp=reading.tactile.stamp, pads=(*state.pads, state.zero.pads(reading)))
    if len(state.pads) < s.stuck_readings:
        return state
    mean = np.mean(state.pads, axis=0)
    pad = int(mean.argmax())
    residual, bound = float(mean[pad]), residual_bound(state.zero, reading.stamp, s)
    if residual < bound:
        return Outcome(Clear(residual, bound))
    return Outcome(
        failure=Failure(
            FailureKind.STUCK_ON_FINGER,
            f"{residual:.2f} N are left on pad {pad} of the open {reading.tactile.side} hand",
            "pull the cloth off the finger",
            {"pad": pad, "residual_n": residual, "bound_n": bound},
        )
    )


def residual_bound(zero: Zero, now: float, settings: GraspSettings) -> float:
    """Largest mean force of an unloaded pad that noise and drift since the zero explain [N].

    Each cell drifts as a first-order process of standard deviation `drift_force` and time `drift_time`.
    """
    s = settings
    cells = zero.cells[0].size
    drift = 2.0 * s.drift_force**2 * (1.0 - np.exp(-max(now - zero.stamp, 0.0) / s.drift_time))
    noise = zero.cell_noise**2 * (1.0 / s.stuck_readings + 1.0 / s.zero_readings)
    return max(s.stuck_force, s.stuck_sigmas * float(np.sqrt(cells * (drift + noise))))
