"""A Baxter for whoever asks over ROS: any cell's ports served on the topics of its SDK 1.2, with an openni2
camera and the cells of its pads."""

from __future__ import annotations

from robots.baxter.emulator.emulator import Emulator
from robots.baxter.emulator.initial_state import NEW, USED, InitialState

__all__ = ["NEW", "USED", "Emulator", "InitialState"]
