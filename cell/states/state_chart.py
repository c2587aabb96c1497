"""The chart of the states as a picture for pages, with the states of a run marked on it.

`foldcell chart` draws `state_chart.svg` from the table (cell/executive/draw_state_chart.py).
"""

from __future__ import annotations

import re
from collections.abc import Collection
from pathlib import Path

from cell.states.transition_table import State

__all__ = ["CHART", "marked_chart"]

CHART = Path(__file__).with_name("state_chart.svg")


def marked_chart(present: State | None = None, passed: Collection[State] = ()) -> str:
    """The chart as SVG for a page. Its groups have the class `state`, that of the present state also `present`,
    those that a run passed `passed`."""

    def mark(group: re.Match[str]) -> str:
        state = State(group[1])
        more = " present" if state is present else " passed" if state in passed else ""
        return f'id="state-{state.value}" class="state{more}"'

    return re.sub(r'id="state-(\w+)" class="state"', mark, CHART.read_text(encoding="utf-8"))
