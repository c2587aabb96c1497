"""Names and full speeds of Baxter's arm joints."""

from __future__ import annotations

import numpy as np

from robots.ports import Side

__all__ = ["ARM_JOINTS", "FULL_SPEED", "JOINT_NAMES"]

ARM_JOINTS = ("s0", "s1", "e0", "e1", "w0", "w1", "w2")
JOINT_NAMES = tuple(f"{side}_{joint}" for side in Side for joint in ARM_JOINTS)
FULL_SPEED = np.array([1.5, 1.5, 1.5, 1.5, 4.0, 4.0, 4.0])
"""Largest speed of one arm's joints (7,) [rad/s], as in the URDF."""
