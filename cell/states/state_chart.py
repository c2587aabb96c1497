"""The state chart as SVG for pages, with the states of a run marked on it.

`python -m benchmarks.state_chart` draws `state_chart.svg` from the table.
"""

from __future__ import annotations

import re
from collections.abc import Collection
from pathlib import Path

from foldcell.cell.states.transition_table import State

CHART = Path(__file__).with_name("state_chart.svg")


def marked_chart(present: State | None = None, passed: Collection[State] = ()) -> str:
    """Return the chart as SVG. The group of each state has the class `state`, and also `present` for the present
    state or `passed` for the states in `passed`."""

    def with_mark(group: re.Match[str]) -> str:
        state = State(group[1])
        mark = " present" if state is present else " passed" if state in passed else ""
        return f'id="state-{state.value}" class="state{mark}"'

    return re.sub(r'id="state-(\w+)" class="state"', with_mark, CHART.read_text(encoding="utf-8"))
