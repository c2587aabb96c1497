"""How a robot is drawn: the model that a viewer loads, and which of its joints the ports' values move."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from robots.ports import Side

__all__ = ["RobotVisual"]


@dataclass(frozen=True)
class RobotVisual:
    """A robot for the eye only.

    urdf: a file whose meshes a viewer can load. joint_names: the URDF's names of the 14 joints, in the
    order of `JointState.q`. head_joint: moved by `JointState.head_pan`, None when the head is fixed.
    finger_joints: per side (joint name, travel [m] per metre of opening), signed as the URDF's axes. floor: its
    height in the base frame [m].
    """

    urdf: Path
    joint_names: tuple[str, ...]
    head_joint: str | None
    finger_joints: Mapping[Side, tuple[tuple[str, float], ...]]
    floor: float
