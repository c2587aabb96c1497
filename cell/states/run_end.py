"""Where a run ended."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from cell.states.run_context import RunContext
from cell.states.transition_table import State

__all__ = ["RunEnd"]


@dataclass(frozen=True, eq=False)
class RunEnd:
    """Where a run ended, with what was believed then."""

    state: State
    context: RunContext
    started: float
    ended: float
    stage_times: Mapping[str, float]
    """Cell time spent in each state [s]."""
