"""The network of the emulated robot: how messages travel, and what the driver makes of a bad one."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import SimpleNamespace

import numpy as np
import pytest
from served import Serve, wait

from foldcell.cell.simulation import SimulationSettings
from foldcell.cell.simulation.emulator import emulated
from foldcell.robots.baxter.emulator.line import Line, by_robots_clock
from foldcell.robots.baxter.ros import topics
from foldcell.robots.baxter.ros.connection import connected
from foldcell.robots.errors import DriverError
from foldcell.robots.model import JointLimits
from foldcell.robots.ports import Ports
from foldcell.robots.ros.driver import Network, RosSettings
from tests.fakes import FakeCell

# a warning of rospy
pytestmark = pytest.mark.filterwarnings("ignore:notifyAll")
LIMITS = JointLimits(*(np.full(14, figure) for figure in (-2.0, 2.0, 2.0, 6.0, 60.0)))
TICK = 0.01


def arrivals(network: Network, count: int = 400, latched: bool = False) -> list[tuple[int, float]]:
    """(number, delay) of the messages that arrive, in their order; one is sent each 10 ms."""
    line, arrived = Line(network), list[tuple[int, float]]()

    def arrival_of(number: int) -> Callable[[float], None]:
        return lambda t: arrived.append((number, t - number * TICK))

    for k in range(count + 100):
        if k < count:
            line.send("topic", k * TICK, arrival_of(k), latched)
        line.deliver(k * TICK)
    assert not len(line)
    return arrived


def test_an_undisturbed_network_delivers_all_in_order_and_at_once() -> None:
    assert arrivals(Network()) == [(k, 0.0) for k in range(400)]


def test_messages_take_the_delay_and_its_jitter_in_order() -> None:
    numbers, delays = zip(*arrivals(Network(delay=0.02, jitter=0.01)), strict=True)
    assert numbers == tuple(range(400))
    assert 0.01 <= min(delays) < 0.012 and 0.028 < max(delays) < 0.0301


def test_messages_overtake_only_if_the_network_reorders() -> None:
    kept = [k for k, _ in arrivals(Network(delay=0.05, jitter=0.05))]
    mixed = [k for k, _ in arrivals(Network(delay=0.05, jitter=0.05, reordering=True))]
    assert kept == list(range(400))
    assert mixed != kept and sorted(mixed) == kept


def test_the_stated_share_is_lost_except_of_latched_messages() -> None:
    assert 20 <= 400 - len(arrivals(Network(loss=0.1))) <= 60
    assert len(arrivals(Network(loss=0.1), latched=True)) == 400


class Stamp(float):
    def to_sec(self) -> float:
        return float(self)

    @classmethod
    def from_sec(cls, seconds: float) -> Stamp:
        return cls(seconds)


def test_only_the_stamps_follow_the_robots_clock() -> None:
    header = SimpleNamespace(stamp=Stamp(5.0))
    pair = [by_robots_clock(SimpleNamespace(header=header, data=k), 3.0) for k in range(2)]
    assert [message.header.stamp for message in pair] == [8.0, 8.0], "a shared header is moved once"
    assert by_robots_clock(SimpleNamespace(timestamp=Stamp(5.0)), -2.0).timestamp == 3.0
    assert by_robots_clock("no stamp", 3.0) == "no stamp"


def test_the_master_is_suspended_for_a_while_and_never_left_so(monkeypatch: pytest.MonkeyPatch) -> None:
    signals: list[str] = []
    master = SimpleNamespace(send_signal=lambda number: signals.append(number.name))
    monkeypatch.setattr(emulated, "_master", master)
    with emulated._silent_master(0.0, 0.02):
        wait(lambda: len(signals) == 2, "the master goes on")
    assert signals == ["SIGSTOP", "SIGCONT", "SIGCONT"]
    with emulated._silent_master(0.0, 60.0):
        wait(lambda: len(signals) == 4, "the master is silent")
    assert signals[3:] == ["SIGSTOP", "SIGCONT"]
    with emulated._silent_master(0.0, 0.0):
        time.sleep(0.02)
    assert signals[5:] == ["SIGCONT"]


def test_a_world_whose_process_has_ended_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    def ended(*_: object) -> None:
        raise BrokenPipeError(32, "Broken pipe")

    def silent(seconds: float) -> None:
        raise TimeoutError(f"no answer in {seconds:.0f} s")

    process = SimpleNamespace(
        send=lambda message: None, answer=lambda seconds: "ready", close=lambda patience_s: None
    )
    monkeypatch.setattr(emulated, "ServerProcess", lambda module, silent: process)
    world = emulated._World(SimulationSettings(), 0, RosSettings(), Network())
    process.send, process.answer = ended, ended
    with pytest.raises(DriverError, match="the emulated robot does not respond: its process ended"):
        world.ask("checkpoint")
    process.answer = silent
    with pytest.raises(DriverError, match="no answer in 120 s"):
        world.ask("truth")
    process.answer = ended  # the pipe is closed after a timeout
    with pytest.raises(DriverError, match="no answer in 120 s"):
        world.ask("checkpoint")


# over ROS ----------------------------------------------------------------------------------------------


@contextmanager
def met(serve: Serve, cell: FakeCell, network: Network) -> Iterator[Ports]:
    program = serve(cell.ports(), network=network)
    wait(lambda: program.clock.all, "a robot")
    attendant = SimpleNamespace(lay_garment=lambda: None, bring_board=lambda place: None)
    with connected(RosSettings(), LIMITS, lambda stop: attendant, driver="emulator", simulated=True) as ports:
        yield ports


BAD = {
    "late": Network(delay=0.02, jitter=0.01, loss=0.01),
    "out of order": Network(delay=0.03, jitter=0.03, reordering=True),
    "lossy": Network(loss=0.3),
    "repeated": Network(repeat=0.1),
    "clock ahead": Network(clock_ahead=5.0),
    "clock behind": Network(clock_ahead=-5.0),
}


@pytest.mark.usefixtures("rosmaster")
@pytest.mark.parametrize("network", BAD.values(), ids=BAD)
def test_the_driver_moves_and_stops_the_arms_over_a_bad_network(
    serve: Serve, cell: FakeCell, network: Network
) -> None:
    """The arms reach their goal, readings stay fresh, and a stop reaches the robot."""
    with met(serve, cell, network) as ports:
        ports.arms.enable()
        goal, q = cell.q.copy(), ports.arms.state().q
        goal[6] += 0.2
        until = ports.clock.now() + 5.0
        while np.abs(ports.arms.state().q - goal).max() > 1e-3 and ports.clock.now() < until:
            q = q + np.clip(goal - q, -0.004, 0.004)
            ports.arms.command(q, np.zeros(14))
            ports.clock.sleep_until(ports.clock.now() + TICK)
            age = ports.clock.now() - ports.arms.state().stamp
            assert -TICK < age < 0.2, "fresh, by the cell's own clock"
        np.testing.assert_allclose(ports.arms.state().q, goal, atol=1e-3)
        ports.stop.trigger("enough")
        wait(lambda: cell.stop_reason, "the robot is stopped")


@pytest.mark.usefixtures("rosmaster")
def test_readings_are_as_old_as_the_network_is_slow(serve: Serve, cell: FakeCell) -> None:
    program = serve(cell.ports(), network=Network(delay=0.1))
    states = program.hear(topics.JOINT_STATES, program.m.joint_state)
    wait(lambda: states.all, "a state")
    ages = []
    for _ in range(20):
        program.let(TICK)
        ages.append(program.now() - states.newest.header.stamp.to_sec())
    assert min(ages) > 0.1 - 2 * TICK
