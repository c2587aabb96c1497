"""Open the driver under test: a driver of foldcell, or the factory of another package."""

from __future__ import annotations

import importlib
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, ExitStack, contextmanager, suppress
from typing import NoReturn

from foldcell.cell.config.cell_settings import CellSettings
from foldcell.cell.hardware.camera import camera_calibration
from foldcell.cell.hardware.contract.rig import Rig
from foldcell.cell.hardware.driver import OpenCell, opened_cell, simulation_settings
from foldcell.cell.hardware.driver_names import DRIVERS
from foldcell.cell.hardware.robot_model import load_robot
from foldcell.cell.simulation import Fault, FaultKind
from foldcell.robots.errors import CellError, ConfigurationError
from foldcell.robots.model import JointLimits
from foldcell.robots.ports import BoardPlace, Ports
from foldcell.robots.registry import find_robot
from foldcell.skills.motion.validation.collision import CollisionChecker

Factory = Callable[[JointLimits], AbstractContextManager[Ports]]
"""Opens a driver. Its set-points are clipped to the limits."""


@contextmanager
def opened_rig(driver: str, settings: CellSettings, ended: Callable[[], bool] = lambda: False) -> Iterator[Rig]:
    """Open a driver. driver: a name of `DRIVERS`, or MODULE:FACTORY. ended: see Rig. Raises ConfigurationError."""
    with _opened(driver, settings, load_robot(settings).protective) as cell:
        yield rig_of(cell, settings, ended)


def rig_of(cell: OpenCell, settings: CellSettings, ended: Callable[[], bool]) -> Rig:
    model = load_robot(settings)
    return Rig(
        cell.ports,
        model,
        CollisionChecker(model, settings.table),
        camera_calibration(settings),
        settings.table,
        find_robot(settings.robot).simulation.head_range,
        None if cell.simulated is None else _interruption(cell),
        ended,
    )


@contextmanager
def _opened(driver: str, settings: CellSettings, limits: JointLimits) -> Iterator[OpenCell]:
    if driver in DRIVERS:
        simulation = simulation_settings(settings, realtime=False, as_built=False)
        with opened_cell(driver, simulation, 0, settings, lambda stop: _Nobody()) as cell:
            yield cell
        return
    module, colon, name = driver.partition(":")
    if not colon:
        raise ConfigurationError(
            f"there is no driver '{driver}'", f"it is one of {', '.join(DRIVERS)}, or MODULE:FACTORY"
        )
    closing = ExitStack()
    try:
        with _others_code(driver):
            factory: Factory = getattr(importlib.import_module(module), name)
            ports = closing.enter_context(factory(limits))
            if not isinstance(ports, Ports):
                raise TypeError(f"it yields {type(ports).__name__}, not Ports")
        yield OpenCell(ports)
    except BaseException as error:
        with suppress(Exception):  # an error of closing does not replace the first one
            closing.__exit__(type(error), error, error.__traceback__)
        raise
    closing.close()


@contextmanager
def _others_code(driver: str) -> Iterator[None]:
    """Turn an exception of the driver's own code into ConfigurationError while the driver is opened."""
    try:
        yield
    except CellError:
        raise
    except Exception as error:
        raise ConfigurationError(
            f"the driver '{driver}' cannot be opened: {type(error).__name__}: {error}",
            "MODULE is importable from here, and FACTORY(limits) is a context manager that yields Ports",
        ) from error


def _interruption(cell: OpenCell) -> Callable[[float], None]:
    def interrupt(seconds: float) -> None:
        assert cell.simulated is not None
        now = cell.ports.clock.now()
        cell.simulated.faults.add(Fault(FaultKind.JOINT_STATE_STALE, at=now, duration=seconds))

    return interrupt


class _Nobody:
    """No clause needs a person."""

    def lay_garment(self) -> NoReturn:
        raise AssertionError("no clause lays a garment")

    def bring_board(self, place: BoardPlace) -> NoReturn:
        raise AssertionError("no clause brings a board")
