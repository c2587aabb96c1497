"""Compare the end of a run with faults with the end that is due."""

from __future__ import annotations

from dataclasses import dataclass

from foldcell.cell.campaigns.faults.fault_table import DueEnd, FaultTable
from foldcell.cell.campaigns.faults.fault_trials import faults_of
from foldcell.cell.campaigns.hil.director import Observations
from foldcell.cell.campaigns.trials.trial import Trial, failed_figures
from foldcell.cell.record.run_record import RunRecord, ScoreRecord
from foldcell.cell.states.transition_table import State

DRIFT = {"drift_m", "drift_rad"}
"""Figures of the score that measure how far the garment lies from its place."""


@dataclass(frozen=True)
class Verdict:
    """How a run ended. end: the end of the run; None if it is none of `DueEnd`. due: whether this end was due.
    struck: whether the faults really happened; otherwise the run proves nothing. why: description of the
    events."""

    end: DueEnd | None
    due: bool
    struck: bool
    why: str

    @property
    def good(self) -> bool:
        return self.due and self.struck


def due_ends(table: FaultTable, names: tuple[str, ...]) -> tuple[DueEnd, ...]:
    """Return the due ends of a run with these faults. With two faults, only an end that is due for both is due."""
    ends = [set(table.faults[name].end) for name in names]
    return tuple(end for end in DueEnd if all(end in some for some in ends))


def judge(table: FaultTable, trial: Trial) -> Verdict:
    """Judge a run. If SAFE is due, ASKED is right, too."""
    names = faults_of(trial.request)
    due = due_ends(table, names)
    if trial.record is None or trial.seen is None:
        return Verdict(None, False, False, trial.error or "not performed")
    end, why = _end(trial.record, trial.seen, any(table.faults[name].displaces for name in names))
    right = end in due or (end is DueEnd.ASKED and DueEnd.SAFE in due)
    missed = trial.seen.not_done
    # a run that asked after its first fault never meets the second one
    struck = not missed or (not right and 1 < len(names) > len(trial.seen.missed))
    return Verdict(end, right, struck, why if not missed else f"{why}; {', '.join(missed)} did not happen")


def _end(run: RunRecord, seen: Observations, displaced: bool) -> tuple[DueEnd | None, str]:
    if seen.sent_after_stop:
        return None, f"{seen.sent_after_stop} set-points were sent after a stop"
    if seen.overdue:
        return None, "the run did not end by itself"
    if run.result == "folded":
        if run.score and (run.score.passed or (displaced and _only_drifted(run.score))):
            return DueEnd.RECOVERED, "folded"
        beyond = ", ".join(failed_figures(run.score)) or "not scored"
        return None, f"claimed as folded, but beyond its limits: {beyond}"
    failure = run.failure
    if run.state is not State.NOT_FOLDED or not seen.parked:
        return DueEnd.SAFE, f"{run.state.value}: {failure.what if failure else ''}"
    if failure and failure.what and failure.hint:
        return DueEnd.ASKED, f"{failure.kind.value}: {failure.what} ({failure.hint})"
    said = f"{failure.kind.value}: {failure.what or 'nothing was said'}" if failure else "nothing was said"
    return None, f"{said}; no hint what a person can do"


def _only_drifted(score: ScoreRecord) -> bool:
    return bool(score.failed) and {*score.failed} <= DRIFT and not (score.ideal and not score.ideal.valid)
