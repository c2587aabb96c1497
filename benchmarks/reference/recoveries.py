"""The page of the recovery table."""

from __future__ import annotations

import math
from collections.abc import Iterable

from foldcell.cell.states.recovery_table import RECOVERIES, SUBSTITUTES, WITHOUT_EDITS, Adjustment, Recovery
from foldcell.cell.states.situation import Condition

INTRO = """# What the cell tries after a failure

The table is `cell/states/recovery_table.py`; `python -m benchmarks.reference` writes it here. The rows of a
failure are tried from top to bottom: the first one that answers is the recovery. **n** means: up to the n-th
failure of this kind in the fold (the verdicts of inspections count together). A word in *italics* is a
condition, explained in the last table. The change to the next attempt is in brackets. The middle table then
replaces recoveries that cannot be begun, in its order.

"""


def page() -> str:
    """Return the page as Markdown: the rows of each failure kind, the substitutes, and the conditions."""
    alike: dict[tuple[Recovery, ...], list[str]] = {}
    for kind, rows in RECOVERIES.items():
        alike.setdefault(rows, []).append(f"`{kind.value}`")
    conditions = [condition for rows in alike for row in (WITHOUT_EDITS, *rows) for condition in row.when]
    lines = ["| failure | the first of these that answers | else it asks, because |", "|---|---|---|"]
    lines.append(f"| every one, before all others | {_row(WITHOUT_EDITS)} | |")
    for (*answers, ask), kinds in alike.items():
        lines.append(f"| {', '.join(kinds)} | {'<br>'.join(_row(row) for row in answers)} | {ask.reason} |")
    lines += ["", "| instead of | if | it will |", "|---|---|---|"]
    for other in SUBSTITUTES:
        events = ", ".join(sorted(event.value.replace("_", " ") for event in other.of))
        changes = "" if len(other.adjusts) == len(Adjustment) else f" ({_names(sorted(other.adjusts))})"
        lines.append(f"| {events}{changes} | {_name(other.when)} | {other.event.value.replace('_', ' ')} |")
        conditions.append(other.when)
    lines += ["", "| condition | it holds if |", "|---|---|"]
    lines += [f"| {_name(c)} | {c.says} |" for c in dict.fromkeys(conditions)]
    return INTRO + "\n".join(lines) + "\n"


def _row(row: Recovery) -> str:
    """Return one row in words."""
    until = [] if row.until == math.inf else [f"**{row.until:.0f}**"]
    conditions = [_name(condition) for condition in row.when]
    change = "" if row.adjust is Adjustment.NONE else f" ({_names([row.adjust])})"
    made = "; the fold counts as not made" if row.not_made else ""
    dwell = f" after {row.dwell_s:g} s" if row.dwell_s else ""
    event = row.event.value.replace("_", " ")
    return f"{', '.join(until + conditions)}: {event}{change}{dwell}{made}"


def _name(condition: Condition) -> str:
    return f"*{condition.name}*"


def _names(adjustments: Iterable[Adjustment]) -> str:
    return ", ".join(adjustment.value.replace("_", " ") for adjustment in adjustments)
