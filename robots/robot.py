"""A robot as the cell sees it: one value that a robot's package provides.

Built-in robots are the folders of `robots/` that contain `robot.py`. Any installed package can add one by an entry
point (robots/registry.py). The parts are functions, so that a robot is only loaded as far as it is used.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Protocol

from foldcell.robots.camera_mount import CameraMount
from foldcell.robots.gripper_geometry import GripperGeometry
from foldcell.robots.ports import Array, Side
from foldcell.robots.ros.driver import RosDriver

if TYPE_CHECKING:
    from foldcell.robots.model import RobotModel  # which loads Pinocchio


@dataclass(frozen=True)
class RobotVisual:
    """Visual model of a robot: the meshes that a viewer loads, and the joints that the ports' values move.

    urdf: a file whose meshes a viewer can load. joint_names: the URDF's names of both arms' joints, in the order
    of `JointState.q`. head_joint: name of the joint that `JointState.head_pan` moves; None if the head is fixed.
    finger_joints: for each side (joint name, travel [m] per metre of opening). The travel has the sign of the
    URDF's axis. floor: height of the floor in the base frame [m].
    """

    urdf: Path
    joint_names: tuple[str, ...]
    head_joint: str | None
    finger_joints: Mapping[Side, tuple[tuple[str, float], ...]]
    floor: float


class SimulatedBody(Protocol):
    """A position-controlled robot in a PyBullet world, with the base at the origin. q, qd, effort: (n,) of both
    arms [rad], [rad/s], [Nm]; head_pan [rad], 0 for a robot without a head; openings of the grippers [m]."""

    def place(self, q: Array, head_pan: float, opening: Mapping[Side, float]) -> None:
        """Set the state at rest."""

    def drive(self, q: Array, qd: Array, head_pan: float, opening: Mapping[Side, float]) -> None:
        """Set the motor targets for the next physics step, which the caller performs."""

    def read(self) -> tuple[Array, Array, Array, float]:
        """Return the true q, qd, effort and head_pan, without sensor errors."""

    def tool_pose(self, side: Side) -> tuple[Array, Array]:
        """Return T_base_tool as position (3,) [m] and rotation (3, 3)."""

    def let_fingers_through(self, other: int) -> None:
        """Disable collisions between the fingers and body `other`."""


@dataclass(frozen=True)
class Simulation:
    """A robot in the simulated cell: its body in a physics world, and its appearance for the camera.

    body(client): loads the robot into the PyBullet world `client`. seen_urdf: path of a URDF with simplified
    visuals and no `package://` paths, which the render process loads. shoulder: place (x, y) [m] of each arm's
    shoulder in the base frame. drop_joint: index, in an arm, of the joint that gives way in a sudden drop.
    drop_sign: for each side, the sign of its rotation that lowers the arm. head_range: largest angle of the head
    to either side [rad].
    """

    body: Callable[[int], SimulatedBody]
    seen_urdf: Callable[[], Path]
    shoulder: Mapping[Side, tuple[float, float]]
    drop_joint: int
    drop_sign: Mapping[Side, float]
    head_range: float = 0.0


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
