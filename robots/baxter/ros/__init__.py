"""Baxter over ROS 1: the interface of SDK 1.2, for the driver and the emulator."""
