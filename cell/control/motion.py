"""The interface between the control loop and the motions.

A motion is a generator: it yields set-points, receives the arms' state one tick after each, and returns its
outcome.
"""

from __future__ import annotations

from collections.abc import Callable, Generator
from dataclasses import dataclass
from enum import Enum, auto
from typing import TypeVar

from foldcell.robots.errors import Failure
from foldcell.robots.ports import Array, JointState
from foldcell.skills.vocabulary import Outcome

V = TypeVar("V")


class Order(Enum):
    """The loop's order to a motion that can pause on its path: come to rest, or continue."""

    REST = auto()
    GO = auto()


@dataclass(frozen=True, eq=False)
class SetPoint:
    """Set-point of both arms: q, qd (joints,) for the next tick [rad], [rad/s].

    begins: joints (joints,) near which the arms must be before the motion's first set-point is sent; None: no
    condition. path_s: the motion's own clock [s]. resting: the motion may end here, because it rests on its path
    or cannot pause at all. failure: if set, the loop brings the motion to rest and ends it with this failure.
    """

    q: Array
    qd: Array
    begins: Array | None = None
    path_s: float = 0.0
    resting: bool = True
    failure: Failure | None = None


@dataclass(frozen=True, eq=False)
class Feedback:
    """The state of the arms one tick after a set-point.

    fresh: whether the state is recent enough to act on. A stale state reaches only motions that must still be
    brought to rest, and motions that send no set-points. late: whether the tick came so late that the arms have
    come to rest.
    """

    state: JointState
    fresh: bool = True
    late: bool = False
    order: Order | None = None


Motion = Generator[SetPoint, Feedback, Outcome[V]]


@dataclass(frozen=True, eq=False)
class Tick:
    """Input of a watch, which is called on every tick of a motion and may end it. t: the motion's own clock [s],
    which does not advance in a pause; state: state of the arms."""

    t: float
    state: JointState


Watch = Callable[[Tick], Failure | None]
