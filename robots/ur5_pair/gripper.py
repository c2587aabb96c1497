"""The grippers of the pair: parallel, electric, with tactile pads."""

from __future__ import annotations

from robots.gripper_geometry import GripperGeometry
from robots.ports import Side

__all__ = ["GRIPPER", "TOOL_LENGTH"]

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
