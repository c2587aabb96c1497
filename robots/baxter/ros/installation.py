"""ROS 1's Python, which no package index carries: a distribution installs it beside the system's own Python."""

from __future__ import annotations

import importlib
import sys
from pathlib import Path
from types import ModuleType

from robots.errors import ConfigurationError

__all__ = ["PACKAGES", "find_ros", "import_ros"]

FOLDERS = (Path("/opt/ros/noetic/lib/python3/dist-packages"), Path("/usr/lib/python3/dist-packages"))
"""Where distributions put it: that of ROS itself, then Debian's and Ubuntu's own packages."""

PACKAGES = "python3-rospy python3-rosmaster python3-sensor-msgs python3-rosgraph-msgs python3-trajectory-msgs"
"""What Debian and Ubuntu call what is needed here."""


def find_ros() -> Path | None:
    """The folder with rospy, None where there is none."""
    shown = (Path(entry) for entry in sys.path if entry)
    return next((folder for folder in (*shown, *FOLDERS) if (folder / "rospy").is_dir()), None)


def import_ros(name: str = "rospy") -> ModuleType:
    """A module of ROS. Raises ConfigurationError where it is not installed.

    The folder goes to the end of the path: what this program brings along is never replaced by a system's copy.
    """
    folder = find_ros()
    if folder is not None and str(folder) not in sys.path:
        sys.path.append(str(folder))
    try:
        return importlib.import_module(name)
    except ImportError as error:
        raise ConfigurationError(
            f"ROS 1 is not installed: {error}",
            f"on Debian and Ubuntu: apt-get install {PACKAGES}; elsewhere have ROS's Python on PYTHONPATH",
        ) from error
