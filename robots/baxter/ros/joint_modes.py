"""Modes of a JointCommand."""

from __future__ import annotations

__all__ = ["POSITION", "RAW_POSITION", "TORQUE", "VELOCITY"]

POSITION = 1
"""Joint angles, with the robot's own collision avoidance and its speed limit (`topics.speed_ratio`)."""
VELOCITY = 2
TORQUE = 3
RAW_POSITION = 4
"""Joint angles, without the robot's own collision avoidance, speed limit and filter."""
