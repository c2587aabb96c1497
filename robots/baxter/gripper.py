"""Baxter's electric grippers with tactile pads."""

from __future__ import annotations

from robots.gripper_geometry import GripperGeometry
from robots.ports import Side

__all__ = ["GRIPPER"]

GRIPPER = GripperGeometry(
    max_opening=0.0416,  # twice the stroke of one finger
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
