"""The wire format: two nodes with different message hashes do not communicate."""

from __future__ import annotations

import importlib
import io
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

from robots.baxter.ros.messages import load_messages
from robots.errors import ConfigurationError
from robots.ros import installation
from robots.ros.installation import PACKAGES, import_ros
from robots.ros.node import open_node
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


def written() -> dict[str, dict[str, Any]]:
    m = load_messages()
    stamp = m.time(7, 250_000_000)
    return {
        "end_effector_command": {"id": 65538, "command": "go", "args": "{}", "sender": "a", "sequence": 9},
        "end_effector_state": {"timestamp": stamp, "calibrated": 1, "position": 12.5, "command_sender": "b"},
        "assembly_state": {"enabled": True, "stopped": False, "estop_button": 3, "estop_source": 4},
        "joint_command": {"mode": 4, "command": [0.25, -1.5], "names": ["left_s0", "left_s1"]},
        "head_pan_command": {"target": 0.5, "speed_ratio": 0.25, "enable_pan_request": 1},
        "head_state": {"pan": -0.5, "isTurning": True},
        "tactile_state": {"header": m.header(3, stamp, "pad"), "sensors": [m.tactile_channel("tips", (0.5, 1.5))]},
    }


@ROS.required
@pytest.mark.parametrize("name", [*PUBLISHED, "tactile_state"])
def test_a_message_reads_back_as_written(name: str) -> None:
    kind, fields = getattr(load_messages(), name), written()[name]
    wire = io.BytesIO()
    kind(**fields).serialize(wire)
    read = kind().deserialize(wire.getvalue())
    for field, value in fields.items():
        heard = getattr(read, field)
        assert str(list(heard) if isinstance(value, list) else heard) == str(value)
    again = io.BytesIO()
    read.serialize(again)
    assert again.getvalue() == wire.getvalue()


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
