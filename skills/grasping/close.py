"""Controller that closes the pads until both feel force or the opening stops changing."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from foldcell.skills.grasping.hand_reading import GripCommand, HandReading, validate_reading
from foldcell.skills.grasping.settings import GraspSettings
from foldcell.skills.grasping.tare import TactileBias
from foldcell.skills.vocabulary import Failure, FailureKind, Outcome

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


@dataclass(frozen=True)
class MovingPads:
    """The latest readings of pads that move. pressed: number of successive readings in which both pads feel a
    force. openings: stamp [s] and opening [m] of the last reports of the gripper."""

    tactile_stamp: float = -np.inf
    pressed: int = 0
    openings: tuple[tuple[float, float], ...] = ()

    def after(self, reading: HandReading, bias: TactileBias, force: float, least: int) -> MovingPads:
        """Return the readings with a new one. force: force that both pads have to feel [N]. least: minimum number
        of reports that are kept, even if the gripper is slow and STILL_WINDOW contains fewer."""
        pads = self
        if reading.tactile.stamp > pads.tactile_stamp:
            pressed = pads.pressed + 1 if (bias.pads(reading) >= force).all() else 0
            pads = replace(pads, tactile_stamp=reading.tactile.stamp, pressed=pressed)
        stamp = reading.gripper.stamp
        if not pads.openings or stamp > pads.openings[-1][0]:
            openings = (*pads.openings, (stamp, reading.gripper.opening))
            kept = tuple(p for p in openings if p[0] > stamp - STILL_WINDOW)
            pads = replace(pads, openings=kept if len(kept) >= least else openings[-least:])
        return pads

    @property
    def still(self) -> bool:
        """Whether the opening has hardly changed over STILL_WINDOW."""
        return self.speed < STILL_SPEED

    @property
    def speed(self) -> float:
        """Absolute least-squares slope of the reported openings [m/s]; inf if there are too few reports."""
        if len(self.openings) < MIN_SAMPLES or self.openings[-1][0] - self.openings[0][0] < 0.7 * STILL_WINDOW:
            return float("inf")
        t, x = (np.array(column) for column in zip(*self.openings, strict=True))
        t = t - t.mean()
        return abs(float(t @ x / (t @ t)))


@dataclass(frozen=True, eq=False)
class CloseState:
    settings: GraspSettings
    bias: TactileBias
    started: float
    start_opening: float
    pads: MovingPads = field(default_factory=MovingPads)


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
    state = replace(state, pads=state.pads.after(reading, state.bias, s.close_force, MIN_SAMPLES))
    seconds = reading.stamp - state.started
    if state.pads.pressed >= CLOSE_READINGS or _at_rest(state):
        force = float(state.bias.pads(reading).min())
        return command, Outcome(Closed(reading.gripper.opening, force, seconds))
    if seconds > CLOSE_TIMEOUT:
        return command, Outcome(failure=_timeout_failure(reading, state, seconds))
    return command, state


def _at_rest(state: CloseState) -> bool:
    """Whether the pads stand still after they have moved."""
    if not state.pads.still:
        return False
    moved = state.start_opening - state.pads.openings[-1][1]
    return moved >= min(CLOSE_TRAVEL, 0.5 * state.start_opening)


def _timeout_failure(reading: HandReading, state: CloseState, seconds: float) -> Failure:
    moved = state.start_opening - reading.gripper.opening
    return Failure(
        FailureKind.GRIPPER_FAULT,
        f"the {reading.tactile.side} gripper has not closed in {seconds:.1f} s (it moved {moved * 1e3:.1f} mm)",
        "check that the gripper is calibrated and free to move",
        {"seconds": seconds, "opening_m": reading.gripper.opening, "moved_m": moved},
    )
