"""A cell's clock on whose way things happen."""

from __future__ import annotations

from typing import Protocol

from robots.ports import Clock

__all__ = ["Schedule", "ScheduledClock"]


class Schedule(Protocol):
    """What is to happen when, in cell time [s]."""

    def next_due(self) -> float | None: ...

    def carry_out(self, now: float) -> None:
        """Do all that is due by now."""


class ScheduledClock:
    """The clock of a cell, which stops on its way at what is due and has it carried out: between two set-points
    of a motion as well as while somebody waits."""

    def __init__(self, clock: Clock, agenda: Schedule) -> None:
        self._clock, self._agenda = clock, agenda

    def now(self) -> float:
        return self._clock.now()

    def sleep_until(self, t: float) -> None:
        while True:
            self._agenda.carry_out(self._clock.now())
            due = self._agenda.next_due()
            if due is None or due >= t:
                break
            self._clock.sleep_until(due)
        self._clock.sleep_until(t)
        self._agenda.carry_out(self._clock.now())
