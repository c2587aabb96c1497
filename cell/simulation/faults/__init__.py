"""Faults that a script or a test injects into a simulated cell."""

from __future__ import annotations

from foldcell.cell.simulation.faults.board import FaultBoard
from foldcell.cell.simulation.faults.fault import Fault
from foldcell.cell.simulation.faults.kinds import TRAITS, FaultKind, FaultTraits, Place

__all__ = ["TRAITS", "Fault", "FaultBoard", "FaultKind", "FaultTraits", "Place"]
