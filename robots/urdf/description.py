"""The description of a robot by one URDF and the figures that a URDF does not contain."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path

from foldcell.robots.camera_mount import CameraMount
from foldcell.robots.gripper_geometry import GripperGeometry
from foldcell.robots.ports import Side
from foldcell.robots.ros.driver import RosDriver

RGB = tuple[int, int, int]
Pairs = frozenset[frozenset[str]]


@dataclass(frozen=True)
class Dynamics:
    """Limits of the joints: velocity as a share of the URDF's, acceleration [rad/s2], jerk [rad/s3]. wrist: factor
    on acceleration and jerk of each arm's last three joints."""

    velocity: float
    acceleration: float
    jerk: float
    wrist: float = 1.0


@dataclass(frozen=True)
class RobotDescription:
    """A robot with two arms whose links all stand in one URDF. Its root link is the base frame (robots.ports).

    name, title: as in `Robot`. source: the file of the robot, which `foldcell doctor` shows. urdf: text of the
    complete URDF; raises ConfigurationError if a file is missing. meshes: folder from which `package://` URIs and
    relative paths of meshes start. arm_joints: each arm's joints from shoulder to wrist. tool_links: link of each
    tool frame. fingers: links of each hand's fingers. disabled_pairs: pairs of links that cannot collide, besides
    neighbours. park: each arm's joints when it stands out of the camera's view [rad]. floor: its height in the
    base frame [m]. planning, commissioning, protective: as in `RobotModel`. position_margin: distance of planned
    motions to the URDF's position limits [rad]. opening: of the grippers in collision checks [m]. contact_effort:
    as in `RobotModel`. efforts: motor torque of one arm's joints in the simulation [Nm]. shoulder, drop_joint,
    drop_sign, head_range: as in `Simulation`. driver: the real robot.

    Meshes are named by the stems of their files. colours: stem -> sRGB; other meshes are grey. part_colour(stem,
    given): sRGB in the viewer, instead of `colours`, for a part of a mesh that has the colour `given` in the file.
    rendered_colour(stem): colour in the cell's camera, 0 to 1, instead of `colours`. rendered_grid: grid size of
    the simplified mesh for the cell's camera, if it differs from the usual one [m].
    """

    name: str
    title: str
    source: Callable[[], Path]
    urdf: Callable[[], str]
    meshes: Callable[[], Path]
    arm_joints: Mapping[Side, tuple[str, ...]]
    tool_links: Mapping[Side, str]
    fingers: Mapping[Side, tuple[str, ...]]
    gripper: GripperGeometry
    camera: CameraMount
    park: Mapping[Side, tuple[float, ...]]
    floor: float
    planning: Dynamics
    commissioning: Dynamics
    protective: Dynamics
    opening: float
    contact_effort: float
    efforts: tuple[float, ...]
    shoulder: Mapping[Side, tuple[float, float]]
    drop_joint: int
    drop_sign: Mapping[Side, float]
    disabled_pairs: Callable[[], Pairs] = frozenset
    position_margin: float = 0.02
    head_range: float = 0.0
    colours: Mapping[str, RGB] = field(default_factory=dict)
    part_colour: Callable[[str, RGB], RGB] | None = None
    rendered_colour: Callable[[str], tuple[float, float, float]] | None = None
    rendered_grid: Mapping[str, float] = field(default_factory=dict)
    driver: RosDriver | None = None

    @property
    def joint_names(self) -> tuple[str, ...]:
        return tuple(name for side in Side for name in self.arm_joints[side])
