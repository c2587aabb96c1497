"""The page of the table of faults."""

from __future__ import annotations

from benchmarks.reference.markdown import table as _table
from foldcell.cell.campaigns.faults.fault_table import FaultEntry, read_fault_table
from foldcell.cell.simulation import TRAITS

INTRO = """# Which faults are rehearsed, and how they should end

The simulated cell can be given any of these faults, at a moment that the seed draws. Each has an end that is
due:

- **recovered**: the garment is folded without a person, and the scorer passes the fold. If the fault itself
  moved the garment, the fold may lie elsewhere.
- **asked**: the cell parks, says what is wrong and what a person can do. Without a person the run ends as not
  folded.
- **safe**: nothing moves any more, no set-point follows a stop, and the run does not claim a fold.

The table is `cell/campaigns/faults/fault_table.yaml`; `python -m benchmarks.reference` writes it here. It
states what is due, not what was measured ([results](../results/faults.md)).

"""
UNITS = {"m": " m", "s": " s", "N": " N", "ratio": " times", "share": ""}


def page() -> str:
    """Return the page as Markdown, one row per fault."""
    table = read_fault_table()
    rows = ["| fault | size | lasts | injected into | strikes | due end | why |", "|---|---|---|---|---|---|---|"]
    for name, entry in table.faults.items():
        ends = " or ".join(end.value for end in entry.end)
        kind = "" if entry.kind.value == name else f" (`{entry.kind.value}`)"
        rows.append(
            f"| {name.replace('_', ' ')}{kind} | {_size(entry)} | {_duration(entry)} | {entry.place.value} | "
            f"{entry.stage.replace('_', ' ')} | {ends} | {entry.why} |"
        )
    rows += ["", "| strikes | states, drawn evenly over their usual length |", "|---|---|"]
    for name, stage in table.stages.items():
        rows.append(f"| {name.replace('_', ' ')} | {', '.join(s.value for s in stage.moment.during)} |")
    kinds = [
        (f"`{kind.value}`", each.what, "" if each.size is None else f"{each.size:g}{UNITS[each.unit]}",
         _lasting(each.duration))
        for kind, each in TRAITS.items()
    ]  # fmt: skip
    rows += ["", "## Kinds", "", *_table(("kind", "what happens", "size, if none is stated", "lasts"), kinds)]
    return INTRO + "\n".join(rows) + "\n"


def _size(entry: FaultEntry) -> str:
    traits = TRAITS[entry.kind]
    size = traits.size if entry.size is None else entry.size
    words = [] if size is None else [f"{size:g}{UNITS[traits.unit]}"]
    return ", ".join([*words, *([f"{entry.turn_deg:g}°"] if entry.turn_deg is not None else [])])


def _duration(entry: FaultEntry) -> str:
    if entry.duration_s is not None:
        return f"{entry.duration_s:g} s"
    return _lasting(TRAITS[entry.kind].duration)


def _lasting(duration: float | None) -> str:
    return "at once" if duration is None else "for good" if duration == float("inf") else f"{duration:g} s"
