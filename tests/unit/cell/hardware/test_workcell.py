"""Computing on a worker thread: a stop is detected meanwhile, and the declared time is charged."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import pytest

from foldcell.robots.errors import DriverError, FailureKind
from tests.fakes import FakeCell
from tests.workcells import fake_workcell


@pytest.fixture
def workers() -> Iterator[ThreadPoolExecutor]:
    with ThreadPoolExecutor(1) as pool:
        yield pool


@pytest.mark.parametrize("charge", [2.5, lambda result: result / 4])
def test_the_declared_time_is_charged_for_any_computing_time(workers: ThreadPoolExecutor, charge) -> None:
    cell = FakeCell()
    workcell = fake_workcell(cell, workers)
    for real in (0.0, 0.06):
        before = cell.now
        assert workcell.compute(charge, lambda real=real: time.sleep(real) or 10) == 10
        assert cell.now - before == pytest.approx(2.5)


def test_a_real_cell_is_not_charged(workers: ThreadPoolExecutor) -> None:
    cell = FakeCell()
    workcell = fake_workcell(cell, workers, ports=replace(cell.ports(), simulated=False))
    workcell.compute(2.5, lambda: 1)
    assert cell.now == 0.0


def test_a_stop_abandons_the_computation(workers: ThreadPoolExecutor) -> None:
    cell, free = FakeCell(), threading.Event()
    workcell = fake_workcell(cell, workers)
    threading.Timer(0.05, workcell.ports.stop.trigger, ["button"]).start()
    try:
        with pytest.raises(DriverError, match="button") as caught:
            workcell.compute(2.5, free.wait)  # waiting for the discarded result would take forever
        assert caught.value.kind is FailureKind.STOPPED
        assert cell.now == 0.0, "a discarded computation is not charged"
    finally:
        free.set()


def test_an_exception_in_a_skill_propagates(workers: ThreadPoolExecutor) -> None:
    with pytest.raises(ZeroDivisionError):
        fake_workcell(FakeCell(), workers).compute(0.0, lambda: 1 // 0)
