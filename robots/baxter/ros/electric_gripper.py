"""Baxter's electric gripper in figures: what its percentages mean."""

from __future__ import annotations

__all__ = [
    "CALIBRATE",
    "CLEAR_CALIBRATION",
    "CONFIGURE",
    "FULL_FORCE",
    "FULL_OPENING",
    "GO",
    "HARDWARE_ID",
    "RESET",
    "STOP",
]

HARDWARE_ID = 65538
FULL_OPENING = 0.0416
"""Between the pads at position 100 % [m]: twice a finger's stroke in the URDF."""
FULL_FORCE = 30.0
"""At 100 % [N] (Rethink's data sheet: about 35)."""

CALIBRATE = "calibrate"
CONFIGURE = "configure"
"""args: JSON of velocity, moving_force, holding_force, dead_zone, each 0-100."""
GO = "go"
"""args: JSON {"position": 0-100}, 0 closed. Refused until it is calibrated."""
STOP = "stop"
RESET = "reset"
"""Clears an error."""
CLEAR_CALIBRATION = "clear_calibration"
