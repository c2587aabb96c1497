"""Ticks of the control loop, one every 10 ms (100 Hz) of the cell's clock."""

from __future__ import annotations

from foldcell.robots.ports import Ports

TICK_S = 0.01
STALL_S = 0.05
"""If a tick is later than this, the arms have come to rest, so the motion accelerates from rest [s]."""
LOST_S = 2.0
"""If a tick is later than this, the stop is triggered, because a person may have come near the standing arms
[s]."""


class Ticks:
    """Ticks of the loop, counted from the creation of this object.

    If a tick is late by more than TICK_S, the following ticks are counted from the present time, because catching
    up would send set-points ahead of the arms. A delay of more than LOST_S (a suspended program, a laptop that
    slept) triggers the stop, because the robot must not move on by itself after such a delay. The clock of a
    simulated cell waits for the executive, so the executive is never late there.
    """

    def __init__(self, ports: Ports) -> None:
        self._clock, self._stop = ports.clock, ports.stop
        self._origin, self._count = ports.clock.now(), 0

    def wait(self) -> bool:
        """Wait for the next tick. Returns whether it came so late that the arms have come to rest."""
        self._count += 1
        due = self._origin + self._count * TICK_S
        self._clock.sleep_until(due)
        late = self._clock.now() - due
        if late > TICK_S:
            self._origin += late
        if late > LOST_S:
            self._stop.trigger(f"the program was delayed for {late:.1f} s in the middle of a motion")
        return late > STALL_S
