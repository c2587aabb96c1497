"""Write the table of faults into docs/safety.md:

python -m cell.campaigns.faults.documentation
"""

from __future__ import annotations

from cell.campaigns.faults.fault_table import FaultEntry, FaultTable, read_fault_table
from cell.simulation import TRAITS
from cell.support.files.page_section import write_section

__all__ = ["SECTION", "markdown_table"]

SECTION = "faults"
UNITS = {"m": " m", "s": " s", "N": " N", "ratio": " times", "share": ""}


def markdown_table(table: FaultTable) -> str:
    """Return the table as lines of Markdown, one row per fault."""
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
    return "\n".join(rows) + "\n"


def _size(entry: FaultEntry) -> str:
    traits = TRAITS[entry.kind]
    size = traits.size if entry.size is None else entry.size
    words = [] if size is None else [f"{size:g}{UNITS[traits.unit]}"]
    return ", ".join([*words, *([f"{entry.turn_deg:g}°"] if entry.turn_deg is not None else [])])


def _duration(entry: FaultEntry) -> str:
    if entry.duration_s is not None:
        return f"{entry.duration_s:g} s"
    default = TRAITS[entry.kind].duration
    return "at once" if default is None else "for good" if default == float("inf") else f"{default:g} s"


if __name__ == "__main__":
    write_section(SECTION, markdown_table(read_fault_table()))
