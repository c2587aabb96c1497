"""Visual model of a robot: the meshes that a viewer loads, and the joints that the ports' values move."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from robots.ports import Side

__all__ = ["RobotVisual"]


@dataclass(frozen=True)
class RobotVisual:
    """Visual model of a robot.

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
