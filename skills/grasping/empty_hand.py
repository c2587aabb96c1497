"""Controller that closes and opens an open hand, to feel whether cloth has stayed between its pads.

Cloth that stays on a pad after the release may weigh less than the pads can feel, and is then felt only when it
drags the garment along. Between closed pads, the lightest cloth keeps the pads apart by its thickness, and both
pads feel the force of the grip. The hand then holds this cloth, and can lay it down again.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from foldcell.skills.grasping.close import CLOSE_TIMEOUT, STILL_WINDOW, MovingPads
from foldcell.skills.grasping.hand_reading import GripCommand, HandReading, validate_reading
from foldcell.skills.grasping.release import RELEASE_FORCE, RELEASE_TIMEOUT
from foldcell.skills.grasping.settings import GraspSettings
from foldcell.skills.grasping.tare import TactileBias
from foldcell.skills.vocabulary import Failure, FailureKind, Outcome

MET_READINGS = 5
"""Number of readings of the opening that are averaged."""
MET = 1 / 3
"""Pads have met if their distance is less than this share of a layer. With the usual noise of a reading (0.15 mm),
a layer of 0.5 mm that is stated as 0.8 mm is overlooked only at an error of 3.5 sigma."""
HELD_READINGS = 5
"""Number of readings in a row in which both pads must feel the grip."""
STILL = 0.0008
"""Pads that press are at rest if the averaged openings differ by less than this [m]: more than twice the spread of
their noise. Saturated pads seem to press, too, but move on until they meet."""
OPENED = 0.012
"""Pads that are this far apart are open for every later check (from 10 mm on), in spite of noise [m]."""


@dataclass(frozen=True, eq=False)
class EmptyCheck:
    """State of the check. layer: smallest thickness of a layer of the cloth [m]. opening: distance to which the
    pads open again [m]. since: when they began to close, then to open [s]. met: distance at which they met, rested
    or were late [m], NaN if it was not measured; None while they close."""

    settings: GraspSettings
    bias: TactileBias
    layer: float
    opening: float
    since: float
    met: float | None = None
    pads: MovingPads = field(default_factory=MovingPads)


def check_empty(reading: HandReading, state: EmptyCheck) -> tuple[GripCommand, EmptyCheck | Outcome[float]]:
    """Process the reading of one tick, while the hand rests above the cloth that it has released. Ends with the
    distance `EmptyCheck.met`, when the pads are open again, or after `RELEASE_TIMEOUT`.

    Pads that neither meet each other nor feel cloth open again after `CLOSE_TIMEOUT`, or as soon as they rest.
    Readings that cannot be used are passed over. Failure: STUCK_ON_FINGER, with the cloth between the closed pads.
    """
    if state.met is None:
        after = _close(reading, state)
        if isinstance(after, Outcome) or after.met is None:
            return GripCommand(0.0, RELEASE_FORCE), after
        state = after
    opened = validate_reading(reading) is None and reading.gripper.opening >= OPENED
    ended = opened or reading.stamp - state.since > RELEASE_TIMEOUT
    return GripCommand(state.opening, RELEASE_FORCE), Outcome(state.met) if ended else state


def _close(reading: HandReading, state: EmptyCheck) -> EmptyCheck | Outcome[float]:
    s, apart = state.settings, np.nan
    if validate_reading(reading) is None:
        state = replace(state, pads=state.pads.after(reading, state.bias, s.held_force, MET_READINGS))
        latest = [distance for _, distance in state.pads.openings[-MET_READINGS:]]
        apart = float(np.mean(latest)) - s.empty_opening
        if len(latest) == MET_READINGS and apart < MET * state.layer:
            return replace(state, met=apart, since=reading.stamp)
        if state.pads.pressed >= HELD_READINGS and np.ptp(latest) < STILL:
            return Outcome(failure=_held(reading, apart))
        if state.pads.pressed == 0 and _at_rest(state):
            return replace(state, met=apart, since=reading.stamp)
    late = reading.stamp - state.since > CLOSE_TIMEOUT
    return replace(state, met=apart, since=reading.stamp) if late else state


def _at_rest(state: EmptyCheck) -> bool:
    """Whether the pads have come to rest after they had time to begin to close."""
    return state.pads.still and state.pads.openings[-1][0] - state.since >= 2.0 * STILL_WINDOW


def _held(reading: HandReading, apart: float) -> Failure:
    side = reading.tactile.side
    return Failure(
        FailureKind.STUCK_ON_FINGER,
        f"cloth stayed between the pads of the {side} hand ({apart * 1e3:.1f} mm)",
        "pull the cloth off the finger",
        {"side": side.value, "opening_m": apart},
    )
