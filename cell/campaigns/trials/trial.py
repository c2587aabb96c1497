"""One run of a campaign and its result file."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from pydantic import TypeAdapter, ValidationError

from foldcell.cell.campaigns.hil.director import Observations
from foldcell.cell.campaigns.trials.campaign import TrialRequest
from foldcell.cell.record.judgement import Judgement
from foldcell.cell.record.run_record import RunRecord, ScoreRecord
from foldcell.cell.record.words import figure_name
from foldcell.cell.support.files.whole_file import write_whole

TRIAL = "trial.json"
"""File with the result of a run, in the run's own folder."""


@dataclass(frozen=True)
class Trial:
    """One run of a campaign. record: None if the run has no record; `error` then states the reason. seen:
    observations of its scripted actions; None without such actions. performed: False for a run that did not end
    because its worker process died. judgement: of the person who attended the run; None: nobody has judged it."""

    request: TrialRequest
    record: RunRecord | None
    error: str = ""
    seen: Observations | None = None
    performed: bool = True
    judgement: Judgement | None = None

    @property
    def unjudged(self) -> bool:
        """Whether the run waits for a person's verdict."""
        return self.request.attended and self.judgement is None

    @property
    def result(self) -> str:
        if not self.performed:
            return "not_performed"
        return self.record.result if self.record else "fault"

    @property
    def score(self) -> ScoreRecord | None:
        return self.record.score if self.record else None

    @property
    def height_m(self) -> float | None:
        """Height of the folded stack [m]; None without a score."""
        return self.score.height_m if self.score else None

    @property
    def claimed(self) -> bool:
        """Whether the executive claims that the garment is folded."""
        return self.result == "folded"

    @property
    def passed(self) -> bool | None:
        """The verdict on the garment, whether folding was claimed or not: of the person in an attended run, else
        of the scorer. None: neither judged it."""
        if self.request.attended:
            return self.judgement.passed if self.judgement else None
        return self.score.passed if self.score else None

    @property
    def success(self) -> bool:
        """Whether the run was claimed and passed. If nobody judged the garment, the claim alone counts."""
        return self.claimed and self.passed is not False

    @property
    def verdict(self) -> str:
        """The result, or `false claim` if the claimed fold did not pass."""
        return "false claim" if self.claimed and not self.success else self.result

    @property
    def cause(self) -> str:
        """Why the run is not a success: the kind of failure, or the figures of the score that are beyond their
        limits."""
        if self.success:
            return ""
        if self.record is None:
            return "error" if self.performed else "not performed"
        if self.record.failure:
            return self.record.failure.kind.value
        if self.judgement:
            return f"judged: {self.judgement.why}"
        return "score: " + ", ".join(failed_figures(self.score))


def failed_figures(score: ScoreRecord | None) -> tuple[str, ...]:
    """Return the names of the figures of a score that are beyond their limits, and `ideal` if the ideal fold is
    not valid."""
    if score is None:
        return ()
    names = tuple(figure_name(name) for name in score.failed)
    return (*names, "ideal") if score.ideal and not score.ideal.valid else names


_TRIAL = TypeAdapter(Trial)


def read_trial(folder: Path, request: TrialRequest) -> Trial | None:
    """Return the result in `folder` if it is complete and belongs to this request, else None."""
    try:
        trial = _TRIAL.validate_json((folder / TRIAL).read_bytes())
    except (OSError, ValidationError):
        return None
    return trial if trial.request == request else None


def write_trial(folder: Path, trial: Trial) -> None:
    """Write the result of a run into `folder`. Raises StorageError."""
    write_whole(folder / TRIAL, _TRIAL.dump_json(trial) + b"\n")
