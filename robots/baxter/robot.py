"""Baxter with two electric grippers, and the camera on a bracket above its head. The model comes from the URDF of
the wheel `example-robot-data`.

The URDF's links `left_gripper` and `right_gripper` are the tool frames, without an additional rotation: origin
between the fingertips, z out of the hand, y along the fingers' prismatic joints.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from foldcell.robots.baxter.names import ARM_JOINTS, HEAD_RANGE
from foldcell.robots.baxter.ros.electric_gripper import FULL_OPENING
from foldcell.robots.camera_mount import XTION, CameraMount, look_at
from foldcell.robots.example_data import package_root, read_description
from foldcell.robots.gripper_geometry import GripperGeometry
from foldcell.robots.ports import Attendant, Ports, Side, Stop, frozen
from foldcell.robots.ros.driver import CameraTopics, Network, RosDriver, RosSettings
from foldcell.robots.urdf.build import robot_of
from foldcell.robots.urdf.description import RGB, Dynamics, RobotDescription
from foldcell.robots.urdf.elements import srdf_disabled_pairs

if TYPE_CHECKING:
    from foldcell.robots.baxter.emulator.emulator import Emulator
    from foldcell.robots.model import JointLimits

FOLDER = "example-robot-data/robots/baxter_description"
FLOOR = -0.924
"""Height of the floor in the base frame [m]."""

PARK_LEFT = (0.31, -0.75, -0.98, 1.73, 0.85, 1.60, 0.72)
"""Parked left arm [rad]. The hand is beside the near corner of the table, 0.2 m above it, at least 20 mm outside
the camera's view (tested), and about 1.1 s from the start and end of a towel's folds."""
MIRROR = (-1.0, 1.0, -1.0, 1.0, -1.0, 1.0, -1.0)
"""Factors that convert the joint angles of the left arm to those of the mirrored right arm. Rotations about z and
about the link axes change sign."""
PARK_RIGHT = tuple(angle * factor for angle, factor in zip(PARK_LEFT, MIRROR, strict=True))

GRIPPER = GripperGeometry(
    max_opening=FULL_OPENING,
    pad_thickness=0.008,  # the pads fill the gap of 16 mm between the URDF's closed bare fingertips
    finger_radius=0.008,
    finger_length=0.085,
    hand_radius=0.040,
    hand_from=0.110,
    hand_to=0.200,
    finger_joints={
        side: ((f"{side[0]}_gripper_l_finger_joint", 0.5), (f"{side[0]}_gripper_r_finger_joint", -0.5))
        for side in Side
    },
)
"""The electric grippers with tactile pads."""

HEAD_ORIGIN = (0.06, 0.0, 0.686)
"""Position of the URDF's head_pan joint in the base frame [m]. It rotates about z."""

EYE, TARGET = (0.25, 0.0, 1.00), (0.60, 0.0, -0.10)
"""Position of the camera, and the point that it looks at, with the head straight ahead. Base frame [m]."""

_T_BASE_HEAD = np.eye(4)
_T_BASE_HEAD[:3, 3] = HEAD_ORIGIN

MOUNT = CameraMount(
    intrinsics=XTION,
    T_head_camera=frozen(np.linalg.inv(_T_BASE_HEAD) @ look_at(EYE, TARGET)),
    head_joint="head_pan",
    head_origin=HEAD_ORIGIN,
)
"""Mount of the RGB-D camera: a bracket above the head panel, which turns with the head.

The bracket holds the camera in front of the panel's upper edge, which reaches x = 0.216, z = 0.765 in the base
frame. If the camera were further back, the panel would hide the near half of the table.
"""

RED, DARK, BLACK, GREY = (176, 32, 36), (88, 91, 97), (58, 60, 65), (165, 168, 173)
"""Colours of Baxter's plastics (sRGB). The colours in the files would look nearly black in a viewer."""
BODY = ("PEDESTAL", "base_link")
"""Meshes of pedestal and torso. The camera sees little more of them than their shadow."""


def _urdf_path() -> Path:
    return package_root() / FOLDER / "urdf/baxter.urdf"


