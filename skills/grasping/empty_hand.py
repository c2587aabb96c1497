"""Controller that closes and opens an open hand while it rises, to feel whether cloth has stayed between its pads.

Cloth that stays on a pad after the release may weigh less than the pads can feel, and is then felt only when it
drags the garment along. Between closed pads, the lightest cloth keeps the pads apart by its thickness, and both
pads feel the force of the grip. The hand then holds this cloth, and can lay it down again.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from enum import Enum, auto

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
CLEAR = 0.012
"""Until the hand is this far above the height at which it begins to close, the pads close only to NARROW [m]. If a
pause or slow arms keep the hand low, it then takes no cloth of the stack."""
NARROW = 0.012
"""At this distance, the pads do not grip cloth that lies between them [m]."""
OPENED = 0.005
"""Pads that are this far apart do not touch each other or cloth between them [m]."""


class _Phase(Enum):
    RISING = auto()
    CLOSING = auto()
    OPENING = auto()


@dataclass(frozen=True)
class Emptied:
    """Result of the check when no cloth was felt. met: whether the pads met each other, with nothing between
    them."""

    met: bool


@dataclass(frozen=True, eq=False)
class EmptyCheck:
    """State of the check. layer: smallest thickness of a layer of the cloth [m]. above: height at which the hand
    closes [m]. opening: distance to which the pads open again [m]. since: start of the present phase [s]."""

    settings: GraspSettings
    bias: TactileBias
    layer: float
    above: float
    opening: float
    phase: _Phase = _Phase.RISING
    since: float = -np.inf
    pads: MovingPads = field(default_factory=MovingPads)
    met: bool = False

    @property
    def begun(self) -> bool:
        """Whether the hand has begun to close."""
        return self.phase is not _Phase.RISING


def check_empty(
    reading: HandReading, state: EmptyCheck
) -> tuple[GripCommand | None, EmptyCheck | Outcome[Emptied]]:
    """Process the reading of one tick, while the open hand rises or rests above `EmptyCheck.above`. No command is
    given before the hand is there.

    Pads that neither meet each other nor feel cloth open again after `CLOSE_TIMEOUT`, or as soon as they rest.
    Readings that cannot be used are passed over. Failure: STUCK_ON_FINGER, with the cloth between the closed pads.
    """
    if state.phase is _Phase.RISING:
        if not reading.height >= state.above:
            return None, state
        state = replace(state, phase=_Phase.CLOSING, since=reading.stamp)
    if state.phase is _Phase.CLOSING:
        after = _closing(reading, state)
        if isinstance(after, Outcome) or after.phase is _Phase.CLOSING:
            low = not reading.height >= state.above + CLEAR
            return GripCommand(NARROW if low else 0.0, RELEASE_FORCE), after
        state = after
    return _opening(reading, state)


def _closing(reading: HandReading, state: EmptyCheck) -> EmptyCheck | Outcome[Emptied]:
    s = state.settings
    if validate_reading(reading) is None:
        state = replace(state, pads=state.pads.after(reading, state.bias, s.held_force, MET_READINGS))
        latest = [opening for _, opening in state.pads.openings[-MET_READINGS:]]
        apart = float(np.mean(latest)) - s.empty_opening
        if len(latest) == MET_READINGS and apart < MET * state.layer:
            return replace(state, phase=_Phase.OPENING, since=reading.stamp, met=True)
        if state.pads.pressed >= HELD_READINGS and np.ptp(latest) < STILL:
            return Outcome(failure=_held(reading, apart))
        if state.pads.pressed == 0 and _at_rest(state):
            return replace(state, phase=_Phase.OPENING, since=reading.stamp)
    late = reading.stamp - state.since > CLOSE_TIMEOUT
    return replace(state, phase=_Phase.OPENING, since=reading.stamp) if late else state


def _opening(reading: HandReading, state: EmptyCheck) -> tuple[GripCommand, EmptyCheck | Outcome[Emptied]]:
    command = GripCommand(state.opening, RELEASE_FORCE)
    opened = validate_reading(reading) is None and reading.gripper.opening >= OPENED
    if opened or reading.stamp - state.since > RELEASE_TIMEOUT:
        return command, Outcome(Emptied(state.met))
    return command, state


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
