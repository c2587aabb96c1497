"""The loop that serves a cell's ports as a Baxter. Each tick advances the cell's time, executes the commands from
the topics, and publishes the state of the ports.

The ports belong to one thread. Messages therefore wait for the next tick. Only a stop is executed immediately.
"""

from __future__ import annotations

import contextlib
import math
import time
from collections.abc import Callable
from concurrent.futures import Future
from functools import partial
from threading import Condition, Event
from typing import Any, TypeVar

import numpy as np

from foldcell.robots.baxter.emulator import message_conversion
from foldcell.robots.baxter.emulator.grippers import ElectricGripper
from foldcell.robots.baxter.emulator.initial_state import USED, InitialState
from foldcell.robots.baxter.emulator.limbs import TICK, Limb
from foldcell.robots.baxter.emulator.line import Line, by_robots_clock
from foldcell.robots.baxter.emulator.loop_tasks import LoopTasks
from foldcell.robots.baxter.emulator.motors import Motors
from foldcell.robots.baxter.ros import topics
from foldcell.robots.baxter.ros.messages import load_messages
from foldcell.robots.errors import DriverError
from foldcell.robots.ports import Gripper, Ports, Side, arm_slice
from foldcell.robots.ros.driver import CameraTopics, Network
from foldcell.robots.ros.node import Node

USE_SIM_TIME = "/use_sim_time"
VERSION = "/rethink/software_version"
EMULATED = "1.2.0"

GRIPPER_PERIOD = 0.05
"""Period of the grippers' states [s]. Baxter publishes them at 20 Hz and everything else at 100 Hz."""
CALIBRATION_S = 5.0
"""Longest time that a gripper takes to calibrate [s]."""
MAX_LAG = 2 * TICK
"""Largest lag behind the wall clock [s]. If the lag is larger, the loop does not try to catch up."""
LINGER_S = 0.5
"""Commands that arrive so long after the motors went off were under way [s]. Later ones are a program's error."""
TURNING = 0.01
"""Smallest speed at which the head counts as turning [rad/s]."""
QUEUE = 100
"""Queue length of the topics on which no message may be lost."""
ROUNDING = 1e-6  # tolerance of comparisons with a tick [ticks]

T = TypeVar("T")


