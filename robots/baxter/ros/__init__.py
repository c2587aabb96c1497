"""Baxter over ROS 1: the interface of its SDK 1.2, as the driver and the emulator both speak it."""
