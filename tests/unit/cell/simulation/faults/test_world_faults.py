"""Faults in the world: the arms, the grippers, the cloth and the pictures really change, and heal when stated."""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import numpy as np
import pytest

from foldcell.cell.simulation import Fault, FaultKind, SimulationSettings
from foldcell.robots.errors import DriverError, FailureKind
from foldcell.robots.ports import Array, Side, arm_slice
from tests.simulated_bench import BLIND, DT, QUIET, Bench, corner

K = FaultKind
SEEING = SimulationSettings(garment="small_towel", camera_noise=False)


@pytest.fixture
def opened(open_bench: Any) -> Any:
    return lambda settings=QUIET, seed=2: open_bench(settings, seed)


def inject(bench: Bench, kind: FaultKind, **traits: Any) -> None:
    bench.cell.faults.add(Fault(kind, at=bench.ports.clock.now(), **traits))


def vertices(bench: Bench) -> Array:
    garment = bench.truth().garment
    assert garment is not None
    return garment.vertices


def grasped(bench: Bench) -> Array:
    """A corner in the left hand, 0.12 m above the table. Returns its place."""
    point = corner(bench)
    bench.pinch(Side.LEFT, point)
    assert bench.truth().held[Side.LEFT]
    bench.move(bench.above(Side.LEFT, point, 0.12, np.pi / 2), 1.5)
    return point


# arms and stop circuit


def test_an_arm_that_hangs_stands_still_and_catches_up_at_a_bounded_speed(opened: Any) -> None:
    bench = opened().ready()
    inject(bench, K.ARM_HANGS, side=Side.LEFT, duration=1.0)
    left, right = arm_slice(Side.LEFT, 14), arm_slice(Side.RIGHT, 14)
    start = bench.ports.arms.state().q
    bench.move(bench.q + 0.2, 0.9)
    stuck = bench.ports.arms.state().q
    assert np.abs(stuck[left] - start[left]).max() < 0.01
    assert np.abs(stuck[right] - start[right] - 0.2).max() < 0.02
    speeds = []
    for _ in range(80):
        bench.hold(DT)
        speeds.append(np.abs(bench.ports.arms.state().qd[left]).max())
    assert np.abs(bench.ports.arms.state().q[left] - bench.q[left]).max() < 0.01
    assert max(speeds) < 4.5


def test_starved_set_points_leave_the_arms_at_rest_on_their_way(opened: Any) -> None:
    bench = opened().ready()
    speed = np.zeros(14)
    speed[0] = 0.5
    inject(bench, K.SETPOINTS_STARVED, duration=0.6)
    start = bench.ports.arms.state().q[0]
    for _ in range(55):
        bench.wait(DT)
        sent = bench.ports.arms.command(bench.q, speed)
        assert sent.q[0] == bench.q[0], "the sender does not notice it"
    assert abs(bench.ports.arms.state().q[0] - start) < 1e-3
    bench.hold(0.1)
    bench.move(bench.q + 0.05, 0.5)
    assert bench.ports.arms.state().q[0] - start == pytest.approx(0.05, abs=0.01), "later set-points arrive"


@pytest.mark.parametrize(
    ("kind", "size", "dropped"), [(K.SUDDEN_DROP, 0.03, (Side.LEFT,)), (K.SUDDEN_DROP_BOTH, 0.06, tuple(Side))]
)
def test_arms_drop_for_the_duration_and_return(
    opened: Any, kind: FaultKind, size: float, dropped: tuple[Side, ...]
) -> None:
    bench = opened().ready()
    before = {side: bench.truth().tools[side][2] for side in Side}
    inject(bench, kind, size=size, duration=0.4)
    lowest = dict(before)
    for _ in range(25):
        bench.hold(0.02)
        lowest = {side: min(lowest[side], bench.truth().tools[side][2]) for side in Side}
    for side in Side:
        drop = before[side] - lowest[side]
        assert 0.5 * size < drop < 1.5 * size if side in dropped else drop < 2e-3
        assert bench.truth().tools[side][2] == pytest.approx(before[side], abs=2e-3)


def test_a_flapping_stop_switches_the_motors_off_for_good(opened: Any) -> None:
    bench = opened().ready()
    inject(bench, K.STOP_FLAPPING, size=0.05, duration=0.3)
    seen = []
    for _ in range(40):
        bench.wait(DT)
        seen.append(bench.ports.stop.state().stopped)
        with pytest.raises(DriverError) as error:
            bench.ports.arms.command(bench.q, np.zeros(14))
        assert error.value.kind is (FailureKind.STOPPED if seen[-1] else FailureKind.HARDWARE_FAULT)
    changes = sum(a != b for a, b in pairwise(seen))
    assert changes == 5 and not any(seen[-5:])
    bench.ports.arms.enable()
    bench.hold(DT)


