"""The clock of the control loop."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest

from foldcell.cell.control.ticks import LOST_S, TICK_S, Ticks


class Late:
    """A clock that oversleeps by given times."""

    def __init__(self, *oversleeps: float) -> None:
        self.time, self._oversleeps = 5.0, list(oversleeps)

    def now(self) -> float:
        return self.time

    def sleep_until(self, t: float) -> None:
        self.time = max(self.time, t) + (self._oversleeps.pop(0) if self._oversleeps else 0.0)


def ports(clock: Late) -> Any:
    reasons: list[str] = []
    return SimpleNamespace(clock=clock, stop=SimpleNamespace(trigger=reasons.append, reasons=reasons))


def beats(clock: Late, n: int) -> list[float]:
    ticks, seen = Ticks(ports(clock)), []
    for _ in range(n):
        ticks.wait()
        seen.append(clock.time - 5.0)
    return seen


def test_ticks_do_not_drift() -> None:
    assert beats(Late(), 500)[-1] == pytest.approx(500 * TICK_S, abs=1e-9)


def test_a_small_delay_is_caught_up() -> None:
    assert beats(Late(0.004, 0.008), 4) == pytest.approx([0.014, 0.028, 0.030, 0.040])


def test_a_long_stall_is_not_caught_up() -> None:
    """After a stall there is still one set-point per tick, because the arms have not moved on meanwhile."""
    seen = beats(Late(0.0, 0.3), 5)
    assert seen == pytest.approx([0.01, 0.32, 0.33, 0.34, 0.35])


def test_a_stall_that_stops_the_arms_is_reported() -> None:
    cell = ports(Late(0.0, 0.03, 0.0, 0.2, 0.0))
    ticks = Ticks(cell)
    assert [ticks.wait() for _ in range(5)] == [False, False, False, True, False]
    assert not cell.stop.reasons


def test_a_suspended_program_stops_the_robot() -> None:
    """A person may have come near the resting arms, so they must not simply move on."""
    cell = ports(Late(0.0, LOST_S + 0.1))
    ticks = Ticks(cell)
    ticks.wait()
    ticks.wait()
    assert len(cell.stop.reasons) == 1 and "delayed" in cell.stop.reasons[0]
