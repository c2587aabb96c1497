"""A robot's driver over ROS, and the emulator that serves simulated ports in the robot's place."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Future
from contextlib import AbstractContextManager
from dataclasses import dataclass
from threading import Event
from typing import TYPE_CHECKING, Any, Protocol

from robots.ports import Attendant, Ports, Stop
from robots.ros.settings import CameraTopics, RosSettings

if TYPE_CHECKING:
    from robots.model import JointLimits

__all__ = ["Emulate", "EmulatedRobot", "RosDriver"]


class Connect(Protocol):
    def __call__(
        self, settings: RosSettings, limits: JointLimits, attendant: Callable[[Stop], Attendant], *, driver: str,
        simulated: bool,
    ) -> AbstractContextManager[Ports]:  # fmt: skip
        """Connect to the robot at ROS_MASTER_URI. limits: set-points are clipped to them. attendant: creates the
        attendant from the stop port. driver, simulated: as in `Ports`. Raises ConfigurationError if a part of the
        cell does not answer, or another program commands the robot."""


class EmulatedRobot(Protocol):
    """A robot on ROS whose body is a cell's ports."""

    def run(self, until: Event) -> None:
        """Serve until the event is set."""

    def perform(self, work: Callable[[], Any]) -> Future[Any]:
        """Let the serving thread do `work`. May be called from any thread."""


class Emulate(Protocol):
    def __call__(
        self, ports: Ports, topics: CameraTopics, patience: float
    ) -> AbstractContextManager[EmulatedRobot]:
        """Open the topics of an emulated robot. patience: wall time for which it waits for the next command after
        a command [s]."""


@dataclass(frozen=True)
class RosDriver:
    """check: raises ConfigurationError if ROS or the robot's messages are missing. connect: opens all ports.
    connect_stop: opens only the stop circuit. emulate: serves simulated ports as this robot."""

    check: Callable[[], None]
    connect: Connect
    connect_stop: Callable[[], AbstractContextManager[Stop]]
    emulate: Emulate
