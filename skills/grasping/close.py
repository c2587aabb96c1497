"""Closing the pads: until both feel force, or until the opening stands still."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from skills.grasping.hand_reading import GripCommand, HandReading, fault
from skills.grasping.settings import GraspSettings
from skills.grasping.tare import TactileBias
from skills.vocabulary import Array, Failure, FailureKind, Outcome

__all__ = ["CloseState", "Closed", "close", "speed_of", "start_close"]

FEWEST_SAMPLES = 4
"""Readings that a speed is taken from, at least."""


@dataclass(frozen=True)
class Closed:
    """opening [m] and the smaller pad's force [N] when the pads had closed, `seconds` after the start."""

    opening: float
    force: float
    seconds: float


@dataclass(frozen=True, eq=False)
class CloseState:
    settings: GraspSettings
    tare: TactileBias
    started: float
    start_opening: float
    tactile_stamp: float = -np.inf
    count: int = 0
    openings: tuple[tuple[float, float], ...] = ()


def start_close(settings: GraspSettings, tare: TactileBias, reading: HandReading) -> CloseState:
    return CloseState(settings, tare, reading.stamp, reading.gripper.opening)


def close(reading: HandReading, state: CloseState) -> tuple[GripCommand, CloseState | Outcome[Closed]]:
    """One tick: squeeze until closed. Whether anything is held is for `confirm` to say.

    Fails with GRIPPER_FAULT when the pads neither press nor come to rest in time, or never moved; and as
    `fault` says.
    """
    s = state.settings
    command = GripCommand(0.0, s.grip_force)
    bad = fault(reading, s)
    if bad:
        return command, Outcome(failure=bad)
    state = _watch(reading, state)
    seconds = reading.stamp - state.started
    if state.count >= s.close_readings or _at_rest(state):
        force = float(state.tare.pads(reading).min())
        return command, Outcome(Closed(reading.gripper.opening, force, seconds))
    if seconds > s.close_timeout:
        return command, Outcome(failure=_too_long(reading, state, seconds))
    return command, state


def speed_of(openings: tuple[tuple[float, float], ...]) -> float | None:
    """Slope of (stamp, opening) pairs [m/s], least squares; None from too few."""
    if len(openings) < FEWEST_SAMPLES:
        return None
    t, x = (np.array(column) for column in zip(*openings, strict=True))
    t = t - t.mean()
    return float(t @ x / (t @ t))


def _watch(reading: HandReading, state: CloseState) -> CloseState:
    s = state.settings
    if reading.tactile.stamp > state.tactile_stamp:
        pressed = bool((_pads(reading, state) >= s.close_force).all())
        state = replace(state, tactile_stamp=reading.tactile.stamp, count=state.count + 1 if pressed else 0)
    stamp = reading.gripper.stamp
    if not state.openings or stamp > state.openings[-1][0]:
        seen = (*state.openings, (stamp, reading.gripper.opening))
        kept = tuple(p for p in seen if p[0] > stamp - s.still_window)
        # a slow gripper says less in the window than it takes to tell a speed: then its last words count
        state = replace(state, openings=kept if len(kept) >= FEWEST_SAMPLES else seen[-FEWEST_SAMPLES:])
    return state


def _pads(reading: HandReading, state: CloseState) -> Array:
    return state.tare.pads(reading)


def _at_rest(state: CloseState) -> bool:
    s = state.settings
    speed = speed_of(state.openings)
    if speed is None or state.openings[-1][0] - state.openings[0][0] < 0.7 * s.still_window:
        return False
    moved = state.start_opening - state.openings[-1][1]
    return abs(speed) < s.still_speed and moved >= min(s.close_travel, 0.5 * state.start_opening)


def _too_long(reading: HandReading, state: CloseState, seconds: float) -> Failure:
    moved = state.start_opening - reading.gripper.opening
    return Failure(
        FailureKind.GRIPPER_FAULT,
        f"the {reading.tactile.side} gripper has not closed in {seconds:.1f} s (it moved {moved * 1e3:.1f} mm)",
        "check that the gripper is calibrated and free to move",
        {"seconds": seconds, "opening_m": reading.gripper.opening, "moved_m": moved},
    )
