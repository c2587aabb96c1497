"""The simulated cell, which has the same ports as the real cell. simulated_cell.py is its only entry."""

from __future__ import annotations

from foldcell.cell.simulation.faults import TRAITS, Fault, FaultKind, Place
from foldcell.cell.simulation.settings import SimulationSettings
from foldcell.cell.simulation.simulated_cell import Display, SimulatedCell, check_settings, open_simulated_cell
from foldcell.cell.simulation.truth import Truth

__all__ = [
    "TRAITS",
    "Display",
    "Fault",
    "FaultKind",
    "Place",
    "SimulatedCell",
    "SimulationSettings",
    "Truth",
    "check_settings",
    "open_simulated_cell",
]
