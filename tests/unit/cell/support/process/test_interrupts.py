"""Signals while a cell is open, while it closes, and afterwards."""

from __future__ import annotations

import signal
from collections.abc import Iterator
from dataclasses import replace

import pytest

from cell.support.process.interrupts import taking_signals
from tests.fakes import FakeCell

ALL = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGCONT)


@pytest.fixture(autouse=True)
def before() -> Iterator[None]:
    """The tests begin with the default SIGHUP handler, because under nohup SIGHUP would be ignored."""
    found = signal.signal(signal.SIGHUP, signal.SIG_DFL)
    kept = {n: signal.getsignal(n) for n in ALL}
    yield
    after = {n: signal.getsignal(n) for n in ALL}
    signal.signal(signal.SIGHUP, found)
    assert after == kept, "the earlier signal handlers are restored"


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_stops_the_cell_without_killing_the_process(number: signal.Signals) -> None:
    cell = FakeCell()
    with taking_signals() as interrupts:
        with interrupts.stop(cell.ports(), asked=False):
            signal.raise_signal(number)
            assert cell.stop_reason == number.name
        signal.raise_signal(number)  # the signal arrives while the result is written
        assert interrupts.received == [number, number]


@pytest.mark.parametrize(("asked", "reason"), [(False, "SIGHUP"), (True, "")])
def test_a_hangup_stops_an_unattended_run(asked: bool, reason: str) -> None:
    """An attended run is not stopped, because its question ends with the terminal, or the page answers it."""
    cell = FakeCell()
    with taking_signals() as interrupts, interrupts.stop(cell.ports(), asked=asked):
        signal.raise_signal(signal.SIGHUP)
        assert cell.stop_reason == reason


def test_a_hangup_is_ignored_under_nohup() -> None:
    handler = signal.signal(signal.SIGHUP, signal.SIG_IGN)
    cell = FakeCell()
    try:
        with taking_signals() as interrupts, interrupts.stop(cell.ports(), asked=False):
            signal.raise_signal(signal.SIGHUP)
        assert cell.stop_reason == "" and signal.getsignal(signal.SIGHUP) is signal.SIG_IGN
    finally:
        signal.signal(signal.SIGHUP, handler)


@pytest.mark.parametrize(("driver", "stopped"), [("sim", False), ("emulator", True), ("ros", True)])
def test_a_suspended_program_stops_a_real_robot(driver: str, stopped: bool) -> None:
    """A simulated cell waits for its executive, so a program suspended with Ctrl-Z can be continued."""
    cell = FakeCell()
    with taking_signals() as interrupts, interrupts.stop(replace(cell.ports(), driver=driver), asked=False):
        signal.raise_signal(signal.SIGCONT)
        assert bool(cell.stop_reason) is stopped
