"""Benchmarks of the executive: wall time of a run, cost of its records, and time from a stop until the arms rest.

foldcell bench cell
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from benchmarks.cell import journal, runs, stopping


def measure(tell: Callable[[str], None], *, peers: bool, quick: bool) -> dict[str, Any]:
    """Measure everything in simulated runs. Return one flat mapping of figures with units in the keys. quick:
    fewer lines, runs and stops."""
    return {
        "simulated": True,
        **journal.measure(tell, lines=100 if quick else 1000),
        **runs.measure(tell, rounds=1 if quick else 3),
        **stopping.measure(tell, stops=2 if quick else 10),
    }
