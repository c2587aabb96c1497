"""A puppet Baxter in plain rospy: it publishes what a test sets and keeps all commands."""

from __future__ import annotations

import json
import threading
import time
from collections.abc import Callable, Iterable
from contextlib import AbstractContextManager
from typing import Any

import numpy as np

from foldcell.robots.baxter.names import JOINT_NAMES
from foldcell.robots.baxter.ros.messages import load_messages
from foldcell.robots.ports import Ports, Side, arm_slice
from foldcell.robots.ros.installation import import_ros
from foldcell.robots.ros.node import open_node

Connect = Callable[..., AbstractContextManager[Ports]]

PATIENCE = 60.0  # [s] wall time
NAMES = ["head_nod", "head_pan", *sorted(JOINT_NAMES), "torso_t0"]
FINGERS = ["left_gripper_l_finger_joint", "left_gripper_r_finger_joint"]
JOINTS, STATE, HEAD = "/robot/joint_states", "/robot/state", "/robot/head/command_head_pan"
ENABLE, RESET, STOP = "/robot/set_super_enable", "/robot/set_super_reset", "/robot/set_super_stop"
LIMB = {side: f"/robot/limb/{side}/" for side in Side}
HAND = {side: f"/robot/end_effector/{side}_gripper/" for side in Side}
PADS = {side: f"/tactile/{side}_gripper" for side in Side}
CAMERA = {"rgb": "/eye/rgb", "depth": "/eye/depth", "info": "/eye/info"}

m = load_messages


def wait(condition: Callable[[], Any], what: str, seconds: float = PATIENCE) -> None:
    until = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < until, f"never: {what}"
        time.sleep(0.002)


class HandClock:
    """A cell clock that a test sets."""

    def __init__(self) -> None:
        self.time = 100.0

    def now(self) -> float:
        return self.time

    def sleep_until(self, t: float) -> None:
        time.sleep(0.002)
        self.time = max(self.time, t)


class Hand:
    """A gripper. deaf: it ignores commands."""

    def __init__(self, puppet: Puppet, side: Side) -> None:
        self._puppet = puppet
        self.deaf = False
        self.calibrated, self.moving, self.error = 0, 0, 0
        self.position, self.force = 37.0, 0.0
        self.echo = "", 0
        self.handled: list[Any] = []
        self.calibrating = 0
        self.calibration_ticks = 5
        self.topic = HAND[side] + "command"

    @property
    def heard(self) -> list[Any]:
        return self._puppet.heard[self.topic]

    def hear(self, message: Any) -> None:
        if self.deaf or self.echo == (message.sender, message.sequence):
            return
        self.handled.append(message)
        if message.command == "calibrate":
            self.calibrated, self.moving, self.calibrating = 0, 1, self.calibration_ticks
        elif message.command == "clear_calibration":
            self.calibrated = 0
        elif message.command == "reset":
            self.error = 0
        elif message.command == "go" and self.calibrated:
            self.position = json.loads(message.args)["position"]
        self.echo = message.sender, message.sequence

    def tick(self) -> None:
        if self.calibrating:
            self.calibrating -= 1
            if not self.calibrating:
                self.calibrated, self.moving = 1, 0

    def state(self) -> Any:
        return m().end_effector_state(
            id=65538, enabled=1, calibrated=self.calibrated, error=self.error, ready=1, moving=self.moving,
            position=self.position, force=self.force, command_sender=self.echo[0], command_sequence=self.echo[1],
        )  # fmt: skip


