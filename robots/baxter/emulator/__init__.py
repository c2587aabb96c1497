"""Emulator of a Baxter over ROS. It serves the ports of any cell on the topics of SDK 1.2, with an openni2 camera
and tactile pads."""
