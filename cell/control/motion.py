"""What passes between the control loop and a motion that it runs.

A motion is a generator: it yields set-points, is sent back what was read a tick after each, and returns how it
ended.
"""

from __future__ import annotations

from collections.abc import Callable, Generator
from dataclasses import dataclass
from enum import Enum, auto
from typing import TypeVar

from robots.errors import Failure
from robots.ports import Array, JointState
from skills.vocabulary import Outcome

__all__ = ["Feedback", "Motion", "Order", "SetPoint", "Tick", "Watch"]

V = TypeVar("V")


class Order(Enum):
    """What the loop tells a motion that can be held up on its path."""

    REST = auto()
    GO = auto()


@dataclass(frozen=True, eq=False)
class SetPoint:
    """q, qd (14,) for the next tick [rad], [rad/s].

    begins: joints (14,) near which the arms have to stand before a motion's first set-point is sent; None: they
    may stand anywhere. path_s: the motion's own clock [s]. resting: the motion may be left here: it rests on its
    path, or cannot be held up at all. failure: why the motion is to be brought to rest and ended.
    """

    q: Array
    qd: Array
    begins: Array | None = None
    path_s: float = 0.0
    resting: bool = True
    failure: Failure | None = None


@dataclass(frozen=True, eq=False)
class Feedback:
    """The arms a tick after a set-point.

    fresh: whether the state is recent enough to act on. One that is not reaches only motions that have yet to be
    brought to rest, and those whose arms are sent nothing. late: the tick came so late that the arms have come
    to rest.
    """

    state: JointState
    fresh: bool = True
    late: bool = False
    order: Order | None = None


Motion = Generator[SetPoint, Feedback, Outcome[V]]


@dataclass(frozen=True, eq=False)
class Tick:
    """What a watcher sees: time on the motion's own clock [s], which a pause holds up, and the arms' state."""

    t: float
    state: JointState


Watch = Callable[[Tick], Failure | None]
