"""The emulator over real ROS: messages and commands as for any program of a Baxter.

Times are cell times from /clock. Limits in wall time only ensure that a test ends.
"""

from __future__ import annotations

import math
import threading
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from served import PATIENCE, Program, Serve, wait

from foldcell.robots.baxter.names import ARM_JOINTS, JOINT_NAMES
from foldcell.robots.baxter.ros import topics
from foldcell.robots.baxter.ros.electric_gripper import HARDWARE_ID
from foldcell.robots.errors import DriverError, FailureKind
from foldcell.robots.ports import Array, CameraFrame, Intrinsics, Ports, Side, TactileReading, arm_slice
from foldcell.robots.ros.driver import CameraTopics, Network
from tests.fakes import FakeCell

# a warning of rospy
pytestmark = [pytest.mark.usefixtures("rosmaster"), pytest.mark.filterwarnings("ignore:notifyAll")]


def names(side: Side) -> list[str]:
    return [f"{side}_{joint}" for joint in ARM_JOINTS]


def vector(message: Any, field: str = "position") -> Array:
    """One field of a JointState for the arms' joints (14,), by name."""
    values = dict(zip(message.name, getattr(message, field), strict=True))
    return np.array([values[name] for name in JOINT_NAMES])


# published topics --------------------------------------------------------------------------------------


def test_joint_states_and_simulated_time_are_published(serve: Serve, cell: FakeCell) -> None:
    program = serve(cell.ports())
    assert program.param("/use_sim_time") is True and program.param("/rethink/software_version") == "1.2.0"
    message = program.joints.newest
    assert message.name[:4] == ["head_nod", "head_pan", "left_e0", "left_e1"]
    assert message.name[2:] == [*sorted(JOINT_NAMES), "torso_t0"]
    np.testing.assert_array_equal(vector(message), cell.q)
    program.let(0.1)
    stamps = [m.header.stamp.to_sec() for m in program.joints.all]
    assert np.diff(stamps).min() > 0.009
    program.end()
    assert program.param("/use_sim_time") is None


def test_the_rate_of_the_joint_states_can_be_set(serve: Serve, cell: FakeCell) -> None:
    program = serve(cell.ports())
    rate = program.publisher(topics.JOINT_STATE_RATE, program.m.uint16)
    rate.publish(program.m.uint16(20))
    program.let(0.2)
    begun = len(program.joints.all)
    program.let(1.0)
    assert 18 <= len(program.joints.all) - begun <= 22
    rate.publish(program.m.uint16(0))
    wait(lambda: program.told, "told that this is no rate")


def test_orders_to_motors_that_are_off_are_reported(serve: Serve, cell: FakeCell) -> None:
    program = serve(cell.ports())
    program.let(0.1)
    to = program.publisher(topics.JOINT_COMMAND.format(Side.LEFT), program.m.joint_command)
    head = program.publisher(topics.HEAD_COMMAND, program.m.head_pan_command)
    to.publish(shuffled(program, Side.LEFT, cell.q))
    head.publish(program.m.head_pan_command(0.1, 1.0, 1))
    wait(lambda: len(program.told) == 2, "told")
    assert all("motors are off" in told for told in program.told) and cell.commands == []


def test_the_cell_clock_is_published_after_the_states_of_its_time(serve: Serve, cell: FakeCell) -> None:
    program = serve(cell.ports())
    program.let(0.2)
    times = [m.clock.to_sec() for m in program.clock.all]
    assert np.diff(times).min() > 0.009
    np.testing.assert_allclose(np.array(times) / 0.01, np.round(np.array(times) / 0.01), atol=1e-6)
    program.end()
    assert program.clock.all[-1].clock.to_sec() <= cell.now


def test_tactile_readings_are_published(serve: Serve, cell: FakeCell) -> None:
    ports = cell.ports()
    cells = np.arange(24.0).reshape(2, 4, 3) / 8

    class Pad:
        side = Side.RIGHT

        def reading(self) -> TactileReading:
            return TactileReading(0.25, Side.RIGHT, cells, np.array([0.5, 1.5]))

    program = serve(replace(ports, tactile={**ports.tactile, Side.RIGHT: Pad()}))
    message = program.hear(topics.TACTILE.format(Side.RIGHT), program.m.tactile_state).newest
    channels = {c.name: list(c.values) for c in message.sensors}
    assert channels == {"pad_0": list(cells[0].ravel()), "pad_1": list(cells[1].ravel()), "tips": [0.5, 1.5]}
    assert message.header.stamp.to_sec() == 0.25


