"""Emulator of a Baxter over ROS. It serves the ports of any cell on the topics of SDK 1.2, with an openni2 camera
and tactile pads."""

from __future__ import annotations

from foldcell.robots.baxter.emulator.emulator import Emulator
from foldcell.robots.baxter.emulator.initial_state import NEW, USED, InitialState

__all__ = ["NEW", "USED", "Emulator", "InitialState"]
