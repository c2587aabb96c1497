"""The names of the drivers. Lists of runs need no more of a driver than this."""

from __future__ import annotations

DRIVERS = {
    "sim": "the simulated cell, as fast as possible and reproducible by seed",
    "emulator": "the simulated cell behind ROS, with the real robot's driver, in real time",
    "ros": "the robot that ROS_MASTER_URI names",
}


def is_simulated(driver: str) -> bool:
    """Whether the driver runs without a robot."""
    return driver != "ros"
