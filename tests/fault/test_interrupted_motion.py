"""Motions of the simulated arms that a stop, a strayed arm or missing set-points interrupt."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from foldcell.cell.control.motions.trajectory import stream
from foldcell.cell.control.path_clock import PathControl
from foldcell.cell.executive.effects.moving import hold_still
from foldcell.cell.hardware.workcell import Workcell
from foldcell.cell.simulation import Fault, FaultKind, SimulatedCell, SimulationSettings, open_simulated_cell
from foldcell.cell.states.run_context import RunContext
from foldcell.robots.baxter.robot import load_model
from foldcell.robots.errors import DriverError, Failure, FailureKind
from foldcell.robots.ports import ArmTrajectory, Ports, Side
from foldcell.skills.motion.timing.timing import free_motion
from tests.fakes import FakeCell
from tests.workcells import fake_workcell

pytestmark = pytest.mark.long

MODEL = load_model()
THERE = MODEL.q_park + np.r_[-0.5, -0.3, 0.0, -0.6, np.zeros(3), 0.5, -0.3, 0.0, -0.6, np.zeros(3)]
MOTION = free_motion(MODEL.q_park, THERE, MODEL.planning)


@pytest.fixture
def cell() -> Iterator[SimulatedCell]:
    with open_simulated_cell(SimulationSettings(garment="small_towel", render=False), 1) as opened:
        opened.ports.arms.enable()
        yield opened


def workcell_of(ports: Ports) -> Workcell:
    return fake_workcell(FakeCell(), ports=ports, robot=MODEL)


def run(workcell: Workcell, disturb: Callable[[], object]) -> Failure | None:
    """Stream MOTION. `disturb` is called once, halfway, when the arms are fastest."""
    calls = [disturb]

    def watch(tick: Any) -> None:
        if tick.t > 0.5 * MOTION.duration and calls:
            calls.pop()()

    control = PathControl(None, MODEL.protective, MODEL.planning)
    try:
        return stream(workcell.loop, MOTION, watch, control).failure
    except DriverError as error:
        return error.failure()


def farthest_in_a_second(ports: Ports) -> float:
    """The largest joint motion in the next second [rad]."""
    start, far = ports.arms.state().q, 0.0
    for _ in range(100):
        ports.clock.sleep_until(ports.clock.now() + 0.01)
        far = max(far, float(np.abs(ports.arms.state().q - start).max()))
    return far


def test_arms_do_not_move_after_a_run_that_was_stopped_in_mid_motion(cell: SimulatedCell) -> None:
    """The arms brake for up to 0.3 s after the stop. The run ends when they rest."""
    workcell = workcell_of(cell.ports)
    failure = run(workcell, lambda: cell.ports.stop.trigger("the button"))
    assert failure is not None and failure.kind is FailureKind.STOPPED
    assert np.abs(cell.ports.arms.state().qd).max() > 0.5, "the arms are in full motion"
    hold_still(workcell, RunContext())
    assert farthest_in_a_second(cell.ports) < 0.01


def test_arms_do_not_move_after_a_fault(cell: SimulatedCell) -> None:
    """An arm drops and comes back, while the run ends with a command to hold."""
    workcell = workcell_of(cell.ports)
    fault = Fault(FaultKind.SUDDEN_DROP, side=Side.LEFT, size=0.15, duration=0.8)
    failure = run(workcell, lambda: cell.faults.add(fault))
    assert failure is not None and failure.kind is FailureKind.TRACKING_ERROR
    hold_still(workcell, RunContext())
    assert farthest_in_a_second(cell.ports) < 0.01


class Stalling:
    """The cell's clock, for a program that stalls once."""

    def __init__(self, clock: Any) -> None:
        self._clock, self.stall_s = clock, 0.0

    def now(self) -> float:
        return float(self._clock.now())

    def sleep_until(self, t: float) -> None:
        late, self.stall_s = self.stall_s, 0.0
        self._clock.sleep_until(t + late)


@pytest.mark.parametrize("stall_s", [0.08, 0.15, 0.3, 0.6])
def test_a_motion_continues_after_set_points_were_missing(stall_s: float, cell: SimulatedCell) -> None:
    """Without set-points the arms hold after 0.2 s, further on than the last one. From there they go on."""
    clock, at_rest = Stalling(cell.ports.clock), cell.ports.arms.state().q
    workcell = workcell_of(replace(cell.ports, clock=clock))
    assert np.abs(at_rest - MODEL.q_park).max() < 0.01
    failure = run(workcell, lambda: setattr(clock, "stall_s", stall_s))
    assert failure is None, failure
    assert np.abs(cell.ports.arms.state().q - THERE).max() < 0.01


def reversed_motion(motion: ArmTrajectory) -> ArmTrajectory:
    return ArmTrajectory(motion.t, motion.q[::-1].copy(), -motion.qd[::-1], motion.qdd[::-1].copy())


def test_the_same_motion_runs_backwards_after_a_stall(cell: SimulatedCell) -> None:
    """The arms stand behind the last set-point when the program stalls while they speed up again."""
    clock = Stalling(cell.ports.clock)
    workcell = workcell_of(replace(cell.ports, clock=clock))
    assert run(workcell, lambda: setattr(clock, "stall_s", 0.3)) is None
    control = PathControl(None, MODEL.protective, MODEL.planning)
    stalls = iter((0.3, 0.3))

    def watch(tick: Any) -> None:
        if tick.t > 0.3 * MOTION.duration and clock.stall_s == 0.0:
            clock.stall_s = next(stalls, 0.0)

    back = reversed_motion(MOTION)
    assert stream(workcell.loop, back, watch, control).ok
    assert np.abs(cell.ports.arms.state().q - MODEL.q_park).max() < 0.01