class Puppet:
    """A robot. silent: topics that it does not publish. deaf: topics whose messages it ignores. film: the camera's
    (topic, message) pairs for each tick."""

    def __init__(self) -> None:
        open_node("puppet")
        rospy = import_ros()
        self.q, self.qd, self.effort = np.linspace(-0.6, 0.7, 14), np.linspace(0.1, 0.2, 14), np.arange(14.0)
        self.pan = 0.125
        self.enabled = self.stopped = self.error = self.lasting_error = False
        self.button = self.source = 0
        self.silent: set[str] = set()
        self.deaf: set[str] = set()
        self.hands = {side: Hand(self, side) for side in Side}
        self.pads = {side: pads() for side in Side}
        self.film: Callable[[], Iterable[tuple[str, Any]]] = lambda: ()
        self.heard: dict[str, list[Any]] = {}
        self.ticks = 0
        self.failed: BaseException | None = None
        self._topics = rospy.topics.get_topic_manager()
        self._lock = threading.RLock()
        self._over = threading.Event()
        self._publishers = {
            topic: rospy.Publisher(topic, kind, queue_size=10, tcp_nodelay=True)
            for topic, kind in {
                JOINTS: m().joint_state, STATE: m().assembly_state,
                **{HAND[s] + "state": m().end_effector_state for s in Side},
                **{PADS[s]: m().tactile_state for s in Side},
                CAMERA["rgb"]: m().image, CAMERA["depth"]: m().image, CAMERA["info"]: m().camera_info,
            }.items()
        }  # fmt: skip
        self._subscribers = {topic: self._subscribe(rospy, topic, kind) for topic, kind in commands().items()}
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def _subscribe(self, rospy: Any, topic: str, kind: Any) -> Any:
        self.heard[topic] = []
        return rospy.Subscriber(topic, kind, lambda message: self._hear(topic, message), tcp_nodelay=True)

    def _hear(self, topic: str, message: Any) -> None:
        with self._lock:
            self.heard[topic].append(message)
            if topic in self.deaf:
                return
            if topic == ENABLE:
                self.enabled = message.data and not self.stopped
            elif topic == STOP:
                self.stopped, self.enabled = True, False
            elif topic == RESET and self.button != 1:
                self.stopped = self.enabled = self.error = False
            elif topic == HEAD:
                self.pan = message.target
            for side in Side:
                if topic == self.hands[side].topic:
                    self.hands[side].hear(message)
                elif topic == LIMB[side] + "joint_command" and self.enabled:
                    part = arm_slice(side, 14)
                    place = dict(zip(message.names, message.command, strict=True))
                    self.q = self.q.copy()
                    self.q[part] = [place[name] for name in JOINT_NAMES[part]]

    def _run(self) -> None:
        try:
            while not self._over.wait(0.01):
                with self._lock:
                    self._tick()
        except BaseException as error:
            self.failed = error

    def _tick(self) -> None:
        if self.ticks % 3 == 0:
            nines = [9.0, 9.0]
            self.say(JOINTS, m().joint_state(name=FINGERS, position=nines, velocity=nines, effort=nines))
        self.say(JOINTS, self.joints())
        self.say(STATE, m().assembly_state(
            self.enabled, self.enabled, self.stopped, self.error or self.lasting_error, self.button, self.source
        ))  # fmt: skip
        for side in Side:
            self.hands[side].tick()
            self.say(HAND[side] + "state", self.hands[side].state())
            self.say(PADS[side], self.pads[side])
        for topic, message in self.film():
            self.say(topic, message)
        self.ticks += 1

    def joints(self) -> Any:
        values = []
        for arms, head in ((self.q, [0.0, self.pan]), (self.qd, [0.0, 0.0]), (self.effort, [0.0, 0.0])):
            named = {**dict(zip(JOINT_NAMES, arms, strict=True)), "head_nod": head[0], "head_pan": head[1]}
            values.append([float(named.get(name, -9.0)) for name in NAMES])
        return m().joint_state(name=list(NAMES), position=values[0], velocity=values[1], effort=values[2])

    def say(self, topic: str, message: Any) -> None:
        if topic not in self.silent:
            self._publishers[topic].publish(message)

    def hush(self, *topics: str) -> None:
        """Stop publishing these topics, and wait until the messages already sent have arrived."""
        self.silent |= set(topics)
        self.let(10)

    def listeners(self, topic: str) -> int:
        return int(self._publishers[topic].get_num_connections())

    def hears(self, topic: str) -> bool:
        """Whether this process publishes the topic and the connection is established on both ends."""
        publisher = self._topics.get_impl("pub", topic)
        ends = publisher, self._subscribers[topic]
        return all(end is not None and end.get_num_connections() for end in ends)

    def let(self, ticks: int) -> None:
        """Wait until the robot has published this many times."""
        until = self.ticks + ticks
        wait(lambda: self.ticks >= until or self.failed, f"{ticks} ticks")
        assert self.failed is None, self.failed

    def stays(self, count: Callable[[], Any], ticks: int = 15) -> None:
        """Wait for messages in transit, then assert that `count` does not change."""
        self.let(10)
        before = count()
        self.let(ticks)
        assert count() == before

    def close(self) -> None:
        self._over.set()
        self._thread.join(PATIENCE)
        for opened in (*self._subscribers.values(), *self._publishers.values()):
            opened.unregister()
        assert self.failed is None, self.failed


def commands() -> dict[str, Any]:
    kinds = {ENABLE: m().bool, RESET: m().empty, STOP: m().empty, HEAD: m().head_pan_command}
    for side in Side:
        kinds[LIMB[side] + "joint_command"] = m().joint_command
        kinds[LIMB[side] + "inverse_dynamics_command"] = m().joint_trajectory_point
        kinds[LIMB[side] + "joint_command_timeout"] = kinds[LIMB[side] + "set_speed_ratio"] = m().float64
        kinds[HAND[side] + "command"] = m().end_effector_command
    return kinds


COMMANDS = (
    ENABLE, RESET, STOP, HEAD,
    *(LIMB[side] + name for side in Side for name in (
        "joint_command", "inverse_dynamics_command", "joint_command_timeout", "set_speed_ratio",
    )),
    *(HAND[side] + "command" for side in Side),
)  # fmt: skip


def pads(**channels: Any) -> Any:
    """A message of the pads. Without values: 2 pads of 4 x 3 cells, 0.0 to 11.0 and 12.0 to 23.0."""
    said = {"pad_0": np.arange(12.0), "pad_1": np.arange(12.0, 24.0), "tips": [0.5, 1.5], **channels}
    return m().tactile_state(
        sensors=[m().tactile_channel(name, list(values)) for name, values in said.items() if values is not None]
    )
