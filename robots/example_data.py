"""The robot descriptions of the wheel `example-robot-data`."""

from __future__ import annotations

from importlib.metadata import PackageNotFoundError, distribution
from pathlib import Path

from foldcell.robots.errors import ConfigurationError


def package_root() -> Path:
    """Return the folder that contains the package `example-robot-data` of the URDFs' `package://` URIs. Raises
    ConfigurationError if the wheel is not installed."""
    try:
        wheel = distribution("example-robot-data")
    except PackageNotFoundError as error:
        raise ConfigurationError("the robot's model is not installed", "pip install example-robot-data") from error
    return Path(str(wheel.locate_file("cmeel.prefix"))) / "share"


def read_description(path: Path) -> str:
    """Return the text of a file of the wheel. Raises ConfigurationError if it is missing."""
    try:
        return path.read_text(encoding="utf-8")
    except OSError as error:
        raise ConfigurationError(f"no file {path}", "pip install --force-reinstall example-robot-data") from error
