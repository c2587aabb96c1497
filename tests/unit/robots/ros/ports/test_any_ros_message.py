"""Any message of the robot, of its pads or of its camera: it is read, ignored or reported, and a stop stays."""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import Any

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from wire import Wire

from foldcell.robots.baxter.names import JOINT_NAMES
from foldcell.robots.baxter.ros.messages import load_messages as m
from foldcell.robots.baxter.ros.ports.arms import RosArms
from foldcell.robots.baxter.ros.ports.camera import read_colour, read_depth, read_intrinsics
from foldcell.robots.baxter.ros.ports.gripper import RosGripper
from foldcell.robots.baxter.ros.ports.stop import RosStop
from foldcell.robots.baxter.ros.ports.tactile import RosTactile
from foldcell.robots.errors import DriverError
from foldcell.robots.model import JointLimits
from foldcell.robots.ports import Side
from tests.optional_parts import ROS

pytestmark = ROS.required

ROWS = 4
LIMITS = JointLimits(np.full(14, -1.5), np.full(14, 1.5), np.full(14, 2.0), np.full(14, 6.0), np.full(14, 60.0))
NAMES = ["head_nod", "head_pan", *JOINT_NAMES]
ODD = st.sampled_from([math.nan, math.inf, -math.inf, 1e300, -0.0])
VALUES = st.lists(st.floats(-1.0, 1.0) | ODD, max_size=20)
STAMPS = st.sampled_from([0.0, 50.0, 50.01, 49.99, 4e9])
FLAGS = st.integers(0, 255)


def usually(good: Any, odd: st.SearchStrategy[Any]) -> st.SearchStrategy[Any]:
    return st.sampled_from(5 * [good] + [None]).flatmap(lambda chosen: odd if chosen is None else st.just(chosen))


@st.composite
def joint_states(draw: st.DrawFn) -> Any:
    names = draw(usually(NAMES, st.lists(st.sampled_from([*NAMES, "left_gripper", "\x00"]), max_size=20)))
    fields = {field: draw(usually([0.1] * len(names), VALUES)) for field in ("position", "velocity", "effort")}
    return stamped(m().joint_state(name=list(names), **fields), draw(STAMPS))


@st.composite
def pads(draw: st.DrawFn) -> Any:
    good = {"pad_0": [0.5] * 12, "pad_1": [0.5] * 12, "tips": [0.1, 0.2]}
    said = [(draw(usually(name, st.text(max_size=3))), draw(usually(v, VALUES))) for name, v in good.items()]
    sensors = [m().tactile_channel(name, values) for name, values in draw(usually(said, st.just(said[:1])))]
    return stamped(m().tactile_state(sensors=sensors), draw(STAMPS))


GRIPPER_STATES = st.fixed_dictionaries({
    "calibrated": usually(1, FLAGS), "error": usually(0, FLAGS), "ready": usually(1, FLAGS),
    "moving": usually(0, FLAGS), "position": usually(50.0, st.floats() | ODD), "force": usually(0.0, ODD),
    "state": st.text(max_size=3), "command_sequence": st.integers(0, 2**32 - 1),
})  # fmt: skip
ROBOT_STATES = st.fixed_dictionaries({
    "enabled": usually(True, st.booleans()), "stopped": usually(False, st.booleans()), "error": st.booleans(),
    "estop_button": FLAGS, "estop_source": FLAGS,
})  # fmt: skip
SIZES = usually(4, st.integers(0, 6))


@st.composite
def images(draw: st.DrawFn, encodings: tuple[str, ...]) -> Any:
    encoding = draw(usually(encodings[0], st.sampled_from((*encodings, "mono8", "", "\x00rgb8"))))
    height, width, bytes_of = draw(SIZES), draw(SIZES), {"32FC1": 4, "16UC1": 2}.get(encoding, 3)
    step = draw(usually(width * bytes_of, st.integers(0, 40)))
    return m().image(
        height=height, width=width, encoding=encoding, is_bigendian=draw(st.integers(0, 1)), step=step,
        data=draw(st.binary(min_size=height * step, max_size=height * step) | st.binary(max_size=40)),
    )  # fmt: skip