def _urdf() -> str:
    """Return the text of the URDF without the visuals of sensor markers and dummies, which have no mesh."""
    root = ET.fromstring(read_description(_urdf_path()))
    for link in root.iter("link"):
        for visual in link.findall("visual"):
            if visual.find("geometry/mesh") is None:
                link.remove(visual)
    return ET.tostring(root, encoding="unicode")


def _part_colour(stem: str, given: RGB) -> RGB:
    """Return the colour of one of Baxter's plastics, chosen by the colour `given` in the mesh file."""
    if given[0] > 2 * given[1] + 20:
        return RED
    if stem in BODY or 10 < given[0] < 100:
        return DARK
    return BLACK if given[0] <= 10 else GREY


def _rendered_colour(stem: str) -> tuple[float, float, float]:
    """Return the colour of a mesh in the cell's camera, 0 to 1."""
    if stem in (*BODY, "S0", "E0", "W0", "W2") or "finger" in stem or "tip" in stem:
        return 0.20, 0.21, 0.23
    return (0.62, 0.12, 0.12) if stem in ("S1", "E1", "W1", "H1") else (0.55, 0.56, 0.58)


def _check() -> None:
    from foldcell.robots.baxter.ros.messages import load_messages

    load_messages()


def _connect(
    settings: RosSettings, limits: JointLimits, attendant: Callable[[Stop], Attendant], *, driver: str,
    simulated: bool,
) -> AbstractContextManager[Ports]:  # fmt: skip
    from foldcell.robots.baxter.ros.connection import connected

    return connected(settings, limits, attendant, driver=driver, simulated=simulated)


def _connect_stop() -> AbstractContextManager[Stop]:
    from foldcell.robots.baxter.ros.connection import connected_stop

    return connected_stop()


@contextmanager
def _emulate(
    ports: Ports, topics: CameraTopics, patience: float, network: Network, tell: Callable[[str], None]
) -> Iterator[Emulator]:
    from foldcell.robots.baxter.emulator.emulator import Emulator
    from foldcell.robots.ros.node import open_node

    node = open_node("baxter_emulator")
    try:
        yield Emulator(ports, node, topics, tell, patience, network=network)
    finally:
        node.close()


DESCRIPTION = RobotDescription(
    name="baxter",
    title="Baxter",
    source=_urdf_path,
    urdf=_urdf,
    meshes=package_root,
    arm_joints={side: tuple(f"{side}_{joint}" for joint in ARM_JOINTS) for side in Side},
    tool_links={side: f"{side}_gripper" for side in Side},
    fingers={
        side: tuple(f"{side[0]}_gripper_{finger}_finger{part}" for finger in ("l", "r") for part in ("", "_tip"))
        for side in Side
    },
    gripper=GRIPPER,
    camera=MOUNT,
    park={Side.LEFT: PARK_LEFT, Side.RIGHT: PARK_RIGHT},
    floor=FLOOR,
    planning=Dynamics(velocity=0.8, acceleration=3.0, jerk=30.0, wrist=2.0),
    commissioning=Dynamics(velocity=0.5, acceleration=1.0, jerk=5.0),
    protective=Dynamics(velocity=1.0, acceleration=6.0, jerk=120.0, wrist=2.0),
    opening=0.5 * GRIPPER.max_opening,
    contact_effort=9.0,
    # The URDF has 50 Nm, without the springs at S1 that support the upper arm. The arm would sag by 0.23 rad.
    efforts=(150.0,) * len(ARM_JOINTS),
    shoulder={Side.LEFT: (0.12, 0.28), Side.RIGHT: (0.12, -0.28)},
    drop_joint=1,  # S1
    drop_sign={Side.LEFT: 1.0, Side.RIGHT: 1.0},
    disabled_pairs=lambda: srdf_disabled_pairs(_urdf_path().parents[1] / "srdf/baxter_manipulation.srdf"),
    head_range=HEAD_RANGE,
    part_colour=_part_colour,
    rendered_colour=_rendered_colour,
    rendered_grid=dict.fromkeys(BODY, 0.020),
    driver=RosDriver(check=_check, connect=_connect, connect_stop=_connect_stop, emulate=_emulate),
)

ROBOT = robot_of(DESCRIPTION)
load_model = ROBOT.load_model
