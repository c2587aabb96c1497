"""The one place where a driver is chosen: the ports of a cell, opened and closed again."""

from __future__ import annotations

import gc
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass

from cell.config.cell_settings import CellSettings
from cell.simulation import SimulatedCell, SimulationSettings, check_settings, open_simulated_cell
from cell.support.files.paths import user_cache
from cell.support.process.lock import OwnerLock
from robots.errors import ConfigurationError
from robots.model import JointLimits
from robots.ports import Attendant, Ports, Stop

__all__ = ["DRIVERS", "OpenCell", "PersonAt", "check_cell", "is_simulated", "opened_cell", "stop_circuit"]

DRIVERS = {
    "sim": "the simulated cell, as fast as it goes and the same for each seed",
    "emulator": "the simulated cell behind ROS, by the real robot's driver, in real time",
    "ros": "the robot that ROS_MASTER_URI names",
}

PersonAt = Callable[[Stop], Attendant]
"""Makes the person at a real cell, who stops waiting when the cell is stopped."""


@dataclass(frozen=True, eq=False)
class OpenCell:
    """A cell that stands open. ports: all that an executive gets. simulated: what else there is of a simulated
    one, for scorer, scripts and checkpoints; None on hardware."""

    ports: Ports
    simulated: SimulatedCell | None = None


def is_simulated(driver: str) -> bool:
    """Whether no robot stands behind it."""
    return driver != "ros"


def check_cell(driver: str, settings: SimulationSettings) -> None:
    """Raises ConfigurationError for a cell that cannot be opened; nothing is started."""
    if driver not in DRIVERS:
        raise ConfigurationError(f"there is no driver '{driver}'", f"it is one of {', '.join(DRIVERS)}")
    if driver != "sim":
        from robots.baxter.ros.messages import load_messages

        load_messages()
    if is_simulated(driver):
        check_settings(settings)


@contextmanager
def opened_cell(
    driver: str, simulation: SimulationSettings, seed: int, settings: CellSettings, person: PersonAt
) -> Iterator[OpenCell]:
    """A cell, until the end. simulation, seed: of a simulated one; person: of a real one. Raises
    ConfigurationError as `check_cell`, and when something of the cell does not answer."""
    check_cell(driver, simulation)
    with _opened(driver, simulation, seed, settings, person) as cell:
        if driver == "sim":
            yield cell
            return
        gc.collect()
        gc.freeze()  # what is loaded stays: looking through it takes 0.1 s, which is ten set-points
        try:
            yield cell
        finally:
            gc.unfreeze()


@contextmanager
def stop_circuit() -> Iterator[Stop]:
    """Of the robot alone, whatever else of the cell answers. Raises ConfigurationError: no ROS, no robot."""
    from robots.baxter.ros.connection import connected_stop

    with connected_stop() as stop:
        yield stop


@contextmanager
def _opened(
    driver: str, simulation: SimulationSettings, seed: int, settings: CellSettings, person: PersonAt
) -> Iterator[OpenCell]:
    if driver == "sim":
        with open_simulated_cell(simulation, seed) as cell:
            yield OpenCell(cell.ports, cell)
        return
    from robots.baxter.model import load_model

    limits = load_model().protective
    if driver == "emulator":
        from cell.simulation.emulator.emulated import emulated_cell

        with emulated_cell(simulation, seed, settings.ros.settings(), limits) as cell:
            yield OpenCell(cell.ports, cell)
        return
    with _robot(settings, limits, person) as ports:
        yield OpenCell(ports)


@contextmanager
def _robot(settings: CellSettings, limits: JointLimits, person: PersonAt) -> Iterator[Ports]:
    """The robot, which has one owner whatever folder the logs are in."""
    from robots.baxter.ros.connection import connected
    from robots.baxter.ros.node import master_address

    uri, host, port = master_address()
    with (
        OwnerLock(user_cache() / f"robot-{host}-{port}.lock", f"the robot of {uri}", otherwise=""),
        connected(settings.ros.settings(), limits, person, driver="ros", simulated=False) as ports,
    ):
        yield ports
