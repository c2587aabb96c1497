"""Judge how a run with faults ended, against the end that is due."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from cell.campaigns.faults.fault_table import DueEnd, FaultTable
from cell.campaigns.faults.fault_trials import faults_of
from cell.campaigns.trials.trial import Trial, failed_figures
from cell.states.transition_table import State

__all__ = ["Verdict", "due_ends", "judge"]

DRIFT = "drift"


@dataclass(frozen=True)
class Verdict:
    """How a run ended. end: the end that it had; None if it had none of them. due: whether this end was due.
    struck: whether the faults really happened; without them the run proves nothing. why: what happened, in
    words."""

    end: DueEnd | None
    due: bool
    struck: bool
    why: str

    @property
    def good(self) -> bool:
        return self.due and self.struck


def due_ends(table: FaultTable, names: tuple[str, ...]) -> tuple[DueEnd, ...]:
    """Return the due ends of a run with these faults: of two faults, both should be recovered."""
    ends = [set(table.faults[name].end) for name in names]
    return tuple(end for end in DueEnd if all(end in some for some in ends))


def judge(table: FaultTable, trial: Trial) -> Verdict:
    """Judge a run. A run that asks where it should be safe is safe."""
    names = faults_of(trial.request)
    due = due_ends(table, names)
    figures = trial.figures
    if figures is None or not trial.performed:
        return Verdict(None, False, False, trial.error or "not performed")
    end, why = _end(figures, any(table.faults[name].displaces for name in names))
    right = end in due or (end is DueEnd.ASKED and DueEnd.SAFE in due)
    missed = figures.get("script_missed") or []
    # a run that asked after its first fault never meets the second one
    struck = not missed or (not right and len(names) > 1)
    return Verdict(end, right, struck, why if not missed else f"{why}; {', '.join(missed)} did not happen")


def _end(figures: Mapping[str, Any], displaced: bool) -> tuple[DueEnd | None, str]:
    failure = figures.get("failure") or {}
    what = str(failure.get("what", ""))
    if figures.get("sent_after_stop"):
        return None, f"{figures['sent_after_stop']} set-points were sent after a stop"
    if figures.get("overdue"):
        return None, "the run did not end by itself"
    if figures["result"] == "folded":
        score = figures.get("score") or {}
        beyond = failed_figures(score)
        if score.get("passed") or (displaced and beyond and set(beyond) == {DRIFT}):
            return DueEnd.RECOVERED, "folded"
        return None, f"claimed as folded, but beyond its limits: {', '.join(beyond) or 'not scored'}"
    if figures["state"] == State.NOT_FOLDED and figures.get("parked") and what and failure.get("hint"):
        return DueEnd.ASKED, f"{failure.get('kind')}: {what} ({failure['hint']})"
    if figures["state"] == State.NOT_FOLDED and figures.get("parked"):
        return None, f"{failure.get('kind')}: {what or 'nothing was said'}; no hint what a person can do"
    return DueEnd.SAFE, f"{figures['state']}: {what}"
