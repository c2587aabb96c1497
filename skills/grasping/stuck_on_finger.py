"""After release and retreat: does cloth still cling to a finger?

Open pads in the air should read their zero. What is left over on one pad is cloth when it exceeds what noise
and drift since the zero can explain.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from skills.grasping.hand_reading import HandReading, fault
from skills.grasping.settings import GraspSettings
from skills.grasping.tare import TactileBias
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
    tare: TactileBias
    stamp: float = -np.inf
    pads: tuple[Array, ...] = ()


def start_stuck_check(settings: GraspSettings, tare: TactileBias) -> StuckCheck:
    """`zero`: the one from before the grasp."""
    return StuckCheck(settings, tare)


def check_stuck(reading: HandReading, state: StuckCheck) -> StuckCheck | Outcome[Clear]:
    """One tick, hand open and clear of the stack. Failures: STUCK_ON_FINGER, and as `fault` says."""
    s = state.settings
    bad = fault(reading, s)
    if bad:
        return Outcome(failure=bad)
    if reading.tactile.stamp <= state.stamp:
        return state
    state = replace(state, stamp=reading.tactile.stamp, pads=(*state.pads, state.tare.pads(reading)))
    if len(state.pads) < s.stuck_readings:
        return state
    mean = np.mean(state.pads, axis=0)
    pad = int(mean.argmax())
    residual, bound = float(mean[pad]), residual_bound(state.tare, reading.stamp, s)
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


def residual_bound(tare: TactileBias, now: float, settings: GraspSettings) -> float:
    """Largest mean force of an unloaded pad that noise and drift since the zero explain [N].

    A cell that wanders with standard deviation sigma and period T has moved by 2 sigma sin(pi t / T) after a
    time t, in the mean over its phases; by 2 sigma at most.
    """
    s = settings
    cells = tare.cells[0].size
    share = float(np.clip((now - tare.stamp) / s.drift_time, 0.0, 0.5))
    drift = 2.0 * s.drift_ratio * tare.cell_noise * np.sin(np.pi * share)
    noise = tare.cell_noise * np.sqrt(1.0 / s.stuck_readings + 1.0 / s.zero_readings)
    return max(s.stuck_force, s.stuck_sigmas * float(np.sqrt(cells) * np.hypot(drift, noise)))
