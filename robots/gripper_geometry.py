"""Geometry of a parallel gripper with tactile pads."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from foldcell.robots.ports import Side


@dataclass(frozen=True)
class GripperGeometry:
    """Both grippers of a robot. Lengths [m]; the tool frame has its origin between the tips (robots.ports).

    max_opening: largest distance between the pads. pad_thickness: of each tactile pad, along the tool's y.
    finger_radius, finger_length: each finger as a capsule that reaches back from its tip. hand_radius, hand_from,
    hand_to: the gripper's body as a capsule, and its ends behind the tool frame, along the tool's -z.
    finger_joints: for each side (the URDF's name of the joint, travel [m] per metre of opening). The travel has
    the sign of the URDF's axis.
    """

    max_opening: float
    pad_thickness: float
    finger_radius: float
    finger_length: float
    hand_radius: float
    hand_from: float
    hand_to: float
    finger_joints: Mapping[Side, tuple[tuple[str, float], ...]]

    def tip_distance(self, opening: float) -> float:
        """Return the distance between the middles of the fingertips at an opening of the pads [m]."""
        return opening + self.pad_thickness

    def finger_positions(self, side: Side, opening: float) -> dict[str, float]:
        """Return the position of each finger joint at an opening [m]."""
        return {name: travel * opening for name, travel in self.finger_joints[side]}