def test_gripper_states_are_published_at_20_hz_and_after_each_task(serve: Serve, cell: FakeCell) -> None:
    program, side = serve(cell.ports()), Side.LEFT
    heard = program.hear(topics.GRIPPER_STATE.format(side), program.m.end_effector_state)
    wait(lambda: heard.all, "a first state")
    begin, before = program.now(), len(heard.all)
    program.let(1.0)
    count = (len(heard.all) - before) / (program.now() - begin)
    assert 18.0 < count < 22.0
    assert np.diff([m.timestamp.to_sec() for m in heard.all]).min() > 0.05 - 1e-6

    def closed() -> float:
        cell.openings[side] = 0.0
        cell.now -= 0.8  # as after restoring a checkpoint
        return cell.now

    done_at = program.emulator.perform(closed).result(PATIENCE)
    wait(lambda: heard.newest.position == 0.0, "it is told")
    first = next(m for m in heard.all if m.position == 0.0)
    assert first.timestamp.to_sec() < done_at + 0.011


# arms --------------------------------------------------------------------------------------------------

AMPLITUDE = np.array([0.02, 0.04, 0.05, -0.05, 0.08, 0.06, 0.10, -0.02, 0.04, -0.05, -0.05, 0.08, 0.06, -0.10])
OMEGA = 3.0  # [rad/s]


def wave(t: float) -> Array:
    return AMPLITUDE * (1.0 - math.cos(OMEGA * t))


def shuffled(program: Program, side: Side, q: Array, mode: int = 4) -> Any:
    order = [4, 2, 6, 0, 1, 5, 3]
    part = q[arm_slice(side, 14)]
    return program.m.joint_command(mode, [part[k] for k in order], [names(side)[k] for k in order])


def commanders(program: Program) -> dict[Side, Any]:
    return {side: program.publisher(topics.JOINT_COMMAND.format(side), program.m.joint_command) for side in Side}


def test_arms_follow_commands_and_hold_after_the_last_one(serve: Serve, simulated: Ports) -> None:
    program = serve(simulated)
    program.enable()
    to = commanders(program)
    q0, begin = vector(program.joints.newest), program.now()
    sent, t, until = q0, begin, begin + 1.9
    while t < until:
        sent = q0 + wave(t - begin)
        for side in Side:
            to[side].publish(shuffled(program, side, sent))
        wait(lambda last=t: program.now() > last, "the next tick")
        t = program.now()
    silent = program.now()
    program.let(0.8)

    moving = [m for m in program.joints.all if begin + 0.1 < m.header.stamp.to_sec() < silent]
    error = [np.abs(vector(m) - q0 - wave(m.header.stamp.to_sec() - begin)).max() for m in moving]
    late = OMEGA * np.abs(AMPLITUDE).max() * 0.04
    assert len(moving) > 50 and max(error) < 0.007 + late  # the simulated arms' error, and a few ticks
    assert max(np.abs(vector(m) - q0).max() for m in moving) > 0.18

    held = [m for m in program.joints.all if m.header.stamp.to_sec() > silent + 0.3]
    assert len(held) > 30
    assert max(np.abs(vector(m, "velocity")).max() for m in held) < 0.02
    assert max(np.abs(vector(m) - sent).max() for m in held) < 0.01


def test_an_arm_without_commands_does_not_move(serve: Serve, simulated: Ports) -> None:
    program = serve(simulated)
    program.enable()
    to = program.publisher(topics.JOINT_COMMAND.format(Side.RIGHT), program.m.joint_command)
    q0 = vector(program.joints.newest)
    goal = q0 + 0.05 * (np.arange(14) == 13)
    right = arm_slice(Side.RIGHT, 14)
    command = program.m.joint_command(1, list(goal[right]), names(Side.RIGHT))
    program.insist(to, command, lambda: abs(vector(program.joints.newest)[13] - goal[13]) < 0.01, "the goal")
    assert max(np.abs(vector(m) - q0)[arm_slice(Side.LEFT, 14)].max() for m in program.joints.all) < 0.01