def test_a_flapping_stop_does_not_release_a_stop_that_somebody_pressed(opened: Any) -> None:
    bench = opened().ready()
    inject(bench, K.STOP_FLAPPING, size=0.05, duration=0.3)
    bench.wait(0.02)
    bench.ports.stop.trigger("the button")
    bench.wait(1.0)
    assert bench.ports.stop.state().reason == "the button"


def test_a_stalled_program_sleeps_while_the_arms_brake(opened: Any) -> None:
    bench = opened().ready()
    inject(bench, K.PROGRAM_STALLED, size=0.6)
    began = bench.ports.clock.now()
    bench.wait(DT)
    assert bench.ports.clock.now() - began == pytest.approx(0.6 + DT)
    bench.wait(DT)
    assert bench.ports.clock.now() - began == pytest.approx(0.6 + 2 * DT)


def test_a_stepped_clock_leaves_the_world_where_it_was(opened: Any) -> None:
    bench = opened().ready()
    at = bench.ports.clock.now()
    inject(bench, K.CLOCK_STEP, size=5.0)
    assert bench.ports.clock.now() == pytest.approx(at + 5.0)
    assert bench.truth().stamp == pytest.approx(at)
    bench.hold(0.1)
    assert bench.truth().stamp == pytest.approx(at + 0.1)
    ports = bench.ports
    stamps = [
        ports.arms.state().stamp,
        ports.grippers[Side.LEFT].state().stamp,
        ports.tactile[Side.LEFT].reading().stamp,
    ]
    assert stamps == pytest.approx([at + 5.1] * 3, abs=0.011)


# grippers


def test_a_gripper_in_error_refuses_until_it_is_calibrated(opened: Any) -> None:
    bench = opened().ready()
    gripper = bench.ports.grippers[Side.LEFT]
    inject(bench, K.GRIPPER_ERROR, side=Side.LEFT, duration=0.5)
    bench.wait(0.1)
    assert gripper.state().in_error and not bench.ports.grippers[Side.RIGHT].state().in_error
    with pytest.raises(DriverError) as error:
        gripper.command(0.03, 5.0)
    assert error.value.kind is FailureKind.GRIPPER_FAULT
    gripper.calibrate()
    assert gripper.state().in_error, "it is still broken"
    bench.wait(0.5)
    gripper.calibrate()
    bench.wait(1.5)
    gripper.command(0.01, 5.0)
    bench.wait(1.0)
    assert not gripper.state().in_error and gripper.state().opening == pytest.approx(0.01, abs=1e-3)


def test_a_gripper_that_lost_its_calibration_can_be_calibrated_again(opened: Any) -> None:
    bench = opened().ready()
    gripper = bench.ports.grippers[Side.RIGHT]
    inject(bench, K.GRIPPER_UNCALIBRATED, side=Side.RIGHT)
    bench.wait(0.1)
    assert not gripper.state().calibrated
    with pytest.raises(DriverError, match="not calibrated"):
        gripper.command(0.03, 5.0)
    gripper.calibrate()
    bench.wait(1.5)
    gripper.command(0.03, 5.0)
    assert gripper.state().calibrated


def test_a_weak_gripper_presses_with_a_share_of_its_force(opened: Any) -> None:
    bench = opened().ready()
    bench.ports.attendant.lay_garment()
    inject(bench, K.GRIPPER_WEAK, side=Side.LEFT, size=0.3)
    bench.pinch(Side.LEFT, corner(bench))
    assert bench.ports.tactile[Side.LEFT].reading().grip == pytest.approx(0.3 * 12.0, rel=0.05)


# cloth


def test_held_cloth_slips_while_the_pads_hold_too_little(opened: Any) -> None:
    bench = opened(BLIND).ready()
    bench.ports.attendant.lay_garment()
    grasped(bench)
    bench.hold(0.5)
    assert bench.truth().held[Side.LEFT]
    inject(bench, K.SLIP, side=Side.LEFT, size=0.001)
    bench.hold(0.5)
    assert not bench.truth().held[Side.LEFT]
    assert vertices(bench)[:, 2].max() < 0.11


def test_a_shoved_garment_keeps_its_shape_and_lies_elsewhere(opened: Any) -> None:
    bench = opened()
    bench.ports.attendant.lay_garment()
    before = vertices(bench)
    inject(bench, K.GARMENT_SHOVED, size=0.08, turn=np.deg2rad(10.0), seed=3)
    bench.wait(0.3)
    after = vertices(bench)
    shift = after[:, :2].mean(axis=0) - before[:, :2].mean(axis=0)
    assert np.linalg.norm(shift) == pytest.approx(0.08, abs=2e-3)
    a, b = (x[:, :2] - x[:, :2].mean(axis=0) for x in (before, after))
    turn = np.arctan2(np.sum(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]), np.sum(a * b))
    assert abs(turn) == pytest.approx(np.deg2rad(10.0), abs=5e-3)
    c, s = np.cos(turn), np.sin(turn)
    assert np.abs(a @ np.array([[c, s], [-s, c]]) - b).max() < 2e-3
    assert after[:, 2].max() < 0.01


