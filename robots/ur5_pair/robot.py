"""The pair as a robot of the registry. Its URDF has two arms of the example-robot-data wheel on a plate, grippers
of boxes and a mast.

The wheel's `ur5_gripper` has two bars for fingers that do not move. They are replaced by fingers that do.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from functools import lru_cache
from pathlib import Path

import numpy as np

from foldcell.robots.camera_mount import XTION, CameraMount, look_at
from foldcell.robots.example_data import package_root, read_description
from foldcell.robots.gripper_geometry import GripperGeometry
from foldcell.robots.ports import Side, frozen
from foldcell.robots.urdf.build import robot_of
from foldcell.robots.urdf.description import Dynamics, RobotDescription
from foldcell.robots.urdf.elements import (
    box_link,
    fixed_joint,
    parallel_gripper,
    prefixed_arm,
    srdf_disabled_pairs,
)

JOINTS = tuple(
    f"{name}_joint" for name in ("shoulder_pan", "shoulder_lift", "elbow", "wrist_1", "wrist_2", "wrist_3")
)
TOOL_LENGTH = 0.17
"""Distance from the flange to the tool frame between the tips [m]."""

GRIPPER = GripperGeometry(
    max_opening=0.044,
    pad_thickness=0.008,
    finger_radius=0.008,
    finger_length=0.085,
    hand_radius=0.040,
    hand_from=0.125,
    hand_to=0.200,
    finger_joints={side: ((f"{side}_finger_joint_0", 0.5), (f"{side}_finger_joint_1", -0.5)) for side in Side},
)
"""The grippers of the pair: parallel, electric, with tactile pads."""

BASE = {Side.LEFT: (0.07, 0.22, 0.10), Side.RIGHT: (0.07, -0.22, 0.10)}
"""Place of each arm's foot in the base frame [m], 0.2 m above the table and as near to it as the camera's view
allows. From there the arms reach all folds of the shipped garments (docs/do/another_robot.md). Both arms stand
upright."""
TURN = {Side.LEFT: 0.0, Side.RIGHT: np.pi}
"""Turn of each foot about z [rad]. The shoulder of an arm lies to one side of its axis. The right arm is turned
and reaches forward over its back, so that the arms work like mirror images."""
RISERS = [((0.16, 0.16, z), (x, y, 0.5 * z)) for x, y, z in BASE.values()]
PEDESTAL = ((0.10, 0.64, 0.92), (0.04, 0.0, -0.46))
COLUMN = ((0.08, 0.08, 2.00), (-0.28, 0.0, 0.08))
BOOM = ((0.50, 0.05, 0.05), (-0.01, 0.0, 1.09))
"""Boxes that carry the arms and the camera, as (size, centre) [m]."""

EYE, TARGET = (0.25, 0.0, 1.00), (0.60, 0.0, -0.10)
"""Place of the camera under the end of the boom, and the point that it looks at. Base frame [m]."""

PARK_LEFT = (0.754, -1.284, 1.803, -2.09, -1.571, 0.754)
"""Parked left arm [rad]. The hand points down beside the table's middle, 0.25 m above it, at least 40 mm outside
the camera's view (tested), and about a radian from the start and the end of a towel's folds."""
PARK_RIGHT = tuple(
    float(turn - angle) for turn, angle in zip((0.0, -np.pi, 0.0, -np.pi, 0.0, 0.0), PARK_LEFT, strict=True)
)
"""Parked right arm [rad], the mirror image of the left one. Shoulder lift and first wrist joint are vertical at
-pi / 2, so their angles are mirrored about this value."""


def _source_path() -> Path:
    """Return the path of the wheel's URDF of one arm."""
    return package_root() / "example-robot-data/robots/ur_description/urdf/ur5_gripper.urdf"


@lru_cache(maxsize=1)
def _pair_urdf() -> str:
    """Return the text of the pair's URDF. Raises ConfigurationError if the wheel lacks the arm's."""
    arm = ET.fromstring(read_description(_source_path()))
    _take_off_the_bars(arm)
    robot = ET.Element("robot", name="ur5_pair")
    robot.append(ET.Element("link", name="base"))
    robot.append(box_link("stand", [*RISERS, PEDESTAL, COLUMN, BOOM], 0.0, (0.30, 0.31, 0.33)))
    robot.append(fixed_joint("stand_joint", "base", "stand", (0.0, 0.0, 0.0)))
    for side in Side:
        robot.extend(prefixed_arm(arm, f"{side}_"))
        robot.append(fixed_joint(f"{side}_foot", "base", f"{side}_base_link", BASE[side], (0.0, 0.0, TURN[side])))
        robot.extend(parallel_gripper(side, f"{side}_tool0", TOOL_LENGTH, GRIPPER))
    return ET.tostring(robot, encoding="unicode")


def _take_off_the_bars(arm: ET.Element) -> None:
    """Remove the fixed fingers, and the arm's link `world`: the pair has its own base."""
    for link in arm.findall("link"):
        if link.attrib["name"] == "world":
            arm.remove(link)
        elif link.attrib["name"] in ("tool0", "ee_link"):
            for element in [*link.findall("visual"), *link.findall("collision")]:
                link.remove(element)
    for joint in arm.findall("joint"):
        if joint.attrib["name"] == "world_joint":
            arm.remove(joint)


def _disabled_pairs() -> frozenset[frozenset[str]]:
    """Return the pairs of links that cannot collide: those of the wheel's SRDF, for both arms, with the gripper's
    body in place of the bars."""
    body = {"tool0": "gripper_body"}
    return frozenset(
        frozenset(f"{side}_{body.get(link, link)}" for link in pair)
        for side in Side
        for pair in srdf_disabled_pairs(_source_path().parents[1] / "srdf/ur5_gripper.srdf")
    )


DESCRIPTION = RobotDescription(
    name="ur5_pair",
    title="UR5 pair",
    source=_source_path,
    urdf=_pair_urdf,
    meshes=package_root,
    arm_joints={side: tuple(f"{side}_{name}" for name in JOINTS) for side in Side},
    tool_links={side: f"{side}_tool" for side in Side},
    fingers={side: (f"{side}_finger_0", f"{side}_finger_1") for side in Side},
    gripper=GRIPPER,
    camera=CameraMount(
        intrinsics=XTION,
        T_head_camera=frozen(look_at(EYE, TARGET)),
    ),
    park={Side.LEFT: PARK_LEFT, Side.RIGHT: PARK_RIGHT},
    floor=-0.92,
    planning=Dynamics(velocity=0.4, acceleration=3.0, jerk=30.0),
    commissioning=Dynamics(velocity=0.2, acceleration=1.0, jerk=5.0),
    protective=Dynamics(velocity=0.5, acceleration=6.0, jerk=120.0),
    opening=0.022,
    contact_effort=20.0,
    efforts=(150.0, 150.0, 150.0, 28.0, 28.0, 28.0),
    shoulder={side: BASE[side][:2] for side in Side},
    drop_joint=1,
    drop_sign={Side.LEFT: 1.0, Side.RIGHT: -1.0},
    disabled_pairs=_disabled_pairs,
    colours={"base": (70, 73, 78)},
)

ROBOT = robot_of(DESCRIPTION)