def test_a_clock_that_is_set_back_neither_moves_an_arm_nor_holds_messages_up(serve: Serve, cell: FakeCell) -> None:
    """The arm goes on from where it is, although its last command is of a time that the clock has not yet reached
    again."""
    cell.now = 10.0
    program = serve(cell.ports(), network=Network(delay=0.02))
    program.enable()
    to = program.publisher(topics.JOINT_COMMAND.format(Side.LEFT), program.m.joint_command)
    begin = program.now() + 0.2

    def set_back() -> None:
        cell.now -= 0.5

    cell.at(begin, set_back)
    goal, ticks = cell.q + 0.1 * (np.arange(14) == 0), len(program.clock.all)
    while cell.q[0] < goal[0] - 1e-6 and len(program.clock.all) < ticks + 200:
        to.publish(shuffled(program, Side.LEFT, np.minimum(cell.q + 0.002, goal), mode=1))
        heard = len(program.clock.all)
        wait(lambda heard=heard: len(program.clock.all) > heard, "the next tick")
    assert min(m.clock.to_sec() for m in program.clock.all[ticks:]) < begin - 0.4, "the clock was set back"
    steps = np.abs(np.diff([q for _, q in cell.commands], axis=0))
    assert steps.max() < 0.01
    np.testing.assert_allclose(cell.q, goal, atol=0.002)
    times = np.array([t for t, _ in cell.commands])
    (back,) = np.flatnonzero(np.diff(times) < 0.0)
    assert steps[back + 1 :][times[back + 2 :] < begin - 0.2].max() > 0.0, (
        "it moves before the clock has caught up"
    )


def test_malformed_commands_are_ignored_and_reported_once(serve: Serve, cell: FakeCell) -> None:
    program = serve(cell.ports())
    program.enable()
    to = program.publisher(topics.JOINT_COMMAND.format(Side.LEFT), program.m.joint_command)
    head = program.publisher(topics.HEAD_COMMAND, program.m.head_pan_command)
    limit = program.publisher(topics.JOINT_COMMAND_TIMEOUT.format(Side.LEFT), program.m.float64)
    for _ in range(3):
        for wrong in (
            program.m.joint_command(4, [0.0] * 7, names(Side.RIGHT)),
            program.m.joint_command(4, [0.0] * 6, names(Side.LEFT)),
            program.m.joint_command(4, [math.nan] * 7, names(Side.LEFT)),
        ):
            to.publish(wrong)
            program.let(0.03)
        head.publish(program.m.head_pan_command(math.nan, 1.0, 1))
        limit.publish(program.m.float64(math.nan))
    wait(lambda: len(program.told) > 4, "told")
    program.let(0.1)
    assert cell.commands == []
    assert len(program.told) == 5 and len(set(program.told)) == 5
    before = cell.q.copy()
    to.publish(shuffled(program, Side.LEFT, cell.q))
    wait(lambda: cell.commands, "a right one is obeyed")
    np.testing.assert_array_equal(cell.q, before)


# motors and stop ---------------------------------------------------------------------------------------


def test_a_stop_is_immediate_while_the_loop_is_busy(serve: Serve, cell: FakeCell) -> None:
    program = serve(cell.ports())
    program.enable()
    stop = program.publisher(topics.STOP, program.m.empty)
    busy, go_on = threading.Event(), threading.Event()

    def work() -> str:
        busy.set()
        assert go_on.wait(PATIENCE)
        return cell.stop_reason

    future = program.emulator.perform(work)
    assert busy.wait(PATIENCE)
    try:
        stop.publish(program.m.empty())
        wait(lambda: cell.stop_reason, "stopped")
    finally:
        go_on.set()
    assert topics.STOP in future.result(PATIENCE)
    wait(lambda: program.robot.newest.stopped, "it says so")
    state = program.robot.newest
    assert not state.enabled and not state.ready
    assert (state.estop_button, state.estop_source) == (state.ESTOP_BUTTON_UNKNOWN, state.ESTOP_SOURCE_UNKNOWN)
    reset = program.publisher(topics.RESET, program.m.empty)
    program.insist(reset, program.m.empty(), lambda: not program.robot.newest.stopped, "reset")
    assert not program.robot.newest.enabled
    assert program.robot.newest.estop_button == state.ESTOP_BUTTON_UNPRESSED


