"""The registry of robots: the folders of `robots/`, and the entry points of installed packages.

A folder with a module `robot.py` is a robot of the folder's name. A package adds another by an entry point:

    [project.entry-points."foldcell.robots"]
    my_robot = "my_package.robot:ROBOT"

In both cases ROBOT is a `foldcell.robots.robot.Robot`. Nothing is imported before a robot is asked for.
"""

from __future__ import annotations

import difflib
import importlib
import pkgutil
import sys
from collections.abc import Callable, Iterable
from functools import lru_cache
from importlib.metadata import EntryPoint, entry_points

from foldcell import robots
from foldcell.robots.errors import ConfigurationError
from foldcell.robots.robot import Robot

GROUP = "foldcell.robots"
"""Group of the entry points."""
DEFAULT = "baxter"
"""The robot of the shipped settings."""


def list_robots() -> tuple[str, ...]:
    """Return the names of all known robots, sorted. Imports none of them."""
    return tuple(sorted(_known()))


def find_robot(name: str) -> Robot:
    """Return a robot by its name. Raises ConfigurationError, which lists the known robots, if there is none of
    this name, if several packages bring one, or if it cannot be loaded."""
    known = _known()
    if name not in known:
        near = difflib.get_close_matches(name, known, 1)
        raise ConfigurationError(
            f"there is no robot '{name}'; known are {', '.join(sorted(known))}",
            (f"did you mean '{near[0]}'? " if near else "")
            + f"another robot comes with a package that has an entry point in the group {GROUP}",
            robot=name,
        )
    entries = known[name]
    if len(entries) > 1:
        raise ConfigurationError(
            f"the robot '{name}' is brought more than once: {', '.join(entry.value for entry in entries)}",
            "uninstall all packages but one that bring it, or rename it in one of them",
            robot=name,
        )
    (entry,) = entries
    return _load(entry)


def _known() -> dict[str, list[EntryPoint]]:
    """Return name -> the entry points that bring a robot of this name. A built-in folder counts as one."""
    known: dict[str, list[EntryPoint]] = {}
    for entry in (*_built_in(tuple(robots.__path__)), *_brought(entry_points, tuple(sys.path))):
        others = known.setdefault(entry.name, [])
        if entry.value not in [other.value for other in others]:  # a package may be found twice on the path
            others.append(entry)
    return known


@lru_cache(maxsize=4)
def _built_in(path: tuple[str, ...]) -> tuple[EntryPoint, ...]:
    """Return the robots whose folders are on `path`."""
    return tuple(
        EntryPoint(info.name, f"foldcell.robots.{info.name}.robot:ROBOT", GROUP)
        for info in pkgutil.iter_modules(path)
        if info.ispkg and any(m.name == "robot" for m in pkgutil.iter_modules([f"{p}/{info.name}" for p in path]))
    )


@lru_cache(maxsize=4)
def _brought(find: Callable[..., Iterable[EntryPoint]], path: tuple[str, ...]) -> tuple[EntryPoint, ...]:
    """Return the entry points of the packages on `path`. A run looks for its robot many times, and a search reads
    the lists of all installed packages."""
    return tuple(find(group=GROUP))


def _load(entry: EntryPoint) -> Robot:
    module, _, attribute = entry.value.partition(":")
    try:
        robot = getattr(importlib.import_module(module), attribute)
    except Exception as error:  # the code of another package
        raise ConfigurationError(
            f"the robot '{entry.name}' ({entry.value}) cannot be loaded: {type(error).__name__}: {error}",
            "repair the package that brings it, or choose another robot in cell.yaml",
            robot=entry.name,
        ) from error
    if not isinstance(robot, Robot) or robot.name != entry.name:
        what = f"a robot named '{robot.name}'" if isinstance(robot, Robot) else f"a {type(robot).__name__}"
        raise ConfigurationError(
            f"the entry point '{entry.name}' ({entry.value}) is {what}, not a robot of this name",
            "it has to name a foldcell.robots.robot.Robot whose name is that of the entry point",
            robot=entry.name,
        )
    return robot
