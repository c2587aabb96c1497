"""Controller of the release: it opens the pads just wide enough above the stack, and checks that they opened."""

from __future__ import annotations

from dataclasses import dataclass

from foldcell.skills.grasping.hand_reading import GripCommand, HandReading, validate_reading
from foldcell.skills.vocabulary import Failure, FailureKind, Outcome

RELEASE_FORCE = 10.0
"""Force with which the pads open [N]."""
RELEASE_TOLERANCE = 0.002
"""Pads that open to within this of the command have opened [m]."""
RELEASE_TIMEOUT = 2.0
"""Maximum duration of the opening [s]."""


@dataclass(frozen=True)
class Released:
    """Result of a release. opening: of the pads [m]. seconds: duration [s]."""

    opening: float
    seconds: float


@dataclass(frozen=True, eq=False)
class ReleaseState:
    opening: float
    started: float


def start_release(opening: float, reading: HandReading) -> ReleaseState:
    """Start a release. opening: target [m]; narrow, so that the pads do not push the neighbouring cloth away."""
    return ReleaseState(opening, reading.stamp)


def release(reading: HandReading, state: ReleaseState) -> tuple[GripCommand, ReleaseState | Outcome[Released]]:
    """Process the reading of one tick.

    Failures: GRIPPER_FAULT when the pads do not open in time, those of `validate_reading`.
    """
    command = GripCommand(state.opening, RELEASE_FORCE)
    invalid = validate_reading(reading)
    if invalid:
        return command, Outcome(failure=invalid)
    seconds = reading.stamp - state.started
    opening = reading.gripper.opening
    if opening >= state.opening - RELEASE_TOLERANCE and reading.gripper.stamp > state.started:
        return command, Outcome(Released(opening, seconds))
    if seconds <= RELEASE_TIMEOUT:
        return command, state
    failure = Failure(
        FailureKind.GRIPPER_FAULT,
        f"the {reading.tactile.side} gripper has not opened in {seconds:.1f} s",
        "check that the gripper is enabled and free to move; the garment may still be held",
        {"opening_m": opening, "wanted_m": state.opening, "seconds": seconds},
    )
    return command, Outcome(failure=failure)
