"""The beat of whatever commands the arms: 100 Hz of the cell's clock."""

from __future__ import annotations

from robots.ports import Clock

__all__ = ["TICK_S", "Ticks"]

TICK_S = 0.01
STALL_S = 0.05


class Ticks:
    """Ticks from now on. A loop that comes late, by more than a tick, goes on from there: catching up would send
    set-points ahead of the arms. The simulated cell waits for its executive, which is never late."""

    def __init__(self, clock: Clock) -> None:
        self._clock = clock
        self._origin, self._count = clock.now(), 0

    def wait(self) -> bool:
        """Until the next one; -> whether it came so late that arms which follow no more have come to rest."""
        self._count += 1
        due = self._origin + self._count * TICK_S
        self._clock.sleep_until(due)
        late = self._clock.now() - due
        if late > TICK_S:
            self._origin += late
        return late > STALL_S
