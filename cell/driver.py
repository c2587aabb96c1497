"""The one place where a driver is chosen: the ports of a cell, opened and closed again."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from cell.simulation import SimulationSettings, check_settings, close_cell, open_cell
from robots.errors import ConfigurationError
from robots.ports import Ports

__all__ = ["check_cell", "opened_cell"]


def check_cell(driver: str, settings: SimulationSettings) -> None:
    """Raises ConfigurationError for a cell that cannot be opened; nothing is started."""
    if driver != "sim":
        raise ConfigurationError(f"there is no driver '{driver}' yet", "the only one is 'sim'")
    check_settings(settings)


@contextmanager
def opened_cell(driver: str, settings: SimulationSettings, seed: int) -> Iterator[Ports]:
    """The ports of a cell. settings, seed: of the simulated one. Raises ConfigurationError as `check_cell`."""
    check_cell(driver, settings)
    ports = open_cell(settings, seed)
    try:
        yield ports
    finally:
        close_cell(ports)
