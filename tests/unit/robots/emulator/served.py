"""An emulator on a thread, and a ROS program that talks to it."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from typing import Any

from foldcell.robots.baxter.emulator.emulator import Emulator
from foldcell.robots.baxter.emulator.initial_state import NEW
from foldcell.robots.baxter.ros import topics
from foldcell.robots.baxter.ros.messages import load_messages
from foldcell.robots.ports import Ports
from foldcell.robots.ros.installation import import_ros
from foldcell.robots.ros.node import open_node

PATIENCE = 60.0  # [s] wall time


def wait(condition: Callable[[], Any], what: str) -> None:
    until = time.monotonic() + PATIENCE
    while not condition():
        assert time.monotonic() < until, f"never: {what}"
        time.sleep(0.002)


class TactileRecording:
    """All messages received on a topic."""

    def __init__(self) -> None:
        self.all: list[Any] = []

    @property
    def newest(self) -> Any:
        wait(lambda: self.all, "a first message")
        return self.all[-1]


class Program:
    """An emulator on its own thread, and a ROS program that uses only topics. Without an initial state, the robot
    is new."""

    def __init__(self, ports: Ports, **settings: Any) -> None:
        self.m = load_messages()
        self.told: list[str] = []
        self.error: BaseException | None = None
        self._node = open_node("emulator_test")
        self.emulator = Emulator(ports, self._node, tell=self.told.append, **{"past": NEW, **settings})
        self._rospy = import_ros()
        self._opened: list[Any] = []
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._run)
        self._thread.start()
        self.clock = self.hear(topics.CLOCK, self.m.clock)
        self.joints = self.hear(topics.JOINT_STATES, self.m.joint_state)
        self.robot = self.hear(topics.ROBOT_STATE, self.m.assembly_state)

    def _run(self) -> None:
        try:
            self.emulator.run(self._over)
        except BaseException as error:
            self.error = error

    def hear(self, topic: str, kind: Any) -> TactileRecording:
        heard = TactileRecording()
        self._opened.append(self._rospy.Subscriber(topic, kind, heard.all.append, tcp_nodelay=True))
        return heard

    def publisher(self, topic: str, kind: Any) -> Any:
        publisher = self._rospy.Publisher(topic, kind, queue_size=10, tcp_nodelay=True)
        self._opened.append(publisher)
        wait(lambda: publisher.get_num_connections(), f"a listener of {topic}")
        return publisher

    def deaf(self) -> None:
        """Close the subscription that was opened last."""
        self._opened.pop().unregister()

    def now(self) -> float:
        return self.clock.newest.clock.to_sec()

    def let(self, seconds: float) -> None:
        until = self.now() + seconds
        wait(lambda: self.now() >= until - 1e-9 or self.error, f"{seconds} s of cell time")

    def insist(self, publisher: Any, message: Any, condition: Callable[[], Any], what: str) -> None:
        """Repeat a command until the robot reports the result, as the SDK does."""

        def agrees() -> bool:
            if condition():
                return True
            publisher.publish(message)
            self.let(0.02)
            return False

        wait(agrees, what)

    def enable(self) -> None:
        on = self.publisher(topics.ENABLE, self.m.bool)
        self.insist(on, self.m.bool(True), lambda: self.robot.newest.enabled, "enabled")

    def param(self, name: str) -> Any:
        return self._rospy.get_param(name, None)

    def end(self) -> None:
        self._over.set()
        self._thread.join(PATIENCE)
        assert not self._thread.is_alive()

    def close(self) -> None:
        self.end()
        for opened in self._opened:
            opened.unregister()
        self._node.close()
        if self.error is not None:
            raise self.error


Serve = Callable[..., Program]
