"""What a calibration procedure may ask of a cell, and what it gets back.

A procedure is a generator: it yields effects and is sent their outcomes, and it returns its own outcome. It
has no other way to the cell. Who performs the effects (cell/calibrating) plans, checks, watches the stop and
keeps the journal. Only a plan that was refused (UNREACHABLE, IN_COLLISION) is for the procedure to answer; every
other failure ends it without asking it.
"""

from __future__ import annotations

from collections.abc import Generator, Mapping
from dataclasses import dataclass
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from robots.ports import Array, BoardPlace, CameraFrame, Side, TactileReading
from skills.vocabulary import Outcome

__all__ = [
    "Bring",
    "Effect",
    "Grip",
    "Heard",
    "Listen",
    "Look",
    "Note",
    "Procedure",
    "Reach",
    "Sight",
    "Touch",
    "Touched",
    "bring",
    "grip",
    "listen",
    "look",
    "note",
    "reach",
    "touch",
]


@dataclass(frozen=True)
class Look:
    """A picture, with the arms at rest."""


@dataclass(frozen=True, eq=False)
class Sight:
    """A picture and the arms' joints q (14,) while it was taken [rad], averaged over some readings."""

    frame: CameraFrame
    q: Array


@dataclass(frozen=True, eq=False)
class Reach:
    """One tool to T_base_tool (4, 4), free of collision; the other arm parks. Fails with UNREACHABLE or
    IN_COLLISION before this arm has moved."""

    side: Side
    T_base_tool: Array


@dataclass(frozen=True)
class Touch:
    """One hand, pads closed, straight down onto the table at x, y [m], and up again.

    It first comes down guarded, from above the highest to below the lowest place where the table may be:
    `search` [m] about its believed height. Fails with NO_CONTACT, UNREACHABLE, IN_COLLISION.
    """

    side: Side
    x: float
    y: float
    search: float = 0.025


@dataclass(frozen=True, eq=False)
class Touched:
    """Readings of a slow press. height: (n,) of the tool centre point by the joints, base frame [m]; force: (n,)
    both tips together, over their zero [N]. x, y: of the tool, base frame [m]."""

    side: Side
    x: float
    y: float
    height: Array
    force: Array


@dataclass(frozen=True)
class Listen:
    """Both hands' tactile cells for some time, nothing touching them."""

    seconds: float


@dataclass(frozen=True, eq=False)
class Heard:
    """All readings of each hand, in order."""

    readings: Mapping[Side, tuple[TactileReading, ...]]


@dataclass(frozen=True)
class Grip:
    """One gripper's pads `opening` [m] apart, squeezing with at most `force` [N]."""

    side: Side
    opening: float
    force: float


@dataclass(frozen=True)
class Bring:
    """The attendant brings the calibration board there."""

    place: BoardPlace


@dataclass(frozen=True, eq=False)
class Note:
    """A line for the person who waits, and a picture (h, w, 3) for the run's folder."""

    text: str
    picture: NDArray[np.uint8] | None = None
    name: str = ""


Effect = Look | Reach | Touch | Listen | Grip | Bring | Note

T = TypeVar("T")
Answer = Outcome[Any]
Procedure = Generator[Effect, Answer, Outcome[T]]
Asking = Generator[Effect, Answer, Outcome[T]]


def look() -> Asking[Sight]:
    return (yield Look())


def reach(side: Side, T_base_tool: Array) -> Asking[Array]:
    """The joints (14,) at which the tool stands there."""
    return (yield Reach(side, T_base_tool))


def touch(side: Side, x: float, y: float) -> Asking[Touched]:
    return (yield Touch(side, x, y))


def listen(seconds: float) -> Asking[Heard]:
    return (yield Listen(seconds))


def grip(side: Side, opening: float, force: float) -> Asking[bool]:
    return (yield Grip(side, opening, force))


def bring(place: BoardPlace) -> Asking[bool]:
    return (yield Bring(place))


def note(text: str, picture: NDArray[np.uint8] | None = None, name: str = "") -> Asking[bool]:
    return (yield Note(text, picture, name))
