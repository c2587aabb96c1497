"""Constants of Baxter's electric gripper: its commands and the meaning of its percentages."""

from __future__ import annotations

__all__ = [
    "CALIBRATE",
    "CLEAR_CALIBRATION",
    "CONFIGURE",
    "FULL_FORCE",
    "FULL_OPENING",
    "GO",
    "HARDWARE_ID",
    "PARAMETERS",
    "RESET",
    "STOP",
]

HARDWARE_ID = 65538
FULL_OPENING = 0.0416
"""Opening at position 100 % [m]: twice a finger's stroke in the URDF."""
FULL_FORCE = 30.0
"""Force at 100 % [N]. Rethink's data sheet states about 35 N."""

CALIBRATE = "calibrate"
CONFIGURE = "configure"
"""args: JSON of PARAMETERS."""
PARAMETERS = {"velocity": 50.0, "moving_force": 40.0, "holding_force": 30.0, "dead_zone": 5.0}
"""Parameters with the SDK's defaults [%]."""
GO = "go"
"""args: JSON {"position": 0-100}, where 0 is closed. The gripper refuses it until it is calibrated."""
STOP = "stop"
RESET = "reset"
"""Clears an error."""
CLEAR_CALIBRATION = "clear_calibration"
