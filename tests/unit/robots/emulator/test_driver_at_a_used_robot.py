"""The driver with the emulator of a new robot and of a used robot."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from dataclasses import replace
from types import MappingProxyType

import numpy as np
import pytest
from served import Program, Serve, wait

from foldcell.robots.baxter.emulator.initial_state import NEW, USED, InitialState
from foldcell.robots.baxter.ros.connection import connected
from foldcell.robots.errors import DriverError, FailureKind
from foldcell.robots.model import JointLimits
from foldcell.robots.ports import BoardPlace, GripperState, Ports, Side
from foldcell.robots.ros.driver import RosSettings
from tests.fakes import FakeCell

# a warning of rospy
pytestmark = [pytest.mark.usefixtures("rosmaster"), pytest.mark.filterwarnings("ignore:notifyAll")]
FULL = 0.0416
SPEED = 1.0  # [rad/s]
CALIBRATION_S = 0.4
LIMITS = JointLimits(*(np.full(14, figure) for figure in (-2.0, 2.0, 2.0, 6.0, 60.0)))


class Hand:
    """A gripper of a fake cell. Its calibration takes a while, and it fails the test if it gets a command
    meanwhile."""

    max_opening = FULL

    def __init__(self, cell: FakeCell, side: Side) -> None:
        self._cell, self.side = cell, side
        self.calibrations = 0
        self.done: list[tuple[float, float]] = []
        self._ready = np.inf

    def calibrate(self) -> None:
        self.calibrations += 1
        self._ready = self._cell.now + CALIBRATION_S

    def command(self, opening: float, force: float) -> None:
        assert self._cell.now >= self._ready, "the gripper gets no command before its calibration"
        self.done.append((opening, force))

    def state(self) -> GripperState:
        ready = self._cell.now >= self._ready
        opening = self.done[-1][0] if self.done else FULL
        moving = not ready and self._ready < np.inf
        return GripperState(self._cell.now, self.side, opening, 0.0, moving, ready)


class Person:
    def lay_garment(self) -> None: ...

    def bring_board(self, place: BoardPlace) -> None: ...


class Cell(FakeCell):
    """A fake cell with such grippers."""

    def __init__(self) -> None:
        super().__init__(np.linspace(-0.6, 0.7, 14))
        self.hands = {side: Hand(self, side) for side in Side}

    def ports(self) -> Ports:
        return replace(super().ports(), grippers=MappingProxyType(self.hands))


Meet = Callable[[InitialState], AbstractContextManager[tuple[Ports, Program]]]


@pytest.fixture
def cell() -> Cell:
    return Cell()


@pytest.fixture
def meet(serve: Serve, cell: Cell) -> Meet:
    @contextmanager
    def opened(past: InitialState) -> Iterator[tuple[Ports, Program]]:
        program = serve(cell.ports(), past=past)
        wait(lambda: program.clock.all, "a robot")
        with connected(RosSettings(), LIMITS, lambda stop: Person(), driver="emulator", simulated=True) as ports:
            yield ports, program
        assert program.told == [], "the robot executes all orders of the driver"

    return opened


HISTORIES = {
    "new": NEW,
    "used": USED,
    "grippers in error": replace(USED, error="over current"),
    "new grippers in error": replace(NEW, error="over current"),
}


@pytest.mark.parametrize("past", HISTORIES.values(), ids=HISTORIES)
@pytest.mark.parametrize("at_once", [True, False], ids=["at once", "when it is done"])
def test_the_hands_are_calibrated_and_follow_commands(
    meet: Meet, cell: Cell, past: InitialState, at_once: bool
) -> None:
    with meet(past) as (ports, _):
        for gripper in ports.grippers.values():
            assert gripper.state().calibrated is past.calibrated
            gripper.calibrate()
            if at_once:
                gripper.command(0.02, 6.0)
        for side, gripper in ports.grippers.items():
            wait(lambda gripper=gripper: not gripper.state().moving, "all is done")
            assert gripper.state().calibrated
            if not at_once:
                gripper.command(0.02, 6.0)
                wait(lambda gripper=gripper: not gripper.state().moving, "it is done")
            hand = cell.hands[side]
            assert hand.calibrations == 1 + past.calibrated
            assert hand.done == [(pytest.approx(0.02), pytest.approx(6.0))]
            assert gripper.state().opening == pytest.approx(0.02)


@pytest.mark.parametrize("past", [NEW, USED], ids=["new", "used"])
def test_the_arms_keep_the_commanded_speed_and_hold_after_the_timeout(
    meet: Meet, cell: Cell, past: InitialState
) -> None:
    """Speed, timeout and the rate of the joint states do not depend on earlier commands to the robot."""
    with meet(past) as (ports, program):
        limbs = program.emulator._limbs.values()
        wait(lambda: all((limb.speed_ratio, limb.timeout) == (1.0, 0.2) for limb in limbs), "they are told")
        wait(lambda: program.emulator._state_rate == 100, "the rate is told")
        ports.arms.enable()
        assert program.robot.newest.enabled
        q0 = ports.arms.state().q

        def held() -> bool:
            """Command the arms to stay where they are, until the emulator gets the command."""
            ports.arms.command(q0, np.zeros(14))
            return all(limb._newest is not None for limb in limbs)

        wait(held, "set-points are heard")
        begin, goal = ports.clock.now(), q0
        while (t := ports.clock.now() - begin) < 0.4:
            goal = q0 + SPEED * t * (np.arange(14) == 13)
            ports.arms.command(goal, np.zeros(14))
            ports.clock.sleep_until(ports.clock.now() + 0.01)
        ports.clock.sleep_until(ports.clock.now() + 0.03)
        # the speed ratio is 0.4; the machine may be busy
        np.testing.assert_allclose(cell.q, goal, rtol=0, atol=0.1)
        ports.clock.sleep_until(begin + 1.8)
        assert not [t for t, _ in cell.commands if t > begin + 0.4 + 0.2 + 0.3]


def test_an_earlier_stop_stays_until_it_is_reset(meet: Meet, cell: Cell) -> None:
    with meet(replace(USED, stopped=True)) as (ports, _):
        stop = ports.stop.state()
        assert stop.stopped and "button" in stop.reason
        hand = ports.grippers[Side.LEFT]
        for order in (ports.arms.enable, hand.calibrate, lambda: hand.command(0.02, 6.0)):
            with pytest.raises(DriverError) as caught:
                order()
            assert caught.value.kind is FailureKind.STOPPED
        ports.stop.reset()
        assert not ports.stop.state().stopped
        ports.arms.enable()
        hand.calibrate()
        hand.command(0.02, 6.0)
        wait(lambda: not hand.state().moving, "it is done")
        assert hand.state().opening == pytest.approx(0.02)
