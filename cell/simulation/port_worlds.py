"""A table that maps each port to its world, so that a port has no reference to its world.

Therefore the executive cannot reach the world through an attribute of its ports. A port is looked up by identity,
and its entry disappears together with it. Only `foldcell.cell.simulation` may import this module
(tests/unit/cell/simulation).
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any
from weakref import WeakKeyDictionary

from foldcell.robots.errors import DriverError, FailureKind

_worlds: WeakKeyDictionary[object, Any] = WeakKeyDictionary()


def bind(ports: Iterable[object], world: Any) -> None:
    """Connect ports to `world`. The ports are compared by identity and must allow weak references."""
    for port in ports:
        _worlds[port] = world


def unbind(world: Any) -> None:
    """Disconnect all ports of `world`. Their calls raise DriverError from now on."""
    for port in [port for port, bound in _worlds.items() if bound is world]:
        del _worlds[port]


def world_behind(port: object) -> Any:
    """The world of a port. Raises DriverError if its cell was closed."""
    try:
        return _worlds[port]
    except KeyError:
        raise DriverError(FailureKind.HARDWARE_FAULT, "the simulated cell was closed", "open a new one") from None
