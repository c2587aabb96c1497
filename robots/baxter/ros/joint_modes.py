"""What the figures of a JointCommand are: its mode."""

from __future__ import annotations

__all__ = ["POSITION", "RAW_POSITION", "TORQUE", "VELOCITY"]

POSITION = 1
"""Angles, with the robot's own collision avoidance and its limit of speed (`topics.speed_ratio`)."""
VELOCITY = 2
TORQUE = 3
RAW_POSITION = 4
"""Angles, without either and with the robot's filter off."""
