"""Optional parts that some tests need, and the rule by which their tests may be skipped."""

from __future__ import annotations

import importlib.util
import os
import shutil
import sys
from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path

import pytest

from foldcell.robots.ros.installation import PACKAGES, find_ros

ALLOWED_SKIPS = "FOLDCELL_ALLOWED_SKIPS"
"""Environment variable: comma-separated names of the parts whose tests may be skipped. If the variable is set,
even to an empty value, every other skip is a failure. If it is not set, every skip is allowed."""


@dataclass(frozen=True)
class OptionalPart:
    """name: the name in skip reasons and in ALLOWED_SKIPS. install: the command that installs the part."""

    name: str
    present: bool
    install: str

    @property
    def reason(self) -> str:
        return f"needs {self.name}"

    @property
    def required(self) -> pytest.MarkDecorator:
        """Mark for tests that need the part."""
        return pytest.mark.skipif(not self.present, reason=self.reason)

    def require(self) -> None:
        """Skip the current test if the part is missing. Also works from a fixture."""
        if not self.present:
            pytest.skip(self.reason)


def program(*names: str, path: str | None = None) -> bool:
    return any(shutil.which(name, path=path) for name in names)


ROS_PATH = os.pathsep.join((os.environ.get("PATH", os.defpath), "/opt/ros/noetic/bin"))
ROS = OptionalPart(
    "ROS", find_ros() is not None and program("rosmaster", path=ROS_PATH), f"apt-get install {PACKAGES}"
)
BROWSER = OptionalPart(
    "browser", program("chromium", "chromium-browser", "google-chrome"), "apt-get install chromium"
)
MUJOCO = OptionalPart(
    "mujoco", importlib.util.find_spec("mujoco") is not None, 'pip install -c constraints.txt -e ".[peers]"'
)
BUILD = OptionalPart("build", importlib.util.find_spec("build") is not None, "make setup-dev")
GIT = OptionalPart("git", (Path(__file__).parents[1] / ".git").exists() and program("git"), "git clone")
PANDAS = OptionalPart("pandas", importlib.util.find_spec("pandas") is not None, "make setup-dev")
SITE_PROGRAM = shutil.which(
    "zensical", path=os.pathsep.join((str(Path(sys.executable).parent), os.environ.get("PATH", "")))
)
SITE = OptionalPart("zensical", SITE_PROGRAM is not None, "make site")
PARTS = (ROS, BROWSER, MUJOCO, BUILD, GIT, PANDAS, SITE)


def may_be_skipped(reason: str, environment: Mapping[str, str] = os.environ) -> bool:
    """Whether a test may be skipped for this reason."""
    allowed = environment.get(ALLOWED_SKIPS)
    if allowed is None:
        return True
    names = {name.strip() for name in allowed.split(",")}
    return any(part.reason == reason and part.name in names for part in PARTS)


def skip_summary(reasons: Iterable[str]) -> str:
    """One line: the number of skipped tests for each reason, and the command that installs the part."""
    install = {part.reason: f": {part.install}" for part in PARTS}
    counts = Counter(reasons).most_common()
    told = [f"{n} {'test' if n == 1 else 'tests'} ({why}{install.get(why, '')})" for why, n in counts]
    return f"left out: {', '.join(told)}" if told else ""
