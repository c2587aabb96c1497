"""The registry finds built-in robots and those of other packages, and says what is wrong with one."""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import replace
from importlib.metadata import EntryPoint
from pathlib import Path
from types import ModuleType

import pytest

from foldcell.cell.config.cell_settings import load_settings
from foldcell.cell.hardware.driver import check_cell, stop_circuit
from foldcell.cell.hardware.robot_model import load_robot
from foldcell.cell.simulation import SimulationSettings
from foldcell.robots import registry
from foldcell.robots.baxter.robot import ROBOT
from foldcell.robots.errors import ConfigurationError
from foldcell.robots.registry import DEFAULT, GROUP, find_robot, list_robots

ROOT = Path(__file__).resolve().parents[3]
Bring = Callable[[str, object], None]


@pytest.fixture
def bring(monkeypatch: pytest.MonkeyPatch) -> Bring:
    """Add an entry point `name` whose package contains `value`, as if the package were installed."""
    brought: list[EntryPoint] = []
    monkeypatch.setattr(registry, "entry_points", lambda group: [e for e in brought if e.group == group])

    def add(name: str, value: object) -> None:
        module = ModuleType(f"package_{len(brought)}_of_{name}")
        module.ROBOT = value  # type: ignore[attr-defined]
        monkeypatch.setitem(sys.modules, module.__name__, module)
        brought.append(EntryPoint(name, f"{module.__name__}:ROBOT", GROUP))

    return add


def test_the_folders_with_a_robot_are_known() -> None:
    with_robot = {path.parent.name for path in (ROOT / "robots").glob("*/robot.py")}
    assert set(list_robots()) == with_robot
    for name in with_robot:
        robot = find_robot(name)
        assert robot.name == name and robot.load_model() is robot.load_model()


def test_the_shipped_settings_name_the_default_robot() -> None:
    assert load_settings().robot == SimulationSettings().robot == DEFAULT


def test_a_package_brings_a_robot_by_an_entry_point(bring: Bring, tmp_path: Path) -> None:
    other = replace(ROBOT, name="their_robot", driver=None)
    bring("their_robot", other)
    assert "their_robot" in list_robots() and find_robot("their_robot") is other
    (tmp_path / "cell.yaml").write_text("robot: their_robot\n")
    settings = load_settings(tmp_path / "cell.yaml")
    assert load_robot(settings) is other.load_model()
    simulated = SimulationSettings(robot="their_robot", garment="small_towel")
    check_cell("sim", simulated)
    for driver in ("ros", "emulator"):
        with pytest.raises(ConfigurationError, match="only in simulation"):
            check_cell(driver, simulated)
    with pytest.raises(ConfigurationError, match="only in simulation"), stop_circuit(settings):
        pass


def test_an_unknown_robot_is_refused_with_the_known_ones(bring: Bring) -> None:
    bring("their_robot", ROBOT)
    with pytest.raises(ConfigurationError, match=r"known are .*their_robot") as e:
        find_robot("bakster")
    assert "'baxter'" in e.value.hint and GROUP in e.value.hint


@pytest.mark.parametrize(("value", "what"), [(ROBOT, "named 'baxter'"), ("a text", "a str")])
def test_an_entry_point_that_is_no_such_robot_is_refused(bring: Bring, value: object, what: str) -> None:
    bring("their_robot", value)
    with pytest.raises(ConfigurationError, match=what):
        find_robot("their_robot")


def test_a_package_that_cannot_be_imported_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    entry = EntryPoint("their_robot", "no_such_package.robot:ROBOT", GROUP)
    monkeypatch.setattr(registry, "entry_points", lambda group: [entry])
    with pytest.raises(ConfigurationError, match=r"no_such_package\.robot:ROBOT.*ModuleNotFoundError"):
        find_robot("their_robot")


def test_two_packages_with_the_same_robot_are_refused(bring: Bring) -> None:
    bring("baxter", ROBOT)
    with pytest.raises(ConfigurationError, match=r"robots\.baxter\.robot:ROBOT, package_0_of_baxter:ROBOT"):
        find_robot("baxter")


def test_no_file_outside_robots_names_a_robot() -> None:
    """Benchmarks and tests measure and test certain robots, and noise.yaml names the sources of its figures."""
    robots = list_robots()
    for package in ("foldcell", "cell", "calibration", "skills"):
        for path in (ROOT / package).rglob("*"):
            if path.suffix in (".py", ".html"):
                text = path.read_text(encoding="utf-8").lower()
                assert not [name for name in robots if name in text], path
