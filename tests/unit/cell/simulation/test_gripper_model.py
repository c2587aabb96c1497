"""The simulated gripper: closing on cloth, sensing, refusal before calibration."""

from __future__ import annotations

import pytest

from foldcell.cell.simulation.noise import load_noise
from foldcell.cell.simulation.robot.gripper import SimulatedGripper
from foldcell.robots.errors import DriverError, FailureKind
from foldcell.robots.ports import Side

NOISE = load_noise().gripper
DT = 1 / 240


class Bench:
    """A gripper with `thickness` [m] between its pads whenever they close."""

    def __init__(self, thickness: float = 0.0, calibrated: bool = True) -> None:
        self.thickness, self.closings, self.openings, self.t = thickness, [], 0, 0.0
        self.gripper = SimulatedGripper(Side.LEFT, 0.0416, NOISE, 1, True, self.caught, self.opened)
        if calibrated:
            self.gripper.calibrate()
            self.run(NOISE.calibration_time + 0.5)

    def caught(self, stroke: float, force: float) -> float:
        self.closings.append((stroke, force))
        return self.thickness

    def opened(self) -> None:
        self.openings += 1

    def run(self, seconds: float) -> None:
        for _ in range(round(seconds / DT)):
            self.t += DT
            self.gripper.step(self.t, DT)


def test_a_gripper_refuses_before_calibration_and_follows_after_it() -> None:
    bench = Bench(calibrated=False)
    with pytest.raises(DriverError) as refusal:
        bench.gripper.command(0.02, 10.0)
    assert refusal.value.kind is FailureKind.GRIPPER_FAULT
    bench.gripper.calibrate()
    bench.gripper.command(0.02, 10.0)  # this command waits for the calibration
    assert bench.gripper.state().moving
    bench.run(NOISE.calibration_time + 0.5)
    assert bench.gripper.state().calibrated
    assert bench.gripper.state().opening == pytest.approx(0.02)
    assert bench.closings == []  # the calibration grips nothing


def test_a_calibrated_gripper_counts_as_not_calibrated_while_it_is_calibrated_again() -> None:
    """Who waits for the end of a calibration waits for `calibrated`, as with the real gripper."""
    bench = Bench()
    bench.gripper.calibrate()
    bench.run(0.5 * NOISE.calibration_time)
    state = bench.gripper.state()
    assert state.moving and not state.calibrated
    bench.run(NOISE.calibration_time)
    assert bench.gripper.state().calibrated


def test_an_empty_gripper_closes_fully_without_force() -> None:
    bench = Bench()
    bench.gripper.command(0.03, 10.0)
    bench.run(0.3)
    bench.gripper.command(0.0, 10.0)
    bench.run(0.2)
    assert bench.gripper.state().moving
    bench.run(0.3)
    state = bench.gripper.state()
    assert (state.opening, state.force, state.moving) == (0.0, 0.0, False)
    assert bench.closings == [(pytest.approx(0.03), 10.0)]


@pytest.mark.parametrize("repeats", [1, 60])
def test_a_command_that_is_repeated_on_the_way_does_not_shorten_the_stroke(repeats: int) -> None:
    """The pads draw cloth from the opening at which they began to close, however often the command is sent."""
    bench = Bench(thickness=0.004)
    for opening in (0.030, 0.024):
        bench.gripper.command(opening, 10.0)
        bench.run(0.5)
        for _ in range(repeats):
            bench.gripper.command(0.0, 10.0)
            bench.run(0.5 / repeats)
    assert bench.closings == [(pytest.approx(0.030), 10.0), (pytest.approx(0.024), 10.0)]


@pytest.mark.parametrize("thickness", [0.0025, 0.0075, 0.010])
def test_a_gripper_stops_on_cloth_and_releases_it_when_opened(thickness: float) -> None:
    """Three layers of terry are thicker than the opening at which the pads catch cloth."""
    bench = Bench(thickness=thickness)
    bench.gripper.command(0.0, 12.0)
    bench.run(1.0)
    state = bench.gripper.state()
    assert state.opening == pytest.approx(thickness)
    assert state.force == pytest.approx(12.0, rel=0.01)
    assert not state.moving and len(bench.closings) == 1 and bench.openings == 0 and bench.gripper.holding
    bench.gripper.command(0.03, 12.0)
    bench.run(0.5)
    assert bench.openings == 1 and not bench.gripper.holding
    assert bench.gripper.state().force == pytest.approx(0.0, abs=0.01)


def test_pads_close_fully_after_the_cloth_slips_out() -> None:
    bench = Bench(thickness=0.004)
    bench.gripper.command(0.0, 12.0)
    bench.run(1.0)
    bench.gripper.lost()
    bench.run(0.5)
    assert bench.gripper.state().opening == 0.0
    assert bench.openings == 0


def test_a_stuck_gripper_does_not_move_and_does_not_report_moving() -> None:
    bench = Bench()
    before = bench.gripper.state().opening
    bench.gripper.stuck = True
    bench.gripper.command(0.0, 10.0)
    bench.run(1.0)
    state = bench.gripper.state()
    assert state.opening == before and not state.moving


@pytest.mark.parametrize("opening", [float("nan"), float("inf")])
def test_an_invalid_opening_is_refused(opening: float) -> None:
    with pytest.raises(DriverError):
        Bench().gripper.command(opening, 1.0)
