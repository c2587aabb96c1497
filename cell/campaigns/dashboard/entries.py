"""The runs and campaigns of a logs folder, as the dashboard lists them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

from foldcell.cell.campaigns.trials.trial import failed_figures
from foldcell.cell.hardware.driver_names import is_simulated
from foldcell.cell.record.run_record import Ending, RunRecord
from foldcell.cell.record.words import garment_name, plain

DAMAGED, FALSE_CLAIM = "damaged", "false claim"


@dataclass(frozen=True)
class RunEntry:
    """One run. key: path of the run's folder relative to the logs; it identifies the run in addresses. garment: as
    it was given, by name or as a file. status: as in the journal, or `damaged`. started: seconds since 1970, or
    None. record: None if the run has none. campaign, variant: empty for a run by itself. damage: what is wrong
    with its files, or empty. judged: the verdict of the person who attended the run, or None."""

    key: str
    folder: Path
    garment: str
    seed: int | None
    driver: str
    status: str
    started: float | None
    ending: Ending
    record: RunRecord | None
    campaign: str = ""
    variant: str = ""
    damage: str = ""
    judged: bool | None = None

    @property
    def name(self) -> str:
        """Name of the garment."""
        return garment_name(self.garment)

    @property
    def simulated(self) -> bool:
        return bool(self.driver) and is_simulated(self.driver)

    @property
    def passed(self) -> bool | None:
        """The verdict of the person, or of the score; None if neither judged the garment."""
        if self.judged is not None:
            return self.judged
        return self.record.score.passed if self.record and self.record.score else None

    @property
    def verdict(self) -> str:
        """The status, or `false claim` if the run claims a fold that the score does not pass."""
        return FALSE_CLAIM if self.status == "folded" and self.passed is False else self.status

    @property
    def failure(self) -> str:
        """Kind of the failure that ended the run, or empty."""
        return self.ending.failure.kind.value if self.ending.failure else ""

    @property
    def failed(self) -> tuple[str, ...]:
        """Figures of the score beyond their limits."""
        return failed_figures(self.record.score) if self.record and self.passed is False else ()

    @cached_property
    def text(self) -> str:
        """All text of the entry that the search looks through, in lower case."""
        parts = (self.key, self.garment, self.driver, self.verdict, self.failure, self.ending.why, self.variant)
        return plain(" ".join((*parts, *self.failed, self.damage))).lower()


@dataclass(frozen=True)
class CampaignEntry:
    """A campaign, or another folder with runs (scripted runs, endurance). begun: time of its beginning, as text.
    runs: number of planned runs. pages: names of its result pages. damage: what is wrong with its files, or
    empty."""

    name: str
    about: str
    begun: str
    runs: int
    finished: int
    folded: int
    pages: tuple[str, ...] = ()
    damage: str = ""


@dataclass(frozen=True)
class LogsContent:
    """runs: newest first; campaigns: newest first; notices: files that could not be read, in words."""

    runs: Sequence[RunEntry]
    campaigns: Sequence[CampaignEntry]
    notices: Sequence[str]

    @cached_property
    def by_key(self) -> Mapping[str, RunEntry]:
        return {run.key: run for run in self.runs}
