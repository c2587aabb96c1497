"""Signals while a cell is open, while it closes, and afterwards."""

from __future__ import annotations

import os
import signal
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from threading import Event, Thread
from time import sleep

import pytest

from foldcell.cell.support.process.signals import Terminated, taking_signals
from foldcell.skills.compiled import _on_a_thread
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


def test_a_signal_is_acknowledged_at_once_each_time(capsys: pytest.CaptureFixture[str]) -> None:
    with taking_signals() as interrupts:
        with interrupts.stop(FakeCell().ports(), asked=False):
            signal.raise_signal(signal.SIGINT)
            assert capsys.readouterr().err == "SIGINT: the cell stops\n"
            signal.raise_signal(signal.SIGTERM)
            assert capsys.readouterr().err == "SIGTERM: the cell stops\n"
        signal.raise_signal(signal.SIGINT)
        assert capsys.readouterr().err == "please wait: the end of the run is being written\n"


class Compiling:
    """Compilations that end when the test ends."""

    def __init__(self) -> None:
        self.begun, self.end = Event(), Event()
        self.compile = _on_a_thread(self._compile)

    def _compile(self, signature: object) -> object:
        self.begun.set()
        assert self.end.wait(60.0)
        return signature

    def signalled(self) -> None:
        """Send SIGTERM when the compilation has begun."""
        self.begun.wait()
        os.kill(os.getpid(), signal.SIGTERM)


@pytest.fixture
def compiling() -> Iterator[Compiling]:
    compiling = Compiling()
    yield compiling
    compiling.end.set()


@pytest.mark.parametrize("closing", [False, True])
@pytest.mark.timeout(30)
def test_a_simulated_cell_does_not_wait_for_the_compiler(compiling: Compiling, closing: bool) -> None:
    cell, sender = FakeCell(), Thread(target=compiling.signalled)
    sender.start()
    with pytest.raises(Terminated), taking_signals() as interrupts:
        with interrupts.stop(cell.ports(), asked=False):
            if not closing:
                compiling.compile("i8(i8)")
        compiling.compile("i8(i8)")
    assert (cell.stop_reason == "SIGTERM") is not closing
    sender.join()


@pytest.mark.timeout(30)
def test_a_robot_is_stopped_in_order_even_if_code_is_compiled(compiling: Compiling) -> None:
    cell = FakeCell()

    def signalled() -> None:
        compiling.signalled()
        while not cell.stop_reason:
            sleep(0.01)
        compiling.end.set()

    sender = Thread(target=signalled)
    sender.start()
    ports = replace(cell.ports(), simulated=False)
    with taking_signals() as interrupts, interrupts.stop(ports, asked=False):
        assert compiling.compile("i8(i8)") == "i8(i8)" and cell.stop_reason == "SIGTERM"
    sender.join()


@pytest.mark.timeout(30)
def test_a_stopped_skill_does_not_wait_for_the_compiler(compiling: Compiling) -> None:
    """The end of the run waits for the thread on which the skill computes."""
    cell = FakeCell()
    with taking_signals() as interrupts, ThreadPoolExecutor(1) as skills:
        with interrupts.stop(cell.ports(), asked=False):
            skill = skills.submit(compiling.compile, "i8(i8)")
            compiling.begun.wait()
            signal.raise_signal(signal.SIGINT)
        assert isinstance(skill.exception(), RuntimeError) and cell.stop_reason == "SIGINT"
