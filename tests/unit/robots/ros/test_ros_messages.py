"""The wire format: two nodes with different message hashes do not communicate."""

from __future__ import annotations

import importlib
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

from foldcell.robots.baxter.ros.messages import load_messages
from foldcell.robots.errors import ConfigurationError
from foldcell.robots.ros import installation
from foldcell.robots.ros.installation import PACKAGES, import_ros
from foldcell.robots.ros.node import open_node
from tests.optional_parts import ROS

PUBLISHED = {
    "end_effector_command": "c003234e90416f2ca02ac7837c42cbb7",
    "end_effector_state": "ade777f069d738595bc19e246b8ec7a0",
    "assembly_state": "356d9dd237ce73b2667da9235f541933",
    "joint_command": "19bfec8434dd568ab3c633d187c36f2e",
    "head_pan_command": "23b8a3f4b7ee9de7099d029e57660a8c",
    "head_state": "71c43b264307205358e7e49be5601348",
}


@ROS.required
@pytest.mark.parametrize("name", PUBLISHED)
def test_baxters_messages_have_the_published_hashes(name: str) -> None:
    assert getattr(load_messages(), name)._md5sum == PUBLISHED[name]


@ROS.required
@pytest.mark.parametrize("name", ["end_effector_command", "end_effector_state", "joint_command", "assembly_state"])
def test_the_messages_have_baxters_type_names(name: str) -> None:
    words = "".join(word.capitalize() for word in name.split("_"))
    assert getattr(load_messages(), name)._type == f"baxter_core_msgs/{words}"


@pytest.fixture
def no_ros(monkeypatch: pytest.MonkeyPatch) -> None:
    really = importlib.import_module

    def absent(name: str, package: str | None = None) -> ModuleType:
        if name.split(".")[0] in {"rospy", "genpy", "sensor_msgs", "std_msgs"}:
            raise ImportError(f"No module named '{name}'")
        return really(name, package)

    monkeypatch.setattr(installation, "FOLDERS", (Path("/nowhere"),))
    monkeypatch.setattr(importlib, "import_module", absent)


@pytest.mark.usefixtures("no_ros")
@pytest.mark.parametrize("need", [import_ros, load_messages.__wrapped__, lambda: open_node("anybody")])
def test_a_missing_ros_is_reported_with_its_packages(need: Any) -> None:
    with pytest.raises(ConfigurationError, match="ROS 1 is not installed") as caught:
        need()
    assert PACKAGES in caught.value.hint


def test_ros_comes_last_on_the_path(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "rospy").mkdir()
    (tmp_path / "only_here.py").write_text("answer = 42\n")
    own = [entry for entry in installation.sys.path if not (Path(entry) / "rospy").is_dir()]
    monkeypatch.setattr(installation.sys, "path", list(own))
    monkeypatch.setattr(installation, "FOLDERS", (tmp_path,))
    assert import_ros("only_here").answer == 42
    assert installation.sys.path == [*own, str(tmp_path)]
    assert import_ros("only_here").answer == 42 and installation.sys.path.count(str(tmp_path)) == 1
    installation.sys.modules.pop("only_here")
