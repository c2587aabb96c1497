"""A clock that carries out scheduled actions while it sleeps."""

from __future__ import annotations

from typing import Protocol

from foldcell.robots.ports import Clock

__all__ = ["Schedule", "ScheduledClock"]


class Schedule(Protocol):
    """Actions scheduled in cell time [s]."""

    def next_due(self) -> float | None: ...

    def carry_out(self, now: float) -> None:
        """Carry out every action that is due at `now` [s]."""


class ScheduledClock:
    """Wraps a cell's clock. Its sleep wakes at each scheduled action and carries it out, also between two
    set-points of a motion."""

    def __init__(self, clock: Clock, schedule: Schedule) -> None:
        self._clock, self._schedule = clock, schedule

    def now(self) -> float:
        return self._clock.now()

    def sleep_until(self, t: float) -> None:
        self._schedule.carry_out(self._clock.now())
        while (due := self._schedule.next_due()) is not None and due < t:
            self._clock.sleep_until(due)
            self._schedule.carry_out(self._clock.now())
        self._clock.sleep_until(t)
        self._schedule.carry_out(self._clock.now())
