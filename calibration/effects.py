"""Effects: the requests of a calibration procedure to a cell, and their results.

A procedure is a generator. It yields effects, receives their outcomes and returns its own outcome. It has no other
access to the cell. The runner in cell/calibrating performs the effects: it plans, checks, watches the stop circuit
and writes the journal. A procedure receives only the failures of planning (ANSWERABLE), which come before any
motion, and may handle them. Every other failure ends it, and so does a failure that it unwraps.
"""

from __future__ import annotations

from collections.abc import Generator, Mapping
from dataclasses import dataclass
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from foldcell.robots.errors import FailureKind
from foldcell.robots.ports import Array, BoardPlace, CameraFrame, Side, TactileReading
from foldcell.skills.vocabulary import Outcome


@dataclass(frozen=True)
class Look:
    """Take a picture with the arms at rest."""


@dataclass(frozen=True, eq=False)
class Sight:
    """A picture, and the mean joint positions q (joints,) when it was taken [rad]."""

    frame: CameraFrame
    q: Array


@dataclass(frozen=True, eq=False)
class Reach:
    """Move one tool to the pose T_base_tool (4, 4) on a collision-free path; the other arm parks first. Fails with
    UNREACHABLE or IN_COLLISION before this arm moves."""

    side: Side
    T_base_tool: Array


@dataclass(frozen=True)
class Touch:
    """Touch the table with the closed pads of one hand at x, y [m].

    The hand descends until it touches, backs off, presses slowly, and rises. It expects the table within
    `search` [m] of its configured height. Fails with NO_CONTACT, UNREACHABLE, IN_COLLISION, and with
    LOW_CONFIDENCE for a contact above this range.
    """

    side: Side
    x: float
    y: float
    search: float = 0.025


@dataclass(frozen=True, eq=False)
class TouchReadings:
    """Readings of a slow press. height: (n,) height of the tool centre point computed from the joints, base frame
    [m]; force: (n,) sum of the forces on both tips minus the tare [N]. x, y: position of the tool, base frame
    [m]."""

    side: Side
    x: float
    y: float
    height: Array
    force: Array


@dataclass(frozen=True)
class RecordTactile:
    """Record the tactile cells of both unloaded hands for `seconds` [s]: the readings of each hand in order of
    time."""

    seconds: float


@dataclass(frozen=True)
class Grip:
    """Move the pads of one gripper to `opening` [m] with at most `force` [N]."""

    side: Side
    opening: float
    force: float


@dataclass(frozen=True)
class Bring:
    """Ask the attendant to bring the calibration board to `place`, or to take it away."""

    place: BoardPlace


@dataclass(frozen=True, eq=False)
class Note:
    """Show a progress line to the operator. picture: (h, w, 3), saved as `name` in the run folder; None: no
    picture."""

    text: str
    picture: NDArray[np.uint8] | None = None
    name: str = ""


Effect = Look | Reach | Touch | RecordTactile | Grip | Bring | Note

ANSWERABLE = frozenset({FailureKind.UNREACHABLE, FailureKind.IN_COLLISION})
"""Failures of planning, which the procedure receives."""

T = TypeVar("T")
Answer = Outcome[Any]
Request = Generator[Effect, Answer, T]
Procedure = Request[Outcome[T]]


def look() -> Request[Sight]:
    return (yield Look()).unwrap()


def reach(side: Side, T_base_tool: Array) -> Procedure[Array]:
    """Move one tool to a pose. Returns the joints (joints,) there [rad]."""
    return (yield Reach(side, T_base_tool))


def touch(side: Side, x: float, y: float) -> Procedure[TouchReadings]:
    return (yield Touch(side, x, y))


def listen(seconds: float) -> Request[Mapping[Side, tuple[TactileReading, ...]]]:
    return (yield RecordTactile(seconds)).unwrap()


def grip(side: Side, opening: float, force: float) -> Request[None]:
    yield Grip(side, opening, force)


def bring(place: BoardPlace) -> Request[None]:
    yield Bring(place)


def note(text: str, picture: NDArray[np.uint8] | None = None, name: str = "") -> Request[None]:
    yield Note(text, picture, name)
