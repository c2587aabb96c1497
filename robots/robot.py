"""A robot as the cell sees it: one value that a robot's package provides.

Built-in robots are the folders of `robots/` that contain `robot.py`. Any installed package can add one by an entry
point (robots/registry.py). The parts are functions, so that a robot is only loaded as far as it is used.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from robots.camera_mount import CameraMount
from robots.gripper_geometry import GripperGeometry
from robots.ros.driver import RosDriver
from robots.simulated_body import Simulation
from robots.visual import RobotVisual

if TYPE_CHECKING:
    from robots.model import RobotModel  # which loads Pinocchio

__all__ = ["Robot"]


@dataclass(frozen=True, eq=False)
class Robot:
    """A robot with two arms, parallel grippers and a camera over its table.

    name: the value of `robot:` in `cell.yaml`. title: its name for people. load_model: kinematics, collision
    geometry, limits and parked pose, the same object at each call; raises ConfigurationError if its files are
    missing. model_file: the file that the model is read from. camera: mount and lens as drawn. visual: shapes for
    a viewer; raises StorageError if they cannot be cached. simulation: its body in the simulated cell. driver: the
    real robot; None for a robot that exists only in simulation.
    """

    name: str
    title: str
    load_model: Callable[[], RobotModel]
    model_file: Callable[[], Path]
    camera: CameraMount
    gripper: GripperGeometry
    visual: Callable[[], RobotVisual]
    simulation: Simulation
    driver: RosDriver | None = None
