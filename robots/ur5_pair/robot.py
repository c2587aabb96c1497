"""The pair as a robot of the registry."""

from __future__ import annotations

import numpy as np

from foldcell.robots.camera_mount import XTION, CameraMount, look_at
from foldcell.robots.example_data import package_root
from foldcell.robots.ports import Side, frozen
from foldcell.robots.ur5_pair.urdf import BASE, GRIPPER, disabled_pairs, pair_urdf, source_path
from foldcell.robots.urdf.build import robot_of
from foldcell.robots.urdf.description import Dynamics, RobotDescription

__all__ = ["DESCRIPTION", "ROBOT"]

JOINTS = tuple(
    f"{name}_joint" for name in ("shoulder_pan", "shoulder_lift", "elbow", "wrist_1", "wrist_2", "wrist_3")
)
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

DESCRIPTION = RobotDescription(
    name="ur5_pair",
    title="UR5 pair",
    source=source_path,
    urdf=pair_urdf,
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
    disabled_pairs=disabled_pairs,
    colours={"base": (70, 73, 78)},
)

ROBOT = robot_of(DESCRIPTION)
