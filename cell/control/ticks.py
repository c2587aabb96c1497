"""The beat of whatever commands the arms: 100 Hz of the cell's clock."""

from __future__ import annotations

from robots.ports import Ports

__all__ = ["LOST_S", "TICK_S", "Ticks"]

TICK_S = 0.01
STALL_S = 0.05
LOST_S = 2.0
"""Long enough for somebody to have come near arms that stood."""


class Ticks:
    """Ticks from now on. A loop that comes late, by more than a tick, goes on from there: catching up would send
    set-points ahead of the arms. One that was held up for LOST_S (a suspended program, a laptop that slept) stops
    the robot: it must not move on as if nothing had been. The simulated cell waits for its executive, which is
    never late."""

    def __init__(self, ports: Ports) -> None:
        self._clock, self._stop = ports.clock, ports.stop
        self._origin, self._count = ports.clock.now(), 0

    def wait(self) -> bool:
        """Until the next one; -> whether it came so late that arms which follow no more have come to rest."""
        self._count += 1
        due = self._origin + self._count * TICK_S
        self._clock.sleep_until(due)
        late = self._clock.now() - due
        if late > TICK_S:
            self._origin += late
        if late > LOST_S:
            self._stop.trigger(f"the program was held up for {late:.1f} s in the middle of a motion")
        return late > STALL_S
