"""Which world stands behind which ports: known here, and to nothing that an executive can hold.

Ports carry a number; the worlds that the numbers stand for are kept in this module. An architecture test
forbids everything outside `cell.simulation` to import it.
"""

from __future__ import annotations

import itertools
from typing import TYPE_CHECKING

from robots.errors import DriverError, FailureKind, InternalError
from robots.ports import Ports

if TYPE_CHECKING:
    from cell.simulation.world import World

__all__ = ["forget", "number_of", "register", "world"]

_worlds: dict[int, World] = {}
_numbers = itertools.count(1)


def register(world: World) -> int:
    number = next(_numbers)
    _worlds[number] = world
    return number


def world(number: int) -> World:
    """Raises DriverError when that cell was closed."""
    try:
        return _worlds[number]
    except KeyError:
        raise DriverError(
            FailureKind.HARDWARE_FAULT, "the simulated cell was closed", "open another one: nothing moves any more"
        ) from None


def forget(number: int) -> World | None:
    return _worlds.pop(number, None)


def number_of(ports: Ports) -> int:
    """Raises InternalError for the ports of something that is no simulated cell."""
    number = getattr(ports.clock, "_cell", None)
    if not isinstance(number, int):
        raise InternalError("these ports do not lead to a simulated cell", driver=ports.driver)
    return number
