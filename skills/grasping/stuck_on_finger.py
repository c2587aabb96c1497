"""Controllers that check, after the release, whether cloth clings to a finger. One checks with the hand at rest
above the stack, the other while the hand moves away. Only the second can feel light cloth, because the cloth then
drags the rest of the garment along.

Open, unloaded pads should read their bias. If noise and the drift since the tare cannot explain the residual force
on a pad, cloth clings to this pad.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from foldcell.skills.grasping.hand_reading import HandReading, validate_reading
from foldcell.skills.grasping.settings import GraspSettings
from foldcell.skills.grasping.tare import TARE_READINGS, LoadedReadings, TactileBias
from foldcell.skills.vocabulary import Array, Failure, FailureKind, Outcome, refuse, skill

STUCK_READINGS = 20
"""Number of readings that are averaged for the check."""
STUCK_SIGMAS = 4.5
"""A force counts as cloth on the finger if it exceeds this number of standard deviations of its expected error."""
DRIFT_RATIO = 2.0
"""Ratio of a cell's slow drift to its noise, both as standard deviations. Noisier cells drift more."""
DRIFT_TIME = 120.0
"""Shortest assumed period of a cell's slow drift [s]."""


QUICK = 5
"""Number of readings that are averaged to detect a strong pull. It is small, because the moving hands drag the
garment along until the pull is detected."""


@dataclass(frozen=True)
class Clear:
    """Result of the check when no cloth clings. residual: mean force on the more loaded pad [N]. bound: limit with
    which it was compared [N]."""

    residual: float
    bound: float


@dataclass(frozen=True, eq=False)
class StuckCheck(LoadedReadings):
    """State of the check."""


@skill
def check_stuck(reading: HandReading, state: StuckCheck) -> StuckCheck | Outcome[Clear]:
    """Process the reading of one tick, with the hand open and clear of the stack.

    Failures: STUCK_ON_FINGER, those of `validate_reading`.
    """
    refuse(validate_reading(reading))
    state = state.after(reading)
    if len(state.pads) < STUCK_READINGS:
        return state
    return _judged(reading, state, np.array(state.pads))


@dataclass(frozen=True, eq=False)
class DragWatch:
    """State of the check while the hand moves away. check: contains the latest readings. first: (2,) mean force of
    the pads when the hand began to move [N]; None until it is known. A pull is measured relative to this force, so
    that the drift since the tare does not count."""

    check: StuckCheck
    first: Array | None = None


def watch_drag(reading: HandReading, state: DragWatch) -> DragWatch | Failure:
    """Process the reading of one tick, while the open hand moves away.

    Returns STUCK_ON_FINGER if the force on a pad rises: cloth on the finger drags the garment along. Readings that
    cannot be used are passed over.
    """
    if validate_reading(reading) is not None:
        return state
    check = state.check.after(reading)
    if len(check.pads) < STUCK_READINGS:
        return DragWatch(check, state.first)
    if state.first is None:
        bias = replace(check.bias, stamp=reading.stamp)
        return DragWatch(replace(check, bias=bias, pads=(), openings=()), np.mean(check.pads, axis=0))
    if len(check.pads) > STUCK_READINGS:
        check = replace(check, pads=check.pads[-STUCK_READINGS:], openings=())
    forces = np.array(check.pads)
    for readings in (QUICK, STUCK_READINGS):  # a strong pull at once, a light one after more readings
        latest = forces[-readings:]
        failure = _judged(reading, check, latest, state.first).failure
        if failure is not None and _lasting(latest - state.first):
            return failure
    return DragWatch(check, state.first)


def _lasting(forces: Array) -> bool:
    """Whether most readings agree with the mean force, so that a single wrong reading does not count as a pull.
    forces: (k, 2) on the pads [N]."""
    loaded = forces[:, int(forces.mean(axis=0).argmax())]
    return bool(np.median(loaded) > 0.5 * loaded.mean())


def _judged(
    reading: HandReading, state: StuckCheck, forces: Array, unloaded: Array | float = 0.0
) -> Outcome[Clear]:
    """Compare the mean force on the more loaded pad with its bound. forces: (k, 2) latest readings of the pads
    [N]. unloaded: force of the unloaded pads, which is subtracted [N]."""
    mean = forces.mean(axis=0) - unloaded
    pad = int(mean.argmax())
    residual = float(mean[pad])
    bound = residual_bound(state.bias, reading.stamp, state.settings, len(forces))
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


def residual_bound(bias: TactileBias, now: float, settings: GraspSettings, readings: int) -> float:
    """Return the largest mean force of an unloaded pad that noise and the drift since the tare can explain [N].

    now: present time [s]. readings: number of readings in the mean. A cell that drifts with standard deviation
    sigma and period T has changed by 2 sigma sin(pi t / T) after a time t (root mean square over its phases), and
    by at most 2 sigma.
    """
    cells = bias.cells[0].size
    phase = min(max((now - bias.stamp) / DRIFT_TIME, 0.0), 0.5)
    drift = 2.0 * DRIFT_RATIO * bias.cell_noise * np.sin(np.pi * phase)
    noise = bias.cell_noise * math.sqrt(1.0 / readings + 1.0 / TARE_READINGS)
    return max(settings.stuck_force, STUCK_SIGMAS * float(math.sqrt(cells) * np.hypot(drift, noise)))
