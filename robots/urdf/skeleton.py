"""The skeleton of a package that brings a robot: its files, from templates."""

from __future__ import annotations

import importlib.util
import keyword
import re
from pathlib import Path
from string import Template

from foldcell.robots.errors import ConfigurationError

TEMPLATES = Path(__file__).with_name("templates")
FILES = {
    "pyproject.toml": "pyproject.toml.txt",
    "README.md": "README.md.txt",
    "cell.yaml": "cell.yaml.txt",
    "$name/__init__.py": None,
    "$name/robot.py": "robot.py.txt",
    "$name/driver.py": "driver.py.txt",
    "$name/robot.urdf": "robot.urdf",
    "tests/test_robot.py": "test_robot.py.txt",
}
"""Path in the package -> its template; None for an empty file."""


def skeleton_files(name: str) -> dict[str, str]:
    """Return path -> text of the files of a new robot's package. Raises ConfigurationError for a name that no new
    package can have."""
    if not re.fullmatch(r"[a-z][a-z0-9_]{1,40}", name) or keyword.iskeyword(name):
        raise ConfigurationError(
            f"'{name}' is no name for a robot's package",
            "use small letters, digits and underscores, beginning with a letter",
        )
    if importlib.util.find_spec(name) is not None:
        raise ConfigurationError(f"there is already a package '{name}' here", "choose another name")
    return {
        Template(path).substitute(name=name): _text(template, name) if template else ""
        for path, template in FILES.items()
    }


def _text(template: str, name: str) -> str:
    return Template((TEMPLATES / template).read_text(encoding="utf-8")).substitute(name=name)
