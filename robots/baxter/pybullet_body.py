"""Baxter's body in a PyBullet world."""

from __future__ import annotations

import xml.etree.ElementTree as ET

from robots.baxter.camera_mount import MOUNT
from robots.baxter.gripper import GRIPPER
from robots.baxter.model import JOINT_NAMES
from robots.baxter.pybullet_files import moving_urdf, srdf_disabled_pairs
from robots.bullet.body import BodyDescription, BulletBody
from robots.ports import Side

__all__ = ["load_body"]

ARM_EFFORT = 150.0
"""Motor torque of the arm joints [Nm]. The URDF has 50 Nm, without the springs at S1 that support the upper arm.
With 50 Nm the arm would sag by 0.23 rad."""


def load_body(client: int) -> BulletBody:
    """Load Baxter into the PyBullet world `client`. Raises StorageError if its files cannot be cached."""
    urdf = moving_urdf()
    links = [link.attrib["name"] for link in ET.parse(urdf).getroot().iter("link")]
    return BulletBody(
        client,
        BodyDescription(
            urdf=urdf,
            joint_names=JOINT_NAMES,
            head_joint=MOUNT.head_joint,
            gripper=GRIPPER,
            tool_links={side: f"{side}_gripper" for side in Side},
            disabled_pairs=srdf_disabled_pairs(),
            fingers=[link for link in links if "finger" in link],
            efforts=(ARM_EFFORT,) * len(JOINT_NAMES),
        ),
    )
