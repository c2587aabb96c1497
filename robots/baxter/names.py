"""Names and ranges of Baxter's joints that the driver, the emulator and the description share."""

from __future__ import annotations

import numpy as np

from foldcell.robots.ports import Side

ARM_JOINTS = ("s0", "s1", "e0", "e1", "w0", "w1", "w2")
JOINT_NAMES = tuple(f"{side}_{joint}" for side in Side for joint in ARM_JOINTS)
FULL_SPEED = np.array([1.5, 1.5, 1.5, 1.5, 4.0, 4.0, 4.0])
"""Largest speed of one arm's joints (7,) [rad/s], as in the URDF."""
HEAD_RANGE = 1.39
"""Largest angle of the head to either side [rad]."""
