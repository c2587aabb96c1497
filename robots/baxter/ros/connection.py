"""A real Baxter's ports: connected, checked that everything answers, and let go again."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from typing import Any

from robots.baxter.ros.node import Node, master_address, open_node
from robots.baxter.ros.ports.arms import RosArms
from robots.baxter.ros.ports.camera import RosCamera
from robots.baxter.ros.ports.clock import TopicClock, WallClock, cell_clock
from robots.baxter.ros.ports.gripper import RosGripper
from robots.baxter.ros.ports.head import RosHead
from robots.baxter.ros.ports.latest_message import LatestMessage
from robots.baxter.ros.ports.stop import RosStop
from robots.baxter.ros.ports.tactile import RosTactile
from robots.baxter.ros.topics import ROBOT_STATE, CameraTopics, joint_command
from robots.errors import ConfigurationError
from robots.model import JointLimits
from robots.ports import Attendant, Ports, Side, Stop

__all__ = ["RosSettings", "connected", "connected_stop"]

ANSWER_S = 5.0
"""On the wall, in which everything has to be heard of once."""


@dataclass(frozen=True)
class RosSettings:
    """raw_position: the robot's own collision avoidance is off and its inverse dynamics are fed forward: it
    follows more closely. tactile_rows: of cells on each pad. camera_settle [s]: before a picture counts."""

    camera: CameraTopics = field(default_factory=CameraTopics)
    raw_position: bool = False
    tactile_rows: int = 4
    camera_settle: float = 0.5


@contextmanager
def connected(
    settings: RosSettings, limits: JointLimits, attendant: Callable[[Stop], Attendant], *, driver: str,
    simulated: bool,
) -> Iterator[Ports]:  # fmt: skip
    """The ports of the robot that ROS_MASTER_URI names. limits: that no set-point leaves. attendant: made with the
    stop, which ends its waiting. simulated: what answers is no robot; results are labelled by it.

    Raises ConfigurationError: no ROS, no master, something that does not answer, more than one robot, or another
    program that commands its arms.
    """
    node = open_node("foldcell")
    with ExitStack() as closing:
        closing.callback(node.close)
        _refuse_others(node)
        clock = cell_clock(node)
        stop = RosStop(node, clock)
        closing.callback(stop.close)

        def stopped() -> bool:
            return stop.state().stopped

        head = RosHead(node, clock, stopped)
        arms = RosArms(node, clock, stop, limits, settings.raw_position, head.watch)
        grippers = {side: RosGripper(node, clock, side, stopped) for side in Side}
        camera = RosCamera(node, clock, settings.camera, settings.camera_settle, stopped)
        pads = {side: RosTactile(node, clock, side, settings.tactile_rows) for side in Side}
        hands: list[LatestMessage[Any]] = [gripper.hearing for gripper in grippers.values()]
        hands += [pad.hearing for pad in pads.values()]
        silent = _silent([*_topics_of(clock), stop.robot, arms.joints, *hands])
        if silent:
            raise ConfigurationError(
                f"nothing (or nothing that is understood) came from {', '.join(silent)} within {ANSWER_S:.0f} s",
                f"see whether the robot, its grippers and the pads' readers are on, and ROS_IP is this machine's "
                f"address; the master is {master_address()[0]}",
            )
        robots = node.publishers(ROBOT_STATE)
        if len(robots) != 1:
            raise ConfigurationError(
                f"{len(robots)} nodes say what state the robot is in ({', '.join(robots)})",
                "leave one robot, real or emulated, at this master",
            )
        yield Ports(
            driver=driver,
            simulated=simulated,
            clock=clock,
            arms=arms,
            head=head,
            grippers=grippers,
            tactile=pads,
            camera=camera,
            stop=stop,
            attendant=attendant(stop),
        )


@contextmanager
def connected_stop() -> Iterator[RosStop]:
    """The robot's stop circuit alone. Raises ConfigurationError: no ROS, no master, a robot that is silent."""
    node = open_node("foldcell")
    with ExitStack() as closing:
        closing.callback(node.close)
        clock = cell_clock(node)
        stop = RosStop(node, clock)
        closing.callback(stop.close)
        if _silent([*_topics_of(clock), stop.robot]):
            raise ConfigurationError(
                f"nothing came from {ROBOT_STATE} within {ANSWER_S:.0f} s",
                f"see whether the robot is on, and ROS_IP is this machine's address; the master is "
                f"{master_address()[0]}",
            )
        yield stop


def _refuse_others(node: Node) -> None:
    """Before anything is published: two programs would pull at one arm."""
    others = {name for side in Side for name in node.publishers(joint_command(side))} - {node.name}
    if others:
        raise ConfigurationError(
            f"other programs command the robot's arms: {', '.join(sorted(others))}",
            "end them (rosnode kill NAME), a trajectory action server too",
        )


def _topics_of(clock: WallClock | TopicClock) -> list[TopicClock]:
    """What has to be heard before the time is known."""
    return [clock] if isinstance(clock, TopicClock) else []


def _silent(hearings: Sequence[TopicClock | LatestMessage[Any]]) -> list[str]:
    """The topics of which nothing was heard in time."""
    until = time.monotonic() + ANSWER_S
    return [h.topic for h in hearings if not h.wait(max(0.0, until - time.monotonic()))]
