"""A robot's driver over ROS, and the emulator that serves simulated ports in the robot's place."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Future
from contextlib import AbstractContextManager
from dataclasses import dataclass, field
from threading import Event
from typing import TYPE_CHECKING, Any, Protocol

from foldcell.robots.ports import Attendant, Ports, Stop

if TYPE_CHECKING:
    from foldcell.robots.model import JointLimits


@dataclass(frozen=True)
class CameraTopics:
    """Topics of the camera: the colour picture as sensor_msgs/Image (rgb8 or bgr8), the depth registered to it as
    Image (32FC1 [m] or 16UC1 [mm]), and CameraInfo. The defaults are the names of openni2_launch with
    depth_registration."""

    rgb: str = "/camera/rgb/image_raw"
    depth: str = "/camera/depth_registered/image_raw"
    info: str = "/camera/rgb/camera_info"


@dataclass(frozen=True)
class RosSettings:
    """Settings of the connection.

    raw_position: switches the robot's own collision avoidance off and uses feed-forward for closer tracking.
    tactile_rows: rows of cells on each pad. camera_settle: streaming time before a picture is used [s].
    """

    camera: CameraTopics = field(default_factory=CameraTopics)
    raw_position: bool = False
    tactile_rows: int = 4
    camera_settle: float = 0.5


@dataclass(frozen=True)
class Network:
    """How the network of an emulated robot behaves; times by the cell's clock [s].

    delay, jitter: each message takes `delay` plus or minus up to `jitter`. loss: share of lost messages.
    reordering: a message may overtake an earlier one of its topic. repeat: a second node publishes each joint
    state again, so much later; 0 for none. clock_ahead: lead of the robot's clock over the cell's. picture_period:
    time between two pictures. master_silent_from, master_silent_for: when the ROS master stops to answer, and for
    how long, by the wall clock since the cell was opened; 0 for never."""

    delay: float = 0.0
    jitter: float = 0.0
    loss: float = 0.0
    reordering: bool = False
    repeat: float = 0.0
    clock_ahead: float = 0.0
    picture_period: float = 0.2
    master_silent_from: float = 0.0
    master_silent_for: float = 0.0


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
        self, ports: Ports, topics: CameraTopics, patience: float, network: Network, tell: Callable[[str], None]
    ) -> AbstractContextManager[EmulatedRobot]:
        """Open the topics of an emulated robot. patience: wall time for which it waits for the next command after
        a command [s]. tell: called once for each kind of order that it does not execute."""


@dataclass(frozen=True)
class RosDriver:
    """check: raises ConfigurationError if ROS or the robot's messages are missing. connect: opens all ports.
    connect_stop: opens only the stop circuit. emulate: serves simulated ports as this robot."""

    check: Callable[[], None]
    connect: Connect
    connect_stop: Callable[[], AbstractContextManager[Stop]]
    emulate: Emulate
