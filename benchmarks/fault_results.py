"""Writes docs/results/faults.md from campaigns of the table of faults.

    foldcell trials --faults ...
    python -m benchmarks.fault_results CAMPAIGN ...

CAMPAIGN: the folders that `foldcell trials --faults` wrote. What stands below the heading "Causes" on the page is
written by hand and stays.
"""

from __future__ import annotations

import argparse
import json
import platform
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from benchmarks.results_page import table
from foldcell.cell.campaigns.faults.fault_table import read_fault_table
from foldcell.cell.campaigns.statistics.proportions import wilson_interval
from foldcell.cell.record.words import interval, plain

PAGE = Path(__file__).resolve().parents[1] / "docs" / "results" / "faults.md"
CAUSES = "## Causes"
ABOUT = """# Results: injected faults

Simulated. In each run one fault of the
[table](../look_up/faults.md) strikes at a moment that the seed draws. A
run ends as due if its end is the one in the table; *recovered* means folded without a person, and passed by the
scorer. A run whose fault did not happen (`-`) proves nothing and is not counted.
Intervals: Wilson, 95 %.
"""


@dataclass(frozen=True)
class FaultRun:
    """One run of a campaign. struck: whether its faults happened; a run without them proves nothing."""

    faults: str
    garment: str
    seed: int
    due: bool
    struck: bool
    end: str
    why: str

    @property
    def world(self) -> str:
        return f"{self.garment} {self.seed}"


def read_runs(folder: Path) -> tuple[list[FaultRun], str]:
    """Return the runs of a campaign that have ended, and the commit of the program."""
    results = json.loads((folder / "faults.json").read_text(encoding="utf-8"))
    commit = json.loads((folder / "campaign.json").read_text(encoding="utf-8"))["commit"]
    return [_run(run) for run in results["runs"]], str(commit)


def _run(run: dict[str, Any]) -> FaultRun:
    end = run["end"] or "none of them"
    return FaultRun(
        " and ".join(run["faults"]), run["garment"], run["seed"], run["due"], run["struck"], end, run["why"]
    )


def page(runs: Sequence[FaultRun], commits: Sequence[str], date: str, causes: str = "") -> str:
    """Return the page. causes: what is written by hand about the runs that did not end as due."""
    due = {name: " or ".join(entry.end) for name, entry in read_fault_table().faults.items()}
    worlds = sorted({run.world for run in runs})
    struck = [run for run in runs if run.struck]
    lines = [
        ABOUT,
        f"{date}, commit {', '.join(sorted(set(commits)))}, {platform.machine()}:",
        "`foldcell trials --faults --n 1`, then `python -m benchmarks.fault_results CAMPAIGN ...`.",
        "",
        table("Ended as due", ("garment and seed", "recovered", "asked", "safe", "several ends"),
              [(world, *_shares(struck, due, world)) for world in (*worlds, "all")]),
        "",
        table("By fault", ("fault", "due end", *worlds), list(_rows(runs, due, worlds))),
        "",
        table("Runs that did not end as due", ("fault", "garment and seed", "end", "why"),
              [(r.faults, r.world, r.end, r.why.replace("|", "/")) for r in struck if not r.due]),
        "",
    ]  # fmt: skip
    return "\n".join(lines) + (f"\n{CAUSES}\n{causes}" if causes else "")


def _shares(struck: Sequence[FaultRun], due: dict[str, str], world: str) -> Iterator[str]:
    for end in ("recovered", "asked", "safe", ""):
        chosen = [
            run for run in struck
            if world in (run.world, "all") and (due[run.faults] == end or (not end and " or " in due[run.faults]))
        ]  # fmt: skip
        good = sum(run.due for run in chosen)
        share = interval(wilson_interval(good, len(chosen)))
        yield f"{good} of {len(chosen)} ({share})" if chosen else "-"


def _rows(runs: Sequence[FaultRun], due: dict[str, str], worlds: Sequence[str]) -> Iterator[tuple[str, ...]]:
    for name, end in due.items():
        cells = []
        for world in worlds:
            found = [run for run in runs if (run.faults, run.world) == (name, world)]
            struck = [run for run in found if run.struck]
            cells.append(f"{sum(r.due for r in struck)} of {len(struck)}" if struck else "-" if found else "")
        if any(cells):
            yield plain(name), end, *cells


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("campaigns", nargs="+", type=Path, metavar="CAMPAIGN")
    parser.add_argument("--date", required=True, metavar="YYYY-MM-DD", help="date of the campaigns")
    options = parser.parse_args(arguments)
    read = [read_runs(folder) for folder in options.campaigns]
    before = PAGE.read_text(encoding="utf-8") if PAGE.is_file() else ""
    causes = before.partition(f"{CAUSES}\n")[2]
    text = page([run for runs, _ in read for run in runs], [commit for _, commit in read], options.date, causes)
    PAGE.write_text(text, encoding="utf-8")
    print(PAGE)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
