"""Contact of the fingertips with the table and the cloth: forces, and deflection of the arm."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from foldcell.robots.gripper_geometry import GripperGeometry
from foldcell.robots.ports import Array


@dataclass(frozen=True)
class Stiffness:
    """Stiffnesses [N/m]. arm: stiffness of an arm at the tool, along z; tip: of a rubber fingertip on the table;
    cloth: of the cloth under a fingertip."""

    arm: float
    tip: float
    cloth: float


@dataclass(frozen=True, eq=False)
class Touch:
    """Result of `touch`. force: (2,) on each tip along the tool's z [N]; lift: distance by which the table pushes
    the hand up [m]."""

    force: Array
    lift: float


def fingertips(gripper: GripperGeometry, position: Array, rotation: Array, opening: float) -> Array:
    """Return the centres (2, 3) of the tips of fingers 0 and 1 (at the tool's +y and -y). opening: between the
    pads [m]."""
    side = 0.5 * gripper.tip_distance(opening) * rotation[:, 1]
    return np.stack((position + side, position - side))


def touch(tips: Array, stack: Array, stiffness: Stiffness) -> Touch:
    """Compute forces and lift. tips: (2, 3) commanded positions, table frame [m]; stack: (2,) thickness of the
    cloth [m].

    Arm and tips are springs in series against a rigid table: k_arm lift = sum k_tip max(0, -z - lift). Cloth is a
    softer spring above the table. It is fully compressed at the table's height and does not lift the arm.
    """
    depth = np.maximum(-tips[:, 2], 0.0)
    both = stiffness.tip * depth.sum() / (stiffness.arm + 2.0 * stiffness.tip)
    one = stiffness.tip * depth.max() / (stiffness.arm + stiffness.tip)
    lift = float(both if both <= depth.min() else one)
    height = tips[:, 2] + lift
    on_table = stiffness.tip * np.maximum(-height, 0.0)
    in_cloth = stiffness.cloth * np.clip(stack - height, 0.0, stack)
    return Touch(on_table + in_cloth, lift)


def finger_axes(
    gripper: GripperGeometry, position: Array, rotation: Array, opening: float, floor: Array, raised: float
) -> tuple[Array, Array]:
    """Return the lower and upper ends (2, 3), (2, 3) of the capsules that represent the fingers. floor: (2,)
    lowest height that the undersides of the capsules may have [m]: soft tips cannot press the cloth through the
    table. raised: height above the tips at which the capsules begin [m]."""
    back = -rotation[:, 2]
    tips = fingertips(gripper, position, rotation, opening)
    low = tips + (gripper.finger_radius + raised) * back
    low[:, 2] = np.maximum(low[:, 2], floor + gripper.finger_radius)
    return low, tips + gripper.finger_length * back


def hand_axis(gripper: GripperGeometry, position: Array, rotation: Array) -> tuple[Array, Array]:
    """Return the ends (3,), (3,) of the capsule that represents the gripper's body."""
    back = -rotation[:, 2]
    return position + gripper.hand_from * back, position + gripper.hand_to * back