def test_a_reset_is_refused_while_the_button_is_pressed(serve: Serve, cell: FakeCell) -> None:
    program = serve(cell.ports())
    reset = program.publisher(topics.RESET, program.m.empty)
    on = program.publisher(topics.ENABLE, program.m.bool)
    program.emulator.press_button()
    wait(lambda: program.robot.newest.stopped, "stopped")
    for _ in range(10):
        reset.publish(program.m.empty())
        on.publish(program.m.bool(True))
        program.let(0.03)
    state = program.robot.newest
    assert state.stopped and not state.enabled
    assert (state.estop_button, state.estop_source) == (state.ESTOP_BUTTON_PRESSED, state.ESTOP_SOURCE_USER)
    program.emulator.release_button()
    wait(lambda: program.robot.newest.estop_button == state.ESTOP_BUTTON_RELEASED, "released")
    assert program.robot.newest.stopped
    program.insist(reset, program.m.empty(), lambda: not program.robot.newest.stopped, "reset")
    program.enable()


# hands, head, camera -----------------------------------------------------------------------------------


def test_the_gripper_is_calibrated_configured_and_closes(serve: Serve, simulated: Ports) -> None:
    program, side = serve(simulated), Side.LEFT
    heard = program.hear(topics.GRIPPER_STATE.format(side), program.m.end_effector_state)
    to = program.publisher(topics.GRIPPER_COMMAND.format(side), program.m.end_effector_command)
    assert heard.newest.id == HARDWARE_ID and heard.newest.calibrated == 0
    sequence = 0

    def say(command: str, args: str = "") -> Any:
        nonlocal sequence
        sequence += 1
        message = program.m.end_effector_command(HARDWARE_ID, command, args, "test", sequence)

        def echoed() -> bool:
            return (heard.newest.command_sender, heard.newest.command_sequence) == ("test", sequence)

        program.insist(to, message, echoed, f"{command} handled")
        return heard.newest

    assert say("go", '{"position": 30.0}').error == 1
    assert say("calibrate").error == 0
    wait(lambda: heard.newest.calibrated == 1 and not heard.newest.moving, "calibrated")
    assert heard.newest.position == pytest.approx(100.0, abs=2.0)
    say("configure", '{"holding_force": 40.0}')
    assert say("go", '{"position": 30.0}').error == 0
    wait(lambda: not heard.newest.moving, "there")
    assert heard.newest.position == pytest.approx(30.0, abs=2.0) and heard.newest.ready == 1
    assert heard.newest.force == pytest.approx(0.0, abs=1.0)
    opening = program.emulator.perform(lambda: simulated.grippers[side].state().opening).result(PATIENCE)
    assert opening == pytest.approx(0.3 * simulated.grippers[side].max_opening, abs=1e-3)


def test_the_head_turns_to_the_commanded_angle(serve: Serve, simulated: Ports) -> None:
    program = serve(simulated)
    heard = program.hear(topics.HEAD_STATE, program.m.head_state)
    program.enable()
    to = program.publisher(topics.HEAD_COMMAND, program.m.head_pan_command)
    disabled = program.m.head_pan_command(-0.2, 0.5, program.m.head_pan_command.REQUEST_PAN_DISABLE)
    to.publish(disabled)
    program.let(0.2)
    assert abs(heard.newest.pan) < 0.005
    turn = program.m.head_pan_command(0.2, 0.5, program.m.head_pan_command.REQUEST_PAN_ENABLE)
    program.insist(to, turn, lambda: abs(heard.newest.pan - 0.2) < 0.005, "turned")
    assert any(m.isTurning for m in heard.all)
    assert program.joints.newest.position[1] == pytest.approx(0.2, abs=0.006)


class Shutter:
    """A camera whose pictures differ, with holes in their depth."""

    def __init__(self, cell: FakeCell) -> None:
        self._cell, self.frames = cell, []
        self.silent = False

    def glimpse(self) -> CameraFrame:
        if self.silent:
            raise DriverError(FailureKind.CAMERA_FAULT, "silent")
        n = len(self.frames)
        rgb = np.arange(60, dtype=np.uint8).reshape(4, 5, 3) + np.uint8(n)
        depth = np.linspace(0.5, 1.5, 20, dtype=np.float32).reshape(4, 5)
        depth[1, n % 5] = np.nan
        self.frames.append(CameraFrame(self._cell.now, n, rgb, depth, Intrinsics(5, 4, 6.0, 7.0, 2.5, 1.5)))
        return self.frames[-1]