def test_directions_of_shoves_are_drawn_and_stay_near_the_poses(opened: Any) -> None:
    places = []
    for seed in range(3):
        bench = opened()
        bench.ports.attendant.lay_garment()
        before = vertices(bench)[:, :2].mean(axis=0)
        inject(bench, K.GARMENT_SHOVED, size=0.03, seed=seed)
        bench.wait(0.1)
        places.append(vertices(bench)[:, :2].mean(axis=0) - before)
    assert len({tuple(np.round(place, 3)) for place in places}) == 3


def test_a_held_garment_is_shoved_only_after_its_release(opened: Any) -> None:
    bench = opened(BLIND).ready()
    bench.ports.attendant.lay_garment()
    grasped(bench)
    inject(bench, K.GARMENT_SHOVED, size=0.05)
    bench.hold(0.3)
    assert bench.truth().held[Side.LEFT] and not bench.truth().faults
    bench.ports.grippers[Side.LEFT].command(0.03, 12.0)
    bench.hold(1.0)
    assert [fault.kind for _, fault in bench.truth().faults] == [K.GARMENT_SHOVED]


def test_a_garment_is_taken_away_and_laid_back_elsewhere(opened: Any) -> None:
    bench = opened().ready()
    bench.ports.attendant.lay_garment()
    before = vertices(bench)
    inject(bench, K.GARMENT_TAKEN, size=0.05, duration=2.0)
    bench.wait(0.1)
    assert bench.truth().garment is None
    bench.pinch(Side.LEFT, before[0, :2])
    assert not bench.truth().held[Side.LEFT], "there is nothing to grasp"
    bench.wait(1.0)
    shift = vertices(bench)[:, :2].mean(axis=0) - before[:, :2].mean(axis=0)
    assert np.linalg.norm(shift) == pytest.approx(0.05, abs=3e-3)


def test_a_garment_that_is_away_survives_a_checkpoint(opened: Any) -> None:
    bench = opened()
    bench.ports.attendant.lay_garment()
    before = vertices(bench)
    inject(bench, K.GARMENT_TAKEN)
    bench.wait(0.1)
    saved = bench.cell.checkpoint.save()
    again = opened()
    again.cell.checkpoint.restore(saved)
    np.testing.assert_allclose(vertices(again), before, atol=2e-3)


@pytest.mark.parametrize("duration", [1.0, None])
def test_cloth_that_is_caught_on_a_finger_follows_the_open_hand_until_it_comes_off(
    opened: Any, duration: float | None
) -> None:
    bench = opened(BLIND).ready()
    bench.ports.attendant.lay_garment()
    grasped(bench)
    inject(bench, K.CAUGHT_ON_FINGER, side=Side.LEFT, duration=duration)
    gripper = bench.ports.grippers[Side.LEFT]
    gripper.command(0.03, 12.0)
    bench.hold(0.8)
    assert gripper.state().opening == pytest.approx(0.03, abs=1e-3)
    assert bench.truth().held[Side.LEFT] and vertices(bench)[:, 2].max() > 0.09
    if duration is None:
        bench.hold(1.0)
        assert bench.truth().held[Side.LEFT]
        gripper.command(0.0, 12.0)
        bench.hold(0.8)
        pads = bench.ports.tactile[Side.LEFT].reading().cells.sum(axis=(1, 2))
        assert gripper.state().opening > 1e-3 and pads.min() > 4.0, "the closed hand feels the lightest cloth"
        gripper.command(0.03, 12.0)
    bench.hold(1.2)
    assert not bench.truth().held[Side.LEFT] and vertices(bench)[:, 2].max() < 0.07


# what lies before the camera


@pytest.mark.parametrize(("kind", "higher"), [(K.HAND_IN_VIEW, 0.05), (K.SECOND_GARMENT, 0.002)])
def test_an_object_before_the_camera_comes_and_goes(opened: Any, kind: FaultKind, higher: float) -> None:
    bench = opened(SEEING)
    bench.ports.attendant.lay_garment()
    before = bench.ports.camera.capture()
    inject(bench, kind, duration=1.0)
    during = bench.ports.camera.capture()
    nearer = before.depth - during.depth > higher
    assert 0.01 < nearer.mean() < 0.35
    assert np.abs(during.rgb[nearer].astype(int) - before.rgb[nearer].astype(int)).sum(axis=1).mean() > 30
    bench.wait(1.0)
    np.testing.assert_array_equal(bench.ports.camera.capture().depth, before.depth)


def test_a_late_picture_shows_the_past(opened: Any) -> None:
    bench = opened(SEEING)
    inject(bench, K.CAMERA_LATE, size=2.0, duration=5.0)
    frame = bench.ports.camera.capture()
    assert bench.ports.clock.now() - frame.stamp == pytest.approx(2.0)
