"""Which runs the dashboard lists, and which page of them."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from typing import Any
from urllib.parse import urlencode

from foldcell.cell.campaigns.dashboard.entries import DAMAGED, RunEntry

PAGE_LENGTH = 50
NO_CAMPAIGN = "-"
"""Stands in place of a campaign's name for the runs that belong to no campaign."""


@dataclass(frozen=True)
class RunFilter:
    """Conditions for listing a run: a listed run meets all of them. Every run meets an empty condition. text:
    words that all occur in the run's texts; `seed 3` means this seed. chosen: key of the first run of a
    comparison, while the user chooses the second. page: number of the page, from 1."""

    garment: str = ""
    result: str = ""
    failure: str = ""
    campaign: str = ""
    text: str = ""
    chosen: str = ""
    page: int = 1

    @classmethod
    def of_query(cls, query: Mapping[str, str]) -> RunFilter:
        """Read the conditions from an address. If the page is not a number, it is the first page."""
        number = query.get("page", "")
        page = int(number) if number.isascii() and number.isdecimal() and len(number) < 10 else 1
        texts = {f.name: query.get(f.name, "").strip() for f in fields(cls) if f.name != "page"}
        return cls(**texts, page=max(page, 1))

    def selected(self, runs: Sequence[RunEntry]) -> list[RunEntry]:
        return [run for run in runs if self._meets(run)]

    def results(self, runs: Sequence[RunEntry]) -> list[tuple[str, int]]:
        """Return each result with its number of runs, the most frequent first. Only runs that meet the other
        conditions count."""
        others = replace(self, result="").selected(runs)
        counts = Counter(run.verdict for run in others)
        if damaged := sum(bool(run.damage) for run in others):
            counts[DAMAGED] = damaged
        return counts.most_common()

    def query(self, **changes: Any) -> str:
        """Return the query of an address for these conditions, with changes. The address leads to the first page,
        unless the changes name another."""
        changed = replace(self, **{"page": 1, **changes})
        stated = {f.name: getattr(changed, f.name) for f in fields(self)}
        return urlencode({k: v for k, v in stated.items() if v not in ("", 1)})

    def _meets(self, run: RunEntry) -> bool:
        return (
            self.garment in ("", run.name)
            and (self.result in ("", run.verdict) or (self.result == DAMAGED and bool(run.damage)))
            and self.failure in ("", run.failure)
            and (not self.campaign or (run.campaign or NO_CAMPAIGN) == self.campaign)
            and all(_occurs(word, run) for word in _words(self.text))
        )


def _words(text: str) -> list[str]:
    """Return the words of a search. `seed 3` is one word, so that it does not find every 3."""
    return re.sub(r"\bseed\s+(?=\d)", "seed", text.replace("_", " ").lower()).split()


def _occurs(word: str, run: RunEntry) -> bool:
    number = re.fullmatch(r"seed(\d{1,10})", word)
    return run.seed == int(number[1]) if number else word in run.text


def page_of(runs: Sequence[RunEntry], page: int) -> tuple[Sequence[RunEntry], int, int]:
    """Return the runs of a page, its number (the last page if there are fewer) and the number of pages."""
    pages = max(1, -(-len(runs) // PAGE_LENGTH))
    page = min(page, pages)
    return runs[(page - 1) * PAGE_LENGTH : page * PAGE_LENGTH], page, pages