def test_pictures_are_taken_only_for_subscribers(serve: Serve, cell: FakeCell) -> None:
    shutter, named = Shutter(cell), CameraTopics("/eye/rgb", "/eye/depth", "/eye/info")
    program = serve(replace(cell.ports(), camera=shutter), camera=named)
    depth = program.hear(named.depth, program.m.image)
    info = program.hear(named.info, program.m.camera_info)
    program.let(0.5)
    assert shutter.frames == []
    rgb = program.hear(named.rgb, program.m.image)
    wait(lambda: len(rgb.all) > 2 and len(depth.all) > 2 and len(info.all) > 2, "pictures")
    taken = np.array([frame.stamp for frame in shutter.frames])
    assert np.diff(taken).min() > 0.2 - 1e-6
    frames = {round(frame.stamp, 6): frame for frame in shutter.frames}
    for message in rgb.all[:3]:
        frame = frames[round(message.header.stamp.to_sec(), 6)]
        assert (message.encoding, message.height, message.width, message.step) == ("rgb8", 4, 5, 15)
        assert message.data == frame.rgb.tobytes()
    for message in depth.all[:3]:
        frame = frames[round(message.header.stamp.to_sec(), 6)]
        assert (message.encoding, message.height, message.width, message.step) == ("16UC1", 4, 5, 10)
        millimetres = np.frombuffer(message.data, "<u2").reshape(4, 5)
        np.testing.assert_array_equal(millimetres == 0, np.isnan(frame.depth))
        np.testing.assert_allclose(millimetres, np.nan_to_num(1e3 * frame.depth), atol=0.5)
    stamps = {m.header.stamp for m in rgb.all}
    assert stamps & {m.header.stamp for m in depth.all} & {m.header.stamp for m in info.all}
    assert list(info.newest.K) == [6.0, 0.0, 2.5, 0.0, 7.0, 1.5, 0.0, 0.0, 1.0]
    assert list(info.newest.P) == [6.0, 0.0, 2.5, 0.0, 0.0, 7.0, 1.5, 0.0, 0.0, 0.0, 1.0, 0.0]

    shutter.silent = True
    program.let(0.3)
    count = len(shutter.frames)
    program.let(0.5)
    assert len(shutter.frames) == count and program.error is None
    shutter.silent = False
    wait(lambda: len(shutter.frames) > count, "the camera answers again")

    program.deaf()
    program.let(0.3)  # unsubscribing takes a while
    count = len(shutter.frames)
    program.let(1.0)
    assert len(shutter.frames) <= count + 1


# tasks on the loop's thread ----------------------------------------------------------------------------


def test_tasks_run_between_ticks_and_complete_after_publishing(serve: Serve, cell: FakeCell) -> None:
    program = serve(cell.ports())
    goal = cell.q + 0.4
    done_at: list[float] = []
    told_at: list[float] = []

    def work() -> str:
        cell.q = goal
        cell.now += 1000.0  # an attendant at work: cell time passes, and the loop does not catch up with wall time
        done_at.append(cell.now)
        return threading.current_thread().name

    future = program.emulator.perform(work)
    future.add_done_callback(lambda _: told_at.append(cell.now))
    assert future.result(PATIENCE) == program._thread.name
    wait(lambda: told_at, "told")
    assert told_at[0] - done_at[0] == pytest.approx(0.05, abs=0.011)
    wait(lambda: np.array_equal(vector(program.joints.newest), goal), "the topics know")
    failed = program.emulator.perform(lambda: 1 // 0)
    with pytest.raises(ZeroDivisionError):
        failed.result(PATIENCE)
    program.let(0.05)  # the loop continues
    program.end()
    assert program.emulator.perform(lambda: None).cancelled()


def test_commands_that_arrive_while_the_loop_is_busy_expire(serve: Serve, cell: FakeCell) -> None:
    program = serve(cell.ports())
    program.enable()
    to = program.publisher(topics.JOINT_COMMAND.format(Side.LEFT), program.m.joint_command)
    busy, go_on = threading.Event(), threading.Event()

    def work() -> None:
        busy.set()
        assert go_on.wait(PATIENCE)
        cell.now += 3.0

    future = program.emulator.perform(work)
    assert busy.wait(PATIENCE)
    to.publish(shuffled(program, Side.LEFT, cell.q + 0.01))
    wait(lambda: program.emulator._heard, "heard")
    go_on.set()
    future.result(PATIENCE)
    program.let(0.1)
    assert cell.commands == []
    program.insist(to, shuffled(program, Side.LEFT, cell.q), lambda: cell.commands, "a new one is obeyed")
