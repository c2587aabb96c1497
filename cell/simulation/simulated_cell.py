"""The one door of the simulated cell, and what comes through it.

The executive gets `ports` and nothing else. The scorer and the record of truth get `truth`, scripts that let
things go wrong get `faults`, who keeps a run gets `checkpoint`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Protocol, Self

from cell.simulation.faults import Fault
from cell.simulation.settings import SimulationSettings
from cell.simulation.truth import Truth
from robots.ports import Ports

__all__ = ["Checkpoint", "Faults", "SimulatedCell", "TruthSource", "check_settings", "open_simulated_cell"]


class _World(Protocol):
    """What stands behind a simulated cell, in this process or in another."""

    @property
    def faults(self) -> Faults: ...

    def truth(self) -> Truth: ...

    def watch(self, tell: Callable[[Truth], None] | None) -> None: ...

    def checkpoint(self) -> bytes: ...

    def restore(self, saved: bytes) -> None: ...


class Faults(Protocol):
    def add(self, fault: Fault) -> None:
        """Let something go wrong, when the fault's conditions are met."""


@dataclass(frozen=True)
class TruthSource:
    """What is really so, for the record only: no decision may come from it."""

    _world: _World

    def now(self) -> Truth:
        return self._world.truth()

    def watch(self, tell: Callable[[Truth], None] | None) -> None:
        """Have `tell` called with the truth twelve times a second of cell time; None: no more. A cell in another
        process tells nobody on the way."""
        self._world.watch(tell)


@dataclass(frozen=True)
class Checkpoint:
    """The world as it stands, for a run to be gone on with."""

    _world: _World

    def save(self) -> bytes:
        """Robot, hands, cloth, noise, time (some hundred kB)."""
        return self._world.checkpoint()

    def restore(self, saved: bytes) -> None:
        """Put a freshly opened cell, of the same settings and seed, where `saved` was taken. The arms stand at
        rest with their motors off; injected faults are not restored."""
        self._world.restore(saved)


@dataclass(frozen=True, eq=False)
class SimulatedCell:
    ports: Ports
    truth: TruthSource
    faults: Faults
    checkpoint: Checkpoint

    @classmethod
    def of(cls, ports: Ports, world: _World) -> Self:
        return cls(ports, TruthSource(world), world.faults, Checkpoint(world))


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


@contextmanager
def open_simulated_cell(settings: SimulationSettings, seed: int) -> Iterator[SimulatedCell]:
    """A cell with an empty table and the robot at its park configuration, at time 0, motors off. It is closed at
    the end, and its ports refuse everything afterwards.

    Everything in it is a function of `settings`, `seed` and the calls made on the ports. Raises
    ConfigurationError as `check_settings`, StorageError when the robot's model cannot be cached.
    """
    # imported when a cell is opened: the render process imports this package too and needs none of it
    from cell.simulation.ports import ports_of
    from cell.simulation.world import World
    from cell.simulation.world_of_port import unbind

    world = World(settings, seed)
    try:
        yield SimulatedCell.of(ports_of(world), world)
    finally:
        unbind(world)
        world.close()
