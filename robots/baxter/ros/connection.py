"""Connection to the ports of a Baxter over ROS: connect, check that every device answers, disconnect."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from typing import Any

from foldcell.robots.baxter.ros.ports.arms import RosArms
from foldcell.robots.baxter.ros.ports.camera import RosCamera
from foldcell.robots.baxter.ros.ports.clock import TopicClock, WallClock, cell_clock
from foldcell.robots.baxter.ros.ports.gripper import RosGripper
from foldcell.robots.baxter.ros.ports.head import RosHead
from foldcell.robots.baxter.ros.ports.latest_message import LatestMessage
from foldcell.robots.baxter.ros.ports.stop import RosStop
from foldcell.robots.baxter.ros.ports.tactile import RosTactile
from foldcell.robots.baxter.ros.topics import JOINT_COMMAND, ROBOT_STATE
from foldcell.robots.errors import ConfigurationError
from foldcell.robots.model import JointLimits
from foldcell.robots.ports import Attendant, Ports, Side, Stop
from foldcell.robots.ros.driver import RosSettings
from foldcell.robots.ros.node import Node, master_address, open_node

ANSWER_S = 5.0
"""Wall time within which every topic has to deliver a message [s]."""


@contextmanager
def connected(
    settings: RosSettings, limits: JointLimits, attendant: Callable[[Stop], Attendant], *, driver: str,
    simulated: bool,
) -> Iterator[Ports]:  # fmt: skip
    """Connect to the robot at ROS_MASTER_URI and yield its ports. limits: set-points are clipped to them.
    attendant: creates the attendant from the stop port, because a stop ends the attendant's waiting. simulated:
    whether the robot is simulated; results are marked accordingly.

    Raises ConfigurationError if there is no ROS or no master, if a device does not answer, if there is more than
    one robot, or if another program commands the arms.
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
        silent = _silent([*_clock_topics(clock), stop.robot, arms.joints, *hands])
        if silent:
            raise ConfigurationError(
                f"no valid message came from {', '.join(silent)} within {ANSWER_S:.0f} s",
                f"check that the robot, its grippers and the pads' readers are on and ROS_IP is this machine's "
                f"address; the master is {master_address()[0]}",
            )
        robots = node.publishers(ROBOT_STATE)
        if len(robots) != 1:
            raise ConfigurationError(
                f"{len(robots)} nodes publish the robot's state ({', '.join(robots)})",
                "leave only one robot, real or emulated, at this master",
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
    """Connect only to the robot's stop circuit and yield its port. Raises ConfigurationError if there is no ROS or
    no master, or if the robot does not answer."""
    node = open_node("foldcell")
    with ExitStack() as closing:
        closing.callback(node.close)
        clock = cell_clock(node)
        stop = RosStop(node, clock)
        closing.callback(stop.close)
        if _silent([*_clock_topics(clock), stop.robot]):
            raise ConfigurationError(
                f"no message came from {ROBOT_STATE} within {ANSWER_S:.0f} s",
                f"check that the robot is on and that ROS_IP is this machine's address; the master is "
                f"{master_address()[0]}",
            )
        yield stop


def _refuse_others(node: Node) -> None:
    """Refuse to connect if another program commands the arms. Called before this program publishes anything."""
    others = {name for side in Side for name in node.publishers(JOINT_COMMAND.format(side))} - {node.name}
    if others:
        raise ConfigurationError(
            f"other programs command the robot's arms: {', '.join(sorted(others))}",
            "end them (rosnode kill NAME); this includes trajectory action servers",
        )


def _clock_topics(clock: WallClock | TopicClock) -> list[TopicClock]:
    """Return the clock if its time comes from a topic; else an empty list."""
    return [clock] if isinstance(clock, TopicClock) else []


def _silent(subscriptions: Sequence[TopicClock | LatestMessage[Any]]) -> list[str]:
    """Return the topics without a valid message within ANSWER_S."""
    until = time.monotonic() + ANSWER_S
    return [s.topic for s in subscriptions if not s.wait(max(0.0, until - time.monotonic()))]
