"""The cell's time: this machine's clock, or the clock of a simulated robot."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator

import pytest
from puppet import Puppet, wait

from foldcell.robots.baxter.ros.messages import load_messages
from foldcell.robots.baxter.ros.ports import clock as clock_module
from foldcell.robots.baxter.ros.ports.clock import TopicClock, WallClock, cell_clock
from foldcell.robots.errors import DriverError, FailureKind
from foldcell.robots.ros.installation import import_ros
from foldcell.robots.ros.node import Node

pytestmark = pytest.mark.filterwarnings("ignore:notifyAll")  # a warning of rospy


class Told:
    """A clock that reads a topic, and its publisher."""

    def __init__(self, node: Node) -> None:
        m = load_messages()
        self._kind, self._time = m.clock, m.time
        self._publisher = import_ros().Publisher("/clock", m.clock, queue_size=10, tcp_nodelay=True)
        self.clock = TopicClock(node)
        wait(self._publisher.get_num_connections, "it is heard")

    def say(self, t: float) -> None:
        self._publisher.publish(self._kind(self._time.from_sec(t)))

    def set(self, t: float) -> None:
        self.say(t)
        wait(lambda: self.clock.now() >= t - 1e-6, "heard")

    def close(self) -> None:
        self._publisher.unregister()


@pytest.fixture
def told(node: Node) -> Iterator[Told]:
    made = Told(node)
    yield made
    made.close()


def test_the_wall_clock_never_goes_back() -> None:
    clock = WallClock()
    times = [clock.now() for _ in range(1000)]
    assert times == sorted(times) and times[0] >= 0.0
    until = clock.now() + 0.05
    clock.sleep_until(until)
    assert clock.now() >= until
    wall = time.monotonic()
    clock.sleep_until(until - 100.0)
    assert time.monotonic() - wall < 10.0


def test_the_time_of_a_suspend_counts(monkeypatch: pytest.MonkeyPatch) -> None:
    """Linux's monotonic clock stops during a suspend, but the boot clock does not. Messages from before the
    suspend are old."""
    slept, read = 0.0, time.clock_gettime
    monkeypatch.setattr(time, "clock_gettime", lambda k: read(k) + (slept if k == time.CLOCK_BOOTTIME else 0.0))
    clock = WallClock()
    before, slept = clock.now(), 600.0
    assert clock.now() - before >= 600.0


def test_the_topics_clock_never_goes_back(told: Told) -> None:
    told.set(12.5)
    told.say(3.0)
    told.set(12.75)
    assert told.clock.now() == 12.75
    seen = []
    for t in (12.0, 13.0, 12.9, 14.0):
        told.say(t)
        seen.append(told.clock.now())
    told.set(14.5)
    assert seen == sorted(seen) and min(seen) >= 12.75


def test_sleeping_ends_at_the_time_of_the_topic(told: Told) -> None:
    told.set(1.0)
    woken: list[float] = []

    def sleep() -> None:
        told.clock.sleep_until(2.0)
        woken.append(told.clock.now())

    sleeper = threading.Thread(target=sleep, daemon=True)
    sleeper.start()
    for t in (1.2, 1.5, 1.99):
        told.set(t)
        time.sleep(0.02)
        assert not woken
    told.set(2.0)
    sleeper.join(60.0)
    assert woken == [2.0]
    told.clock.sleep_until(1.5)
    assert told.clock.now() == 2.0


def test_a_time_step_below_rounding_is_ignored(told: Told) -> None:
    told.set(2.0)
    told.clock.sleep_until(2.0 + 1e-9)


@pytest.mark.parametrize("talks", [False, True], ids=["silent", "says the same again"])
def test_a_clock_that_stops_is_a_driver_error(told: Told, monkeypatch: pytest.MonkeyPatch, talks: bool) -> None:
    monkeypatch.setattr(clock_module, "SILENCE_S", 0.4)
    told.set(7.0)
    over = threading.Event()

    def talk() -> None:
        while not over.wait(0.02):
            told.say(7.0)

    talker = threading.Thread(target=talk, daemon=True)
    caught: list[DriverError] = []

    def sleep() -> None:
        try:
            told.clock.sleep_until(8.0)
        except DriverError as error:
            caught.append(error)

    sleeper = threading.Thread(target=sleep, daemon=True)
    if talks:
        talker.start()
    sleeper.start()
    sleeper.join(30.0)
    over.set()
    if talks:
        talker.join(30.0)
    assert caught and caught[0].kind is FailureKind.HARDWARE_FAULT and "7.00" in caught[0].what


@pytest.mark.parametrize(("simulated", "kind"), [(True, TopicClock), (False, WallClock)])
def test_the_use_sim_time_parameter_selects_the_clock(
    puppet: Puppet, node: Node, simulated: bool, kind: type
) -> None:
    node.set_parameter("/use_sim_time", simulated)
    try:
        assert type(cell_clock(node)) is kind
    finally:
        node.delete_parameter("/use_sim_time")
    assert type(cell_clock(node)) is WallClock
