"""Write the table of faults into docs/safety.md:

python -m cell.campaigns.faults.documentation
"""

from __future__ import annotations

from cell.campaigns.faults.fault_table import FaultEntry, FaultTable, read_fault_table
from cell.simulation import TRAITS
from cell.support.files.paths import repository_root
from cell.support.files.whole_file import write_whole
from robots.errors import ConfigurationError

__all__ = ["markdown_table", "with_table"]

BEGIN, END = "<!-- faults: begin -->", "<!-- faults: end -->"
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


def with_table(page: str, table: FaultTable) -> str:
    """Return the page with the present table between its marks. Raises ConfigurationError if it has no marks."""
    if BEGIN not in page or END not in page:
        raise ConfigurationError(f"the page has no marks {BEGIN} and {END}", "add them where the table belongs")
    before, rest = page.split(BEGIN, 1)
    return f"{before}{BEGIN}\n{markdown_table(table)}{END}{rest.split(END, 1)[1]}"


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


def main() -> None:
    root = repository_root()
    if root is None:
        raise ConfigurationError("the documentation is not installed", "run this in a checkout of the program")
    page = root / "docs" / "safety.md"
    write_whole(page, with_table(page.read_text(encoding="utf-8"), read_fault_table()))


if __name__ == "__main__":
    main()
