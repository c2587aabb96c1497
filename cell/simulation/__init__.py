"""The simulated cell, behind the same ports as the real one.

`open_cell` is the one door. What else stands here is for those who hold a cell without being its executive:
the scorer and the record of truth (`truth`), scripts that let things go wrong (`inject`), the ledger's
restart (`checkpoint`, `restore`).
"""

from __future__ import annotations

from collections.abc import Callable

from cell.simulation.faults import Fault, FaultKind
from cell.simulation.settings import SimulationSettings
from cell.simulation.truth import Truth
from robots.ports import Ports

__all__ = [
    "Fault",
    "FaultKind",
    "SimulationSettings",
    "Truth",
    "check_settings",
    "checkpoint",
    "close_cell",
    "inject",
    "open_cell",
    "restore",
    "truth",
    "witness",
]

# The world is imported when a cell is opened: the render process imports this package too and needs none of it.


def check_settings(settings: SimulationSettings) -> None:
    """Raises ConfigurationError for what no cell can be opened with: a garment that does not exist, that the world
    does not carry, or a world that is not installed."""
    from cell.config.garments.garment_file import load_garment
    from cell.simulation.garment.cloth_body import check_body

    if settings.garment == "auto":  # the world draws one that it carries
        check_body(settings.world, "the garment", 1)
    else:
        garment = load_garment(settings.garment, settings.surface)
        check_body(settings.world, garment.name, garment.layers)


def open_cell(settings: SimulationSettings, seed: int) -> Ports:
    """A cell with an empty table and the robot at its park configuration, at time 0, motors off.

    Everything in it is a function of `settings`, `seed` and the calls made on the ports. Raises
    ConfigurationError as `check_settings`, StorageError when the robot's model cannot be cached.
    """
    from cell.simulation import _registry
    from cell.simulation.ports import ports_of
    from cell.simulation.world import World

    world = World(settings, seed)
    return ports_of(_registry.register(world), world.command_timeout)


def close_cell(ports: Ports) -> None:
    """End a cell's processes. Its ports refuse everything afterwards; closing twice is harmless."""
    from cell.simulation import _registry

    world = _registry.forget(_registry.number_of(ports))
    if world is not None:
        world.close()


def truth(ports: Ports) -> Truth:
    """What is really so, for the scorer and the record of truth only: no decision may come from it."""
    from cell.simulation import _registry

    return _registry.world(_registry.number_of(ports)).truth()


def witness(ports: Ports, tell: Callable[[Truth], None] | None) -> None:
    """Have `tell` called with the truth twelve times a second of cell time, for the record of truth only."""
    from cell.simulation import _registry

    _registry.world(_registry.number_of(ports)).witness = tell


def checkpoint(ports: Ports) -> bytes:
    """The world as it stands, for a ledger to keep: robot, hands, cloth, noise, time (some hundred kB)."""
    from cell.simulation import _registry

    return _registry.world(_registry.number_of(ports)).checkpoint()


def restore(ports: Ports, saved: bytes) -> None:
    """Put a freshly opened cell, of the same settings and seed, where a checkpoint was taken.

    The arms stand at rest with their motors off. Injected faults are not restored.
    """
    from cell.simulation import _registry

    _registry.world(_registry.number_of(ports)).restore(saved)


def inject(ports: Ports, fault: Fault) -> None:
    """Let something go wrong in a simulated cell, when the fault's conditions are met."""
    from cell.simulation import _registry

    _registry.world(_registry.number_of(ports)).faults.add(fault)
