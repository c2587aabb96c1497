"""Writes a benchmark's figures as Markdown tables, with the required value beside each figure, and the runs of a
campaign that were not folded."""

from __future__ import annotations

import platform
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from foldcell.cell.campaigns.trials.store import BegunCampaign, commit
from foldcell.cell.campaigns.trials.trial import Trial
from foldcell.cell.record.words import plain as in_words


@dataclass(frozen=True)
class Row:
    """One figure of a table. about: its description. key: its key in the figures. bar: its required value (None:
    no requirement). least: whether `bar` is a minimum; otherwise it is a maximum."""

    about: str
    key: str
    bar: float | None = None
    least: bool = False
    unit: str = ""

    def cells(self, figures: Mapping[str, Any]) -> tuple[str, str, str] | None:
        """Return the table cells (description, value, required value); None if the figure was not measured."""
        value = figures.get(self.key)
        if value is None:
            return None
        shown = str(value) if isinstance(value, bool | int) else f"{value:.3g}"
        if self.bar is None:
            return f"{self.about}", f"{shown} {self.unit}".strip(), ""
        good = value >= self.bar if self.least else value <= self.bar
        sign = "at least" if self.least else "at most"
        verdict = f"{sign} {self.bar:g}" if good else f"{sign} {self.bar:g}: **not met**"
        return f"{self.about}", f"{shown} {self.unit}".strip(), verdict


def table_of_rows(title: str, rows: Sequence[Row], figures: Mapping[str, Any]) -> str | None:
    """Write a section with the measured figures; None if none was measured."""
    cells = [found for found in (row.cells(figures) for row in rows) if found is not None]
    return table(title, ("figure", "measured", "bar"), cells) if cells else None


def table(title: str, names: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    if not rows:
        return f"## {title}\n\nNone."
    lines = [f"## {title}", "", _line([n.replace("_", " ") for n in names]), _line(["---"] * len(names))]
    return "\n".join(lines + [_line(row) for row in rows])


def origin(campaign: BegunCampaign) -> str:
    """Return the line that says when, from what and where a campaign was made."""
    machine = campaign.machine
    return f"- Begun {campaign.begun}, commit {campaign.commit}, {machine.cpu}, {machine.cores} cores."


def made_by(command: str) -> str:
    """Return the line that says when, from what and by which command the figures of a page were measured."""
    return f"{time.strftime('%Y-%m-%d')}, commit {commit() or 'unknown'}, {platform.machine()}: `{command}`."


def causes(trials: Sequence[Trial]) -> list[str]:
    """Return the section with the runs that were not folded, as lines."""
    failed = sorted({(t.request.garment, t.request.seed, t.cause) for t in trials if t.cause})
    lines = [f"- {in_words(garment)}, seed {seed}: {in_words(cause)}" for garment, seed, cause in failed]
    return ["## Runs that were not folded", "", *(lines or ["None."])]


def plain(value: Any) -> str:
    return "-" if value is None else f"{value:.4g}" if isinstance(value, float) else str(value)


def _line(cells: Sequence[str]) -> str:
    return "| " + " | ".join(cells) + " |"
