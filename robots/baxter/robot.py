"""Baxter with two electric grippers, and the camera on a bracket above its head."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from robots.baxter.camera_mount import MOUNT
from robots.baxter.gripper import GRIPPER
from robots.ports import Attendant, Ports, Side, Stop
from robots.robot import Robot
from robots.ros.driver import RosDriver
from robots.ros.settings import CameraTopics, RosSettings
from robots.simulated_body import SimulatedBody, Simulation
from robots.visual import RobotVisual

if TYPE_CHECKING:
    from robots.baxter.emulator.emulator import Emulator
    from robots.model import JointLimits, RobotModel

__all__ = ["ROBOT"]


def _load_model() -> RobotModel:
    from robots.baxter.model import load_model

    return load_model()


def _model_file() -> Path:
    from robots.baxter.model import baxter_urdf_path

    return baxter_urdf_path()


def _visual() -> RobotVisual:
    from robots.baxter.meshes import baxter_visual

    return baxter_visual()


def _body(client: int) -> SimulatedBody:
    from robots.baxter.pybullet_body import load_body

    return load_body(client)


def _seen_urdf() -> Path:
    from robots.baxter.pybullet_files import seen_urdf

    return seen_urdf()


def _check() -> None:
    from robots.baxter.ros.messages import load_messages

    load_messages()


def _connect(
    settings: RosSettings, limits: JointLimits, attendant: Callable[[Stop], Attendant], *, driver: str,
    simulated: bool,
) -> AbstractContextManager[Ports]:  # fmt: skip
    from robots.baxter.ros.connection import connected

    return connected(settings, limits, attendant, driver=driver, simulated=simulated)


def _connect_stop() -> AbstractContextManager[Stop]:
    from robots.baxter.ros.connection import connected_stop

    return connected_stop()


@contextmanager
def _emulate(ports: Ports, topics: CameraTopics, patience: float) -> Iterator[Emulator]:
    from robots.baxter.emulator.emulator import Emulator
    from robots.ros.node import open_node

    node = open_node("baxter_emulator")
    try:
        yield Emulator(ports, node, topics, patience=patience)
    finally:
        node.close()


ROBOT = Robot(
    name="baxter",
    title="Baxter",
    load_model=_load_model,
    model_file=_model_file,
    camera=MOUNT,
    gripper=GRIPPER,
    visual=_visual,
    simulation=Simulation(
        body=_body,
        seen_urdf=_seen_urdf,
        shoulder={Side.LEFT: (0.12, 0.28), Side.RIGHT: (0.12, -0.28)},
        drop_joint=1,  # S1
        drop_sign={Side.LEFT: 1.0, Side.RIGHT: 1.0},
        head_range=1.39,
    ),
    driver=RosDriver(check=_check, connect=_connect, connect_stop=_connect_stop, emulate=_emulate),
)