@st.composite
def infos(draw: st.DrawFn) -> Any:
    good = [525.0, 0.0, 2.0, 0.0, 525.0, 2.0, 0.0, 0.0, 1.0]
    return m().camera_info(height=draw(SIZES), width=draw(SIZES), K=[draw(usually(v, ODD)) for v in good])


def stamped(message: Any, stamp: float) -> Any:
    message.header.stamp = m().time.from_sec(stamp)
    return message


@contextmanager
def a_stop(wire: Any, clock: Any) -> Iterator[RosStop]:
    stop = RosStop(wire, clock)
    try:
        yield stop
    finally:
        stop.close()


@settings(max_examples=120)
@given(st.lists(joint_states() | ROBOT_STATES, min_size=1, max_size=8))
def test_arms_and_stop_hear_anything_and_command_only_what_is_known(heard: list[Any]) -> None:
    robot, joints, clock = Wire(), Wire(), Wire()
    with a_stop(robot, clock) as stop:
        arms = RosArms(joints, clock, stop, LIMITS)  # type: ignore[arg-type]
        told_to_stop = False
        for message in heard:
            clock.time += 0.01
            if isinstance(message, dict):
                robot.heard(m().assembly_state(**message))
                told_to_stop = told_to_stop or message["stopped"]
            else:
                joints.heard(message)
            state, sent = arms.state(), joints.count
            assert stop.state().stopped == told_to_stop, "only a reset ends a stop"
            assert (
                state.stamp == -math.inf or np.isfinite([*state.q, *state.qd, *state.effort, state.head_pan]).all()
            )
            with suppress(DriverError):
                setpoint = arms.command(np.zeros(14), np.zeros(14))
                assert not told_to_stop and np.isfinite(setpoint.q).all() and joints.count == sent + len(Side)


@settings(max_examples=100)
@given(st.lists(pads(), min_size=1, max_size=5))
def test_a_reading_of_the_pads_is_whole_or_unknown(heard: list[Any]) -> None:
    wire, clock = Wire(), Wire()
    tactile = RosTactile(wire, clock, Side.LEFT, ROWS)  # type: ignore[arg-type]
    shapes = set()
    for message in heard:
        clock.time += 0.01
        wire.heard(message)
        reading = tactile.reading()
        if reading.stamp > -math.inf:
            shapes.add(reading.cells.shape)
            assert np.isfinite([*reading.cells.flat, *reading.tip, reading.grip]).all()
    assert len(shapes) <= 1


@settings(max_examples=100)
@given(st.lists(GRIPPER_STATES, min_size=1, max_size=8))
def test_a_gripper_answers_or_reports_a_fault_after_any_state(heard: list[dict[str, Any]]) -> None:
    wire, clock = Wire(), Wire()
    gripper = RosGripper(wire, clock, Side.LEFT)  # type: ignore[arg-type]
    gripper.calibrate()
    for number, message in enumerate(heard):
        clock.time += 0.6
        order = wire.told[-1]
        wire.heard(m().end_effector_state(**message, command_sender=order.sender))
        with suppress(DriverError):
            gripper.command(0.01 * (number % 3), 10.0)
        state = gripper.state()
        assert state.stamp == -math.inf or (math.isfinite(state.opening) and math.isfinite(state.force))


@settings(max_examples=200)
@given(images(("rgb8", "bgr8")), images(("32FC1", "16UC1")), infos())
def test_a_picture_is_whole_or_refused(colour: Any, depth: Any, info: Any) -> None:
    size = colour.height, colour.width
    with suppress(DriverError):
        rgb = read_colour(colour)
        assert rgb.shape == (*size, 3) and rgb.size, "a picture without pixels is none"
    with suppress(DriverError):
        seen = read_depth(depth, colour)
        assert seen.shape == size and not (seen <= 0.0).any() and not np.isinf(seen).any()
    with suppress(DriverError):
        lens = read_intrinsics(info, colour)
        assert (lens.height, lens.width) == size
        assert np.isfinite([lens.fx, lens.fy, lens.cx, lens.cy]).all() and min(lens.fx, lens.fy) > 0.0
