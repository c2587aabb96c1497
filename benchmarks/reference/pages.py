"""All files of docs that are made from the program."""

from __future__ import annotations

from pathlib import Path

from benchmarks.reference import commands, failures, faults, python_api, recoveries, schemas

ROOT = Path(__file__).resolve().parents[2]
FOLDER = ROOT / "docs"


def pages() -> dict[str, str]:
    """Return the files: path in docs -> content. The chart of the states is among them, because the site shows
    files of docs only."""
    found = {
        **commands.pages(),
        **schemas.pages(),
        **python_api.pages(),
        **failures.pages(failures.messages()),
        "recoveries.md": recoveries.page(),
        "faults.md": faults.page(),
    }
    chart = (ROOT / "cell" / "states" / "state_chart.svg").read_text(encoding="utf-8")
    return {**{f"look_up/{name}": text for name, text in found.items()}, "pictures/state_chart.svg": chart}
