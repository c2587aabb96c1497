"""The only entry to the simulated cell.

The executive gets `ports` and nothing else. The scorer and the ground truth recorder get `truth`, fault scripts
get `faults`, and the checkpoints of a run use `checkpoint`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Protocol

from foldcell.cell.simulation.faults import Fault
from foldcell.cell.simulation.settings import SimulationSettings
from foldcell.cell.simulation.truth import Truth
from foldcell.robots.ports import CameraFrame, Ports


class Faults(Protocol):
    def add(self, fault: Fault) -> None:
        """Inject a fault. It happens when its conditions hold."""


@dataclass(frozen=True)
class TruthSource:
    """The ground truth, only for records. No decision of a run may depend on it.

    now: returns the truth. watch: calls a function with the truth twelve times a second of cell time; None: stops
    calling. A cell in another process makes no calls.
    """

    now: Callable[[], Truth]
    watch: Callable[[Callable[[Truth], None] | None], None]


@dataclass(frozen=True)
class Checkpoint:
    """Saves and restores the world, so that a run can be resumed.

    save: returns the state of robot, hands, cloth, noise and time (1 to 12 MB). restore: restores the state in a
    newly opened cell with the same settings and seed. The arms are then at rest with their motors off. Injected
    faults are not restored.
    """

    save: Callable[[], bytes]
    restore: Callable[[bytes], None]


@dataclass(frozen=True)
class Display:
    """Pictures of a simulated cell for a person. They change nothing in the world, and no decision may depend on
    them.

    take: takes the present state; the returned function draws it, on any thread. progress: a number that grows
    when the world advances. A picture shows the present until the number grows. None if it is not known.
    on_advance: calls a function with each advance of the world, 60 times a second of cell time, and with True
    before the world stands still for a while. A cell in another process makes no calls.
    """

    take: Callable[[], Callable[[], CameraFrame | None]]
    progress: Callable[[], int | None]
    on_advance: Callable[[Callable[[bool], None]], None]


@dataclass(frozen=True, eq=False)
class SimulatedCell:
    ports: Ports
    truth: TruthSource
    faults: Faults
    checkpoint: Checkpoint
    display: Display


def check_settings(settings: SimulationSettings) -> None:
    """Check the settings. Raises ConfigurationError if the garment does not exist, or the world cannot simulate it
    or is not installed."""
    from foldcell.cell.config.garments.garment_file import load_garment
    from foldcell.cell.simulation.garment.cloth_body import check_body

    if settings.garment == "auto":  # the world draws a garment that it can simulate
        check_body(settings.world, "the garment", 1)
    else:
        garment = load_garment(settings.garment, settings.surface)
        check_body(settings.world, garment.name, garment.layers)


@contextmanager
def open_simulated_cell(settings: SimulationSettings, seed: int) -> Iterator[SimulatedCell]:
    """Open a cell at time 0, with an empty table, the robot at its start configuration and its motors off. The end
    of the context closes the cell. After that its ports raise DriverError.

    The cell's behaviour is a function of `settings`, `seed` and the calls of the ports. Raises ConfigurationError
    like `check_settings`, StorageError if the robot's model cannot be cached.
    """
    # imported here because the render process also imports this package but does not need these modules
    from foldcell.cell.simulation.port_worlds import unbind
    from foldcell.cell.simulation.ports import ports_of
    from foldcell.cell.simulation.world import World

    world = World(settings, seed)
    try:
        yield SimulatedCell(
            ports_of(world),
            TruthSource(world.truth, world.watch),
            world.faults,
            Checkpoint(world.checkpoint, world.restore),
            Display(world.display, world.steps, world.on_advance),
        )
    finally:
        unbind(world)
        world.close()
