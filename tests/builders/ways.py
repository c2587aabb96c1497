"""Ways through the transition table."""

from __future__ import annotations

from foldcell.cell.executive.machine import complete_table
from foldcell.cell.states.transition_table import TERMINAL, Effect, Event, Row, State


def ways() -> dict[tuple[State, Effect], tuple[Row, ...]]:
    """The shortest path through the table to each state and effect."""
    found: dict[tuple[State, Effect], tuple[Row, ...]] = {}
    ends: list[tuple[State, tuple[Row, ...]]] = [(State.IDLE, ())]
    for state, way in ends:  # the list grows during the loop
        for row in (row for row in complete_table() if row.state is state and row.event is not Event.UNRECORDED):
            if (row.target, row.effect) not in found:
                found[row.target, row.effect] = (*way, row)
                ends.append((row.target, (*way, row)))
    return {place: way for place, way in found.items() if place[0] not in TERMINAL}


WAYS = ways()
"""State and effect -> the rows of the shortest way there."""
