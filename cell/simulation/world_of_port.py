"""Which world stands behind which port: a table of this module, and nothing that a port carries.

No attribute of anything that an executive holds leads to the world. A port is looked up by its identity, and is
forgotten with it. Nothing outside `cell.simulation` may import this module (tests/unit/cell/simulation).
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any
from weakref import WeakKeyDictionary

from robots.errors import DriverError, FailureKind

__all__ = ["bind", "unbind", "world_behind"]

_worlds: WeakKeyDictionary[object, Any] = WeakKeyDictionary()


def bind(ports: Iterable[object], world: Any) -> None:
    """Let these ports reach `world`. They are compared by identity and can be weakly referenced."""
    for port in ports:
        _worlds[port] = world


def unbind(world: Any) -> None:
    """Its ports refuse everything from now on."""
    for port in [port for port, behind in _worlds.items() if behind is world]:
        del _worlds[port]


def world_behind(port: object) -> Any:
    """Raises DriverError when that cell was closed."""
    try:
        return _worlds[port]
    except KeyError:
        raise DriverError(
            FailureKind.HARDWARE_FAULT, "the simulated cell was closed", "open another one: nothing moves any more"
        ) from None
