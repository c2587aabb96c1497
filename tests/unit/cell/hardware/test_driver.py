"""The available drivers, and the checks before one is opened."""

from __future__ import annotations

import pytest

from foldcell.cell.hardware.driver import check_cell
from foldcell.cell.hardware.driver_names import DRIVERS, is_simulated
from foldcell.cell.simulation import SimulationSettings
from foldcell.robots.baxter.ros import messages
from foldcell.robots.errors import ConfigurationError
from foldcell.robots.ros import installation

TOWEL = SimulationSettings(garment="small_towel")


def test_an_unknown_driver_is_refused() -> None:
    with pytest.raises(ConfigurationError, match="no driver 'rso'") as e:
        check_cell("rso", TOWEL)
    assert all(name in e.value.hint for name in DRIVERS)


@pytest.mark.parametrize("name", ["ros", "emulator"])
def test_ros_drivers_without_ros_name_the_packages_to_install(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    def missing(module: str = "rospy") -> None:
        raise ConfigurationError(f"no {module}", "install it")

    messages.load_messages.cache_clear()
    monkeypatch.setattr(messages, "import_ros", missing)
    with pytest.raises(ConfigurationError, match="no sensor_msgs"):
        check_cell(name, TOWEL)
    check_cell("sim", TOWEL)


def test_every_driver_except_ros_is_a_simulation() -> None:
    assert [name for name in DRIVERS if not is_simulated(name)] == ["ros"]


def test_simulated_drivers_refuse_an_unknown_garment() -> None:
    wrong = SimulationSettings(garment="no_such_thing")
    with pytest.raises(ConfigurationError):
        check_cell("sim", wrong)
    if installation.find_ros() is not None:
        check_cell("ros", wrong)  # a real cell does not check the garment's name
