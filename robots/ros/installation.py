"""Import of ROS 1's Python modules. No package index has them. Linux distributions install them for the system
Python."""

from __future__ import annotations

import importlib
import sys
from pathlib import Path
from types import ModuleType

from foldcell.robots.errors import ConfigurationError

FOLDERS = (Path("/opt/ros/noetic/lib/python3/dist-packages"), Path("/usr/lib/python3/dist-packages"))
"""Possible folders of the installation: ROS's own distribution, then the packages of Debian and Ubuntu."""

PACKAGES = "python3-rospy python3-rosmaster python3-sensor-msgs python3-rosgraph-msgs python3-trajectory-msgs"
"""The required packages of Debian and Ubuntu."""


def find_ros() -> Path | None:
    """Return the folder that contains rospy, or None."""
    on_path = (Path(entry) for entry in sys.path if entry)
    return next((folder for folder in (*on_path, *FOLDERS) if (folder / "rospy").is_dir()), None)


def import_ros(name: str = "rospy") -> ModuleType:
    """Import a module of ROS. Raises ConfigurationError if it is not installed.

    Its folder is added at the end of sys.path, so that its modules never replace this program's own packages.
    """
    folder = find_ros()
    if folder is not None and str(folder) not in sys.path:
        sys.path.append(str(folder))
    try:
        return importlib.import_module(name)
    except ImportError as error:
        raise ConfigurationError(
            f"ROS 1 is not installed: {error}",
            f"on Debian and Ubuntu: apt-get install {PACKAGES}; elsewhere add ROS's Python folder to PYTHONPATH",
        ) from error
