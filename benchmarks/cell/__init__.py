"""The executive itself: where a run's time goes, what keeping everything costs, and how soon a stop is at rest.

foldcell bench cell
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from benchmarks.cell import journal_file, runs, stopping

__all__ = ["measure"]


def measure(tell: Callable[[str], None], *, peers: bool, quick: bool) -> dict[str, Any]:
    """Flat figures, units in the keys; the runs are simulated. quick: fewer lines, runs and stops."""
    return {
        "simulated": True,
        **journal_file.measure(tell, lines=100 if quick else 1000),
        **runs.measure(tell, rounds=1 if quick else 3),
        **stopping.measure(tell, stops=2 if quick else 10),
    }