class Emulator:
    """Serves a cell's ports as a Baxter on ROS, with the cell's clock on /clock.

    patience: wall time for which the loop waits for the next command after a command [s], so that a program on a
    busy machine is not late. A real robot does not wait. tell: called once for each kind of order that is not
    executed. past: the initial state, as an earlier program left it. Before the topics open, the ports' time
    advances until they have reached this state. network: delays and loses messages in both directions, except
    those of the clock. `perform`, `press_button` and `release_button` may be called from any thread.
    """

    def __init__(
        self,
        ports: Ports,
        node: Node,
        camera: CameraTopics = CameraTopics(),  # noqa: B008  # frozen
        tell: Callable[[str], None] = lambda _: None,
        patience: float = 0.0,
        past: InitialState = USED,
        network: Network = Network(),  # noqa: B008  # frozen
    ) -> None:
        self._ports, self._node, self._camera, self._tell = ports, node, camera, tell
        self._patience, self._past, self._network = patience, past, network
        self._commanded = dict.fromkeys(Side, (-math.inf, -math.inf))
        """Arrival of each arm's latest command: the emulator's time and wall time [s]."""
        self._command_came = Condition()
        self._messages = load_messages()
        self._motors = Motors(ports.arms, ports.stop)
        self._limbs = {side: Limb(side, past) for side in Side}
        self._grippers = {side: ElectricGripper(port, past) for side, port in ports.grippers.items()}
        self._tasks = LoopTasks()
        self._heard, self._published = Line(network), Line(network)
        """Messages on their way to the robot, and those from it."""
        self._enabled_at = -math.inf
        """The emulator's time at which the motors were on for the last time [s]."""
        self._told: set[str] = set()
        self._publishers: dict[str, Any] = {}
        self._now = ports.clock.now()
        """Time of the emulator: the cell's time, but it goes on when the cell's clock is set back [s]."""
        self._set_back = 0.0
        """How far the cell's clock was set back so far [s]."""
        self._pan = self._joints_at = math.nan
        self._next_picture = self._next_grippers = self._next_joints = -math.inf
        self._state_rate = past.state_rate
        """Rate of the joint states [Hz]."""
        self._origin: tuple[float, float] | None = None
        node.set_parameter(USE_SIM_TIME, True)  # before any topic announces the robot
        node.set_parameter(VERSION, EMULATED)

    def run(self, until: Event) -> None:
        """Serve in this thread until `until` is set, then end the simulated time. The topics stay open, because
        they belong to the node."""
        try:
            self._set_initial_state()
            self._open_topics()
            while not until.is_set():
                self._tick()
                if self._tasks.run():  # a task may have changed the time
                    self._read_clock()
                    self._origin = None
                    self._next_picture = self._next_grippers = self._next_joints = -math.inf
                self._wait_for_commands()
                self._keep_pace(until)
        finally:
            self._tasks.end()
            with contextlib.suppress(OSError):  # the master has ended, and so have its parameters
                self._node.delete_parameter(USE_SIM_TIME)

    def perform(self, work: Callable[[], T]) -> Future[T]:
        """Run `work` with the ports between two ticks. The future is resolved when the topics show the effect of
        `work`. It is cancelled if the loop ends without running `work`."""
        return self._tasks.ask(work)

    def press_button(self) -> None:
        """Press the red emergency button."""
        self._motors.press()

    def release_button(self) -> None:
        self._motors.release()

    def _set_initial_state(self) -> None:
        """Bring the ports into the initial state."""
        past, ports = self._past, self._ports
        if past.head_pan is not None:
            ports.head.command_pan(past.head_pan)
        if past.calibrated:
            for gripper in ports.grippers.values():
                if not gripper.state().calibrated:
                    gripper.calibrate()
            until = ports.clock.now() + CALIBRATION_S
            while ports.clock.now() < until and not all(_ready(gripper) for gripper in ports.grippers.values()):
                ports.clock.sleep_until(ports.clock.now() + TICK)
        if past.stopped:
            self._motors.press()
            self._motors.release()
        elif past.enabled:
            self._motors.enable()
        self._read_clock()

    # subscriptions -----------------------------------------------------------------------------------

    def _open_topics(self) -> None:
        """Open the publishers first, so that the robot publishes its state before it accepts commands."""
        m = self._messages
        published = {
            topics.JOINT_STATES: m.joint_state,
            topics.HEAD_STATE: m.head_state,
            topics.ROBOT_STATE: m.assembly_state,
            **{topics.GRIPPER_STATE.format(side): m.end_effector_state for side in self._grippers},
            **{topics.TACTILE.format(side): m.tactile_state for side in self._ports.tactile},
            self._camera.rgb: m.image,
            self._camera.depth: m.image,
            self._camera.info: m.camera_info,
            topics.CLOCK: m.clock,
        }
        self._publishers = {topic: self._node.publisher(topic, kind) for topic, kind in published.items()}
        self._node.subscribe(topics.STOP, m.empty, self._stop, QUEUE)
        self._node.subscribe(topics.RESET, m.empty, self._hear_reset, QUEUE)
        self._hear(topics.ENABLE, m.bool, self._enable, QUEUE)
        self._hear(topics.HEAD_COMMAND, m.head_pan_command, self._command_head)
        self._hear(topics.JOINT_STATE_RATE, m.uint16, self._set_state_rate, latched=True)
        for side, limb in self._limbs.items():
            self._hear_limb(side, limb)
        for side, gripper in self._grippers.items():
            self._hear_gripper(side, gripper)

    def _hear(
        self, topic: str, kind: Any, obey: Callable[[Any], None], queue: int = 1, latched: bool = False
    ) -> None:
        """Subscribe, and call `obey` with each message in the next tick."""

        def heard(message: Any) -> None:
            self._heard.send(topic, self._now, lambda _: obey(message), latched)

        self._node.subscribe(topic, kind, heard, queue)

    def _hear_limb(self, side: Side, limb: Limb) -> None:
        m, topic = self._messages, topics.JOINT_COMMAND.format(side)

        def obey(message: Any, at: float) -> None:
            if at - self._enabled_at > LINGER_S and not self._motors.state().enabled:
                self._say(topic, "a command while the motors are off")
            self._say(topic, limb.hear(message.mode, message.names, message.command, at, self._now))

        def heard(message: Any) -> None:
            at = self._now
            self._heard.send(topic, at, lambda arrival: obey(message, arrival))
            with self._command_came:
                self._commanded[side] = at, time.monotonic()
                self._command_came.notify_all()

        def timeout(message: Any) -> None:
            self._say(topics.JOINT_COMMAND_TIMEOUT.format(side), limb.hear_timeout(message.data))

        def speed(message: Any) -> None:
            self._say(topics.SPEED_RATIO.format(side), limb.hear_speed_ratio(message.data))

        self._node.subscribe(topic, m.joint_command, heard)
        self._hear(topics.JOINT_COMMAND_TIMEOUT.format(side), m.float64, timeout, latched=True)
        self._hear(topics.SPEED_RATIO.format(side), m.float64, speed, latched=True)

    def _hear_gripper(self, side: Side, gripper: ElectricGripper) -> None:
        def heard(m: Any) -> None:
            gripper.hear(m.id, m.command, m.args, m.sender, m.sequence)

        self._hear(topics.GRIPPER_COMMAND.format(side), self._messages.end_effector_command, heard, QUEUE)

    def _stop(self, _: Any) -> None:
        """Stop as soon as the message has arrived: without a delay immediately, on the topic's thread."""
        stop = partial(self._motors.stop, f"a stop was requested on {topics.STOP}")
        if self._network.delay or self._network.loss:
            self._heard.send(topics.STOP, self._now, lambda _: stop())
        else:
            stop()

    def _hear_reset(self, _: Any) -> None:
        stops = self._motors.stops
        self._heard.send(topics.RESET, self._now, lambda _: self._reset(stops))

    def _reset(self, stops: int) -> None:
        self._motors.reset(stops)
        self._forget_commands()

    def _enable(self, message: Any) -> None:
        if not message.data:
            self._motors.disable()
            self._forget_commands()
        elif self._motors.enable():
            self._forget_commands()

    def _forget_commands(self) -> None:
        for limb in self._limbs.values():
            limb.forget()

    def _command_head(self, message: Any) -> None:
        if not math.isfinite(message.target):
            self._say(topics.HEAD_COMMAND, "a command that is not a number")
        elif not self._motors.state().enabled:
            late = self._now - self._enabled_at > LINGER_S
            self._say(topics.HEAD_COMMAND, "a command while the motors are off" if late else None)
        elif message.enable_pan_request != message.REQUEST_PAN_DISABLE:
            with contextlib.suppress(DriverError):
                self._ports.head.command_pan(message.target)

    def _set_state_rate(self, message: Any) -> None:
        if message.data:
            self._state_rate = message.data
        else:
            self._say(topics.JOINT_STATE_RATE, "a rate of 0 Hz")

    def _say(self, topic: str, what: str | None) -> None:
        if what is not None and (text := f"{topic}: {what}") not in self._told:
            self._told.add(text)
            self._tell(text)

    # the tick ----------------------------------------------------------------------------------------

    def _tick(self) -> None:
        clock = self._ports.clock
        clock.sleep_until((math.floor(clock.now() / TICK + ROUNDING) + 1) * TICK)
        self._read_clock()
        self._heard.deliver(self._now)
        self._command_arms()
        self._publish()

    def _read_clock(self) -> None:
        shown = self._ports.clock.now()
        self._set_back = max(self._set_back, self._now - shown)
        self._now = shown + self._set_back

    def _command_arms(self) -> None:
        if not self._motors.state().enabled:
            self._forget_commands()
            return
        self._enabled_at = self._now
        if any(limb.fresh(self._now) for limb in self._limbs.values()):
            standing = self._ports.arms.state().q
            parts = [
                limb.set_point(self._now, standing[arm_slice(side, len(standing))])
                for side, limb in self._limbs.items()
            ]
            q, qd = (np.concatenate(columns) for columns in zip(*parts, strict=True))
            self._motors.command(q, qd)

    def _wait_for_commands(self) -> None:
        """Wait up to `patience` for the next command of each arm that was commanded recently."""

        def remaining() -> float:
            waited = [time.monotonic() - wall for at, wall in self._commanded.values() if at < self._now]
            return max((self._patience - w for w in waited), default=0.0)

        with self._command_came:
            while (seconds := remaining()) > 0.0:
                self._command_came.wait(seconds)

    def _keep_pace(self, until: Event) -> None:
        """Wait, so that the cell's time runs no faster than the wall clock."""
        wall = time.monotonic()
        if self._origin is None:
            self._origin = wall, self._now
        due = self._origin[0] + (self._now - self._origin[1])
        if wall - due > MAX_LAG:
            self._origin = wall, self._now
        until.wait(max(0.0, due - wall))

    # publications ------------------------------------------------------------------------------------

    def _publish(self) -> None:
        """Publish the states, then the clock. A program that waits for the clock then has the states of that
        time."""
        m, tell, ports = self._messages, self._send, self._ports
        joints = ports.arms.state()
        if joints.stamp != self._joints_at and self._now >= self._next_joints - ROUNDING * TICK:
            self._joints_at, self._next_joints = joints.stamp, self._now + 1.0 / self._state_rate
            states = message_conversion.joint_state(m, joints)
            tell(topics.JOINT_STATES, states)
            if self._network.repeat:
                tell(topics.JOINT_STATES, states, self._network.repeat)
        turning = abs(joints.head_pan - self._pan) > TURNING * TICK
        self._pan = joints.head_pan
        tell(topics.HEAD_STATE, m.head_state(joints.head_pan, turning, False, True))
        tell(topics.ROBOT_STATE, message_conversion.assembly_state(m, self._motors.state()))
        if self._now >= self._next_grippers - ROUNDING * TICK:
            self._next_grippers = self._now + GRIPPER_PERIOD
            for side, gripper in self._grippers.items():
                tell(topics.GRIPPER_STATE.format(side), message_conversion.gripper_state(m, gripper.report()))
        for side, tactile in ports.tactile.items():
            tell(topics.TACTILE.format(side), message_conversion.tactile_state(m, tactile.reading()))
        self._publish_picture()
        self._published.deliver(self._now)
        self._publishers[topics.CLOCK].publish(m.clock(message_conversion.ros_time(m, self._now - self._set_back)))

    def _send(self, topic: str, message: Any, later: float = 0.0) -> None:
        """Send a message. later: time until it is sent [s], by another node than the earlier ones of its topic."""
        sent, publisher = by_robots_clock(message, self._network.clock_ahead), self._publishers[topic]
        node = topic if not later else f"{topic} again"
        self._published.send(node, self._now + later, lambda _: publisher.publish(sent))

    def _publish_picture(self) -> None:
        """Publish only while the colour picture has a subscriber, as openni2 does."""
        colour = self._publishers[self._camera.rgb]
        if not colour.get_num_connections() or self._now < self._next_picture - ROUNDING * TICK:
            return
        self._next_picture = self._now + self._network.picture_period
        try:
            frame = self._ports.camera.glimpse()
        except DriverError:
            return
        if frame is None:
            return
        rgb, depth, info = message_conversion.picture(self._messages, frame)
        self._send(self._camera.info, info)
        self._send(self._camera.depth, depth)
        self._send(self._camera.rgb, rgb)


def _ready(gripper: Gripper) -> bool:
    state = gripper.state()
    return state.calibrated and not state.moving
