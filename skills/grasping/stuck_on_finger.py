"""Controller that checks, after release and retreat, whether cloth clings to a finger.

Open, unloaded pads should read their bias. If a residual force on one pad is larger than noise, and drift since
the tare, can explain, cloth clings to this pad.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from skills.grasping.hand_reading import HandReading, validate_reading
from skills.grasping.settings import GraspSettings
from skills.grasping.tare import TactileBias
from skills.vocabulary import Array, Failure, FailureKind, Outcome

__all__ = ["Clear", "StuckCheck", "check_stuck", "start_stuck_check"]


@dataclass(frozen=True)
class Clear:
    """Result of the check when no cloth clings. residual: mean force on the more loaded pad [N]. bound: limit with
    which it was compared [N]."""

    residual: float
    bound: float


@dataclass(frozen=True, eq=False)
class StuckCheck:
    settings: GraspSettings
    bias: TactileBias
    stamp: float = -np.inf
    pads: tuple[Array, ...] = ()


def start_stuck_check(settings: GraspSettings, bias: TactileBias) -> StuckCheck:
    """Start the check. bias: the tactile bias that was measured before the grasp."""
    return StuckCheck(settings, bias)


def check_stuck(reading: HandReading, state: StuckCheck) -> StuckCheck | Outcome[Clear]:
    """Process the reading of one tick, with the hand open and clear of the stack.

    Failures: STUCK_ON_FINGER, those of `validate_reading`.
    """
    s = state.settings
    invalid = validate_reading(reading, s)
    if invalid:
        return Outcome(failure=invalid)
    if reading.tactile.stamp <= state.stamp:
        return state
    state = replace(state, stamp=reading.tactile.stamp, pads=(*state.pads, state.bias.pads(reading)))
    if len(state.pads) < s.stuck_readings:
        return state
    mean = np.mean(state.pads, axis=0)
    pad = int(mean.argmax())
    residual, bound = float(mean[pad]), residual_bound(state.bias, reading.stamp, s)
    if residual < bound:
        return Outcome(Clear(residual, bound))
    return Outcome(
        failure=Failure(
            FailureKind.STUCK_ON_FINGER,
            f"{residual:.2f} N remain on pad {pad} of the open {reading.tactile.side} hand",
            "pull the cloth off the finger",
            {"side": reading.tactile.side.value, "pad": pad, "residual_n": residual, "bound_n": bound},
        )
    )


def residual_bound(bias: TactileBias, now: float, settings: GraspSettings) -> float:
    """Largest mean force of an unloaded pad that noise, and drift since the tare, can explain [N].

    now: [s]. A cell that drifts with standard deviation sigma and period T has changed by 2 sigma sin(pi t / T)
    after a time t (root mean square over its phases), and by at most 2 sigma.
    """
    s = settings
    cells = bias.cells[0].size
    phase = float(np.clip((now - bias.stamp) / s.drift_time, 0.0, 0.5))
    drift = 2.0 * s.drift_ratio * bias.cell_noise * np.sin(np.pi * phase)
    noise = bias.cell_noise * np.sqrt(1.0 / s.stuck_readings + 1.0 / s.tare_readings)
    return max(s.stuck_force, s.stuck_sigmas * float(np.sqrt(cells) * np.hypot(drift, noise)))
