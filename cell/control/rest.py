"""Wait until the arms have come to rest, without commanding them."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from foldcell.cell.control.checks import ExecutionLimits, fresh_state, stopped
from foldcell.cell.control.ticks import TICK_S
from foldcell.robots.errors import Failure, FailureKind
from foldcell.robots.ports import Array, JointState, Ports

STILL_S = 0.25
"""The arms rest if they have moved less than STILL_RAD for this time [s]. It is longer than the command timeout,
so that the arms hold by themselves when it ends."""
STILL_RAD = 0.004
REST_S = 3.0
"""Longest wait for arms that a transient has moved, or whose state is unknown [s]."""


def await_rest(
    ports: Ports,
    limits: ExecutionLimits,
    longest_s: float = REST_S,
    note: Callable[[JointState], None] = lambda state: None,
) -> Failure | None:
    """Wait until the arms' state is fresh and has not changed for STILL_S, at most `longest_s` [s].

    No set-point is sent, because a position that is commanded to moving arms, or to arms that something has pushed
    aside, is soon the wrong one. The driver brakes and holds the arms after its command timeout. A stop does not
    end the wait. note: gets each fresh state. Returns the failure of the last tick: STOPPED, STALE_STATE,
    TRACKING_ERROR (the arms still move).
    """
    clock = ports.clock
    deadline = clock.now() + longest_s
    reference: Array | None = None
    since, moved, failure = clock.now(), 0.0, None
    while True:
        read = fresh_state(ports, limits)
        failure = stopped(ports) or read.failure
        if read.value is not None:
            note(read.value)
        if read.failure:
            reference = None
        elif reference is None or (moved := float(np.abs(read.unwrap().q - reference).max())) > STILL_RAD:
            reference, since = read.unwrap().q, clock.now()
        elif clock.now() - since >= STILL_S - 1e-9:
            return failure
        if clock.now() >= deadline:
            return failure or _still_moving(moved)
        clock.sleep_until(clock.now() + TICK_S)


def _still_moving(moved: float) -> Failure:
    return Failure(
        FailureKind.TRACKING_ERROR,
        f"the arms do not come to rest: a joint has moved by {np.rad2deg(moved):.1f} degrees",
        "look for a person or an object at the arms before you continue",
        {"moved_rad": moved},
    )


def stand_by(ports: Ports, seconds: float) -> None:
    """Let `seconds` of cell time pass without a set-point. A stop ends the wait."""
    until = ports.clock.now() + seconds
    while ports.clock.now() < until and not ports.stop.state().stopped:
        ports.clock.sleep_until(ports.clock.now() + TICK_S)
