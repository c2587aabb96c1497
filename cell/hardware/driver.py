"""Choose the driver, open the ports of a cell and close them."""

from __future__ import annotations

import gc
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass

from foldcell.cell.config.cell_settings import CellSettings
from foldcell.cell.hardware.camera import camera_mount
from foldcell.cell.hardware.driver_names import DRIVERS, is_simulated
from foldcell.cell.hardware.robot_model import load_robot
from foldcell.cell.simulation import SimulatedCell, SimulationSettings, check_settings, open_simulated_cell
from foldcell.cell.support.files.paths import user_cache
from foldcell.cell.support.process.lock import OwnerLock
from foldcell.robots.errors import ConfigurationError
from foldcell.robots.model import JointLimits
from foldcell.robots.ports import Attendant, Ports, Stop
from foldcell.robots.registry import find_robot
from foldcell.robots.robot import Robot
from foldcell.robots.ros.driver import RosDriver

PersonAt = Callable[[Stop], Attendant]
"""Makes the attendant of a real cell. The attendant stops waiting for a person when the stop is triggered."""


@dataclass(frozen=True, eq=False)
class OpenCell:
    """An open cell. ports: the executive's only access to the cell. simulated: the simulated cell, for scorer,
    scripts and checkpoints; None on a real cell."""

    ports: Ports
    simulated: SimulatedCell | None = None


def simulation_settings(settings: CellSettings, realtime: bool, as_built: bool) -> SimulationSettings:
    """Return the settings of a simulated cell that is equipped as `settings` say. realtime: simulated time passes
    no faster than the clock; as_built: the cell differs from its drawing, and there is a calibration board."""
    return SimulationSettings(
        robot=settings.robot,
        surface=settings.surface,
        table=settings.drawn_table,
        camera=camera_mount(settings),
        pads=settings.gripper.pads,
        q_start=tuple(load_robot(settings).q_park.tolist()),
        realtime=realtime,
        as_built=as_built,
    )


def check_cell(driver: str, settings: SimulationSettings) -> None:
    """Check that a cell can be opened, without starting anything. Raises ConfigurationError."""
    if driver not in DRIVERS:
        raise ConfigurationError(f"there is no driver '{driver}'", f"it is one of {', '.join(DRIVERS)}")
    robot = find_robot(settings.robot)
    if driver != "sim":
        _driver_of(robot).check()
    if is_simulated(driver):
        check_settings(settings)


@contextmanager
def opened_cell(
    driver: str, simulation: SimulationSettings, seed: int, settings: CellSettings, person: PersonAt
) -> Iterator[OpenCell]:
    """Open a cell for the duration of the context. simulation, seed: used for a simulated cell; person: used for a
    real cell.

    Raises ConfigurationError as `check_cell` does, and if a part of the cell does not respond.
    """
    check_cell(driver, simulation)
    with _opened(driver, simulation, seed, settings, person) as cell:
        if driver == "sim":
            yield cell
            return
        gc.collect()
        gc.freeze()  # a garbage collection of all loaded objects takes 0.1 s (ten set-points)
        try:
            yield cell
        finally:
            gc.unfreeze()


@contextmanager
def stop_circuit(settings: CellSettings) -> Iterator[Stop]:
    """Connect only to the robot's stop circuit, which works even if other parts of the cell do not respond. Raises
    ConfigurationError if ROS or the robot does not respond, or if the robot has no driver."""
    with _driver_of(find_robot(settings.robot)).connect_stop() as stop:
        yield stop


def _driver_of(robot: Robot) -> RosDriver:
    if robot.driver is None:
        raise ConfigurationError(
            f"the robot '{robot.name}' has no driver: it exists only in simulation", "use --driver sim"
        )
    return robot.driver


@contextmanager
def _opened(
    driver: str, simulation: SimulationSettings, seed: int, settings: CellSettings, person: PersonAt
) -> Iterator[OpenCell]:
    if driver == "sim":
        with open_simulated_cell(simulation, seed) as cell:
            yield OpenCell(cell.ports, cell)
        return
    robot = find_robot(settings.robot)
    limits = robot.load_model().protective
    if driver == "emulator":
        from foldcell.cell.simulation.emulator.emulated import emulated_cell

        ros, network = settings.ros.settings(), settings.network.settings()
        with emulated_cell(simulation, seed, _driver_of(robot), ros, network, limits) as cell:
            yield OpenCell(cell.ports, cell)
        return
    with _real(robot, settings, limits, person) as ports:
        yield OpenCell(ports)


@contextmanager
def _real(robot: Robot, settings: CellSettings, limits: JointLimits, person: PersonAt) -> Iterator[Ports]:
    """Open the robot's ports. There is one lock per robot, so that runs with different log folders also exclude
    each other."""
    from foldcell.robots.ros.node import master_address

    connect = _driver_of(robot).connect
    uri, host, port = master_address()
    with (
        OwnerLock(user_cache() / f"robot-{host}-{port}.lock", f"the robot of {uri}", otherwise=""),
        connect(settings.ros.settings(), limits, person, driver="ros", simulated=False) as ports,
    ):
        yield ports
