"""Controller that closes the pads until both feel force or the opening stops changing."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from skills.grasping.hand_reading import GripCommand, HandReading, validate_reading
from skills.grasping.settings import GraspSettings
from skills.grasping.tare import TactileBias
from skills.vocabulary import Array, Failure, FailureKind, Outcome

__all__ = ["CloseState", "Closed", "close", "speed_of", "start_close"]

STILL_WINDOW = 0.12
"""Time over which the speed of the pads is measured [s]."""
STILL_SPEED = 0.008
"""Pads whose opening changes more slowly than this over `STILL_WINDOW` are at rest [m/s]."""
CLOSE_TIMEOUT = 2.0
"""Maximum duration of the closing [s]."""
CLOSE_READINGS = 3
"""Number of successive readings of the force that end the closing, so that one wrong reading does not."""
CLOSE_TRAVEL = 0.003
"""Pads at rest that have moved less than this have not started to close [m]."""

MIN_SAMPLES = 4
"""Minimum number of readings for a speed estimate."""


@dataclass(frozen=True)
class Closed:
    """Result of closing. opening: of the pads [m]. force: on the less loaded pad [N]. seconds: duration [s]."""

    opening: float
    force: float
    seconds: float


@dataclass(frozen=True, eq=False)
class CloseState:
    settings: GraspSettings
    bias: TactileBias
    started: float
    start_opening: float
    tactile_stamp: float = -np.inf
    pressed_count: int = 0
    openings: tuple[tuple[float, float], ...] = ()


def start_close(settings: GraspSettings, bias: TactileBias, reading: HandReading) -> CloseState:
    return CloseState(settings, bias, reading.stamp, reading.gripper.opening)


def close(reading: HandReading, state: CloseState) -> tuple[GripCommand, CloseState | Outcome[Closed]]:
    """Process the reading of one tick and command the pads to close. `confirm` decides later whether they hold
    cloth.

    Failures: GRIPPER_FAULT when, within `CLOSE_TIMEOUT`, the pads neither feel force nor come to rest after a
    movement; those of `validate_reading`.
    """
    s = state.settings
    command = GripCommand(0.0, s.grip_force)
    invalid = validate_reading(reading)
    if invalid:
        return command, Outcome(failure=invalid)
    state = _update(reading, state)
    seconds = reading.stamp - state.started
    if state.pressed_count >= CLOSE_READINGS or _at_rest(state):
        force = float(state.bias.pads(reading).min())
        return command, Outcome(Closed(reading.gripper.opening, force, seconds))
    if seconds > CLOSE_TIMEOUT:
        return command, Outcome(failure=_timeout_failure(reading, state, seconds))
    return command, state


def speed_of(openings: tuple[tuple[float, float], ...]) -> float | None:
    """Speed of the pads [m/s]: least-squares slope of (stamp [s], opening [m]) pairs; None if there are too
    few."""
    if len(openings) < MIN_SAMPLES:
        return None
    t, x = (np.array(column) for column in zip(*openings, strict=True))
    t = t - t.mean()
    return float(t @ x / (t @ t))


def _update(reading: HandReading, state: CloseState) -> CloseState:
    s = state.settings
    if reading.tactile.stamp > state.tactile_stamp:
        pressed = bool((_pads(reading, state) >= s.close_force).all())
        state = replace(
            state, tactile_stamp=reading.tactile.stamp, pressed_count=state.pressed_count + 1 if pressed else 0
        )
    stamp = reading.gripper.stamp
    if not state.openings or stamp > state.openings[-1][0]:
        openings = (*state.openings, (stamp, reading.gripper.opening))
        kept = tuple(p for p in openings if p[0] > stamp - STILL_WINDOW)
        # The window may contain too few reports of a slow gripper. Then the last MIN_SAMPLES reports are used.
        state = replace(state, openings=kept if len(kept) >= MIN_SAMPLES else openings[-MIN_SAMPLES:])
    return state


def _pads(reading: HandReading, state: CloseState) -> Array:
    return state.bias.pads(reading)


def _at_rest(state: CloseState) -> bool:
    speed = speed_of(state.openings)
    if speed is None or state.openings[-1][0] - state.openings[0][0] < 0.7 * STILL_WINDOW:
        return False
    moved = state.start_opening - state.openings[-1][1]
    return abs(speed) < STILL_SPEED and moved >= min(CLOSE_TRAVEL, 0.5 * state.start_opening)


def _timeout_failure(reading: HandReading, state: CloseState, seconds: float) -> Failure:
    moved = state.start_opening - reading.gripper.opening
    return Failure(
        FailureKind.GRIPPER_FAULT,
        f"the {reading.tactile.side} gripper has not closed in {seconds:.1f} s (it moved {moved * 1e3:.1f} mm)",
        "check that the gripper is calibrated and free to move",
        {"seconds": seconds, "opening_m": reading.gripper.opening, "moved_m": moved},
    )
