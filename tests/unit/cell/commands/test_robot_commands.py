"""`foldcell robot`: a new robot's package is found, fits the cell and works in it as it was written."""

from __future__ import annotations

import importlib
import json
import re
import sys
import tomllib
from collections.abc import Iterator
from importlib.metadata import EntryPoint
from pathlib import Path
from xml.etree import ElementTree

import pytest

from foldcell.cell.commands.main import main
from foldcell.cell.config.cell_settings import load_settings
from foldcell.cell.hardware.contract.clauses import CLAUSES
from foldcell.robots import registry
from foldcell.robots.errors import ConfigurationError
from foldcell.robots.registry import GROUP, find_robot, list_robots
from foldcell.robots.urdf.skeleton import skeleton_files

NAME = "two_box_arms"
ROOT = Path(__file__).resolve().parents[4]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    parent = tmp_path_factory.mktemp("packages")
    assert main(["robot", "new", NAME, "--into", str(parent)]) == 0
    return parent / NAME


@pytest.fixture
def installed(folder: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """The package as `pip install -e` makes it known: on the path, with the entry points of its pyproject.toml."""
    project = tomllib.loads((folder / "pyproject.toml").read_text())["project"]
    entries = [EntryPoint(name, value, GROUP) for name, value in project["entry-points"][GROUP].items()]
    monkeypatch.setattr(registry, "entry_points", lambda group: [e for e in entries if e.group == group])
    monkeypatch.syspath_prepend(str(folder))
    importlib.invalidate_caches()
    yield folder
    for module in [name for name in sys.modules if name.split(".")[0] == NAME]:
        del sys.modules[module]


def answer(capsys: pytest.CaptureFixture[str]) -> dict:
    return json.loads(capsys.readouterr().out.splitlines()[-1])


def test_the_files_name_the_robot_and_have_no_gaps(folder: Path) -> None:
    written = {str(path.relative_to(folder)) for path in folder.rglob("*") if path.is_file()}
    assert written == set(skeleton_files(NAME))
    for path in written:
        text = (folder / path).read_text()
        assert "$" not in text, path
        assert NAME in text or path.endswith("__init__.py"), path


def test_the_new_robot_is_found_and_fits_the_cell(installed: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert NAME in list_robots()
    assert load_settings(installed / "cell.yaml").robot == NAME
    assert main(["robot", "list", "--json"]) == 0
    (row,) = [robot for robot in answer(capsys)["robots"] if robot["name"] == NAME]
    assert row == {"name": NAME, "title": NAME, "arm_joints": 6, "drivers": "sim"}
    assert main(["robot", "check", NAME, "--json"]) == 0
    assert answer(capsys)["good"] is True


def test_the_driver_of_the_skeleton_keeps_the_contract(
    installed: Path, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    junit = tmp_path / "driver.xml"
    command = ["robot", "check", NAME, "--driver", f"{NAME}.driver:connect", "--junit", str(junit)]
    assert main([*command, "--json"]) == 0
    states = {clause["name"]: clause["state"] for clause in answer(capsys)["clauses"]}
    assert set(states) == {clause.name for clause in CLAUSES}
    assert {name for name, state in states.items() if state != "passed"} == {"stale state"}
    suite = ElementTree.parse(junit).getroot()
    assert (suite.get("tests"), suite.get("failures"), suite.get("skipped")) == (str(len(CLAUSES)), "0", "1")


def test_the_documented_driver_is_that_of_the_skeleton(folder: Path) -> None:
    (example,) = re.findall(r"```python\n(.*?)```", (ROOT / "docs/do/another_robot.md").read_text(), re.S)
    written = (folder / NAME / "driver.py").read_text().replace(NAME, "my_robot")
    assert [line for line in example.splitlines() if line not in written.splitlines()] == []


@pytest.mark.parametrize(
    ("driver", "why"),
    [
        ("rso", ""),
        ("no_such_package:connect", "ModuleNotFoundError"),
        ("json:connect", "AttributeError"),
        ("time:time", "TypeError"),
        ("builtins:repr", "does not support the context manager protocol"),
        ("contextlib:nullcontext", "it yields JointLimits, not Ports"),
    ],
)
def test_a_driver_that_cannot_be_opened_is_refused(
    driver: str, why: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["robot", "check", "ur5_pair", "--driver", driver]) == 64
    said = capsys.readouterr().err
    assert driver in said and why in said


def test_its_own_tests_pass(installed: Path) -> None:
    assert pytest.main(["-q", "-p", "no:cacheprovider", "-p", "no:xdist", str(installed / "tests")]) == 0


def test_a_robot_that_does_not_fit_is_reported(
    installed: Path, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    (tmp_path / "cell.yaml").write_text("table: {x: [0.20, 1.10], y: [-0.75, 0.75], height: 0.35}\n")
    assert main(["robot", "check", NAME, "--cell", str(tmp_path / "cell.yaml"), "--json"]) == 2
    bad = {finding["name"] for finding in answer(capsys)["findings"] if not finding["good"]}
    assert "parked arms" in bad


def test_a_robot_whose_urdf_lacks_a_joint_is_refused_with_its_name(installed: Path) -> None:
    robot = installed / NAME / "robot.py"
    text = robot.read_text()
    robot.write_text(text.replace('f"{side}_joint_{k}"', 'f"{side}_axis_{k}"'))
    try:
        with pytest.raises(ConfigurationError, match="left_axis_1"):
            find_robot(NAME).load_model()
    finally:
        robot.write_text(text)


@pytest.mark.parametrize("name", ["My_robot", "1arm", "class", "numpy", "../away", "x"])
def test_a_name_that_no_package_can_have_is_refused(name: str, tmp_path: Path) -> None:
    assert main(["robot", "new", name, "--into", str(tmp_path)]) == 64
    assert list(tmp_path.iterdir()) == []


def test_an_existing_folder_is_left_as_it_is(tmp_path: Path) -> None:
    (tmp_path / NAME).mkdir()
    assert main(["robot", "new", NAME, "--into", str(tmp_path)]) == 64
    assert list((tmp_path / NAME).iterdir()) == []
