"""Constants of Baxter's electric gripper: its commands and the meaning of its percentages."""

from __future__ import annotations

HARDWARE_ID = 65538
FULL_OPENING = 0.0416
"""Opening at position 100 % [m]: twice a finger's stroke in the URDF."""
FULL_FORCE = 30.0
"""Force at 100 % [N]. Rethink's data sheet states about 35 N."""

CALIBRATE = "calibrate"
CONFIGURE = "configure"
"""Command that sets the gripper's parameters. The message's `args` field is a JSON object with the keys of
PARAMETERS."""
PARAMETERS = {"velocity": 50.0, "moving_force": 40.0, "holding_force": 30.0, "dead_zone": 5.0}
"""The gripper's parameters with the SDK's default values [%]."""
GO = "go"
"""Command that moves the pads. The message's `args` field is a JSON object {"position": p}, with p from 0
(closed) to 100. The gripper refuses the command until it is calibrated."""
STOP = "stop"
RESET = "reset"
"""Command that clears an error."""
CLEAR_CALIBRATION = "clear_calibration"
