"""The end of a run: its terminal state and last context."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from cell.states.run_context import RunContext
from cell.states.transition_table import State

__all__ = ["RunEnd"]


@dataclass(frozen=True, eq=False)
class RunEnd:
    """Terminal state and last context of a run. started, ended: cell time [s]."""

    state: State
    context: RunContext
    started: float
    ended: float
    stage_times: Mapping[str, float]
    """Cell time spent in each state [s]."""
