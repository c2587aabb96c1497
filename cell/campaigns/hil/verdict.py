"""Compare a run with the expectations of its script."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from enum import StrEnum

from foldcell.cell.campaigns.hil.director import Observations
from foldcell.cell.campaigns.hil.script import Script
from foldcell.cell.record.run_record import RunRecord

__all__ = ["broken_expectations"]


def broken_expectations(script: Script, result: RunRecord, seen: Observations) -> tuple[str, ...]:
    """Return the broken expectations, one sentence each; empty if the script passed. An action that was never
    carried out also counts as a broken expectation, because without it the script tests nothing."""
    return tuple(_broken(script, result, seen))


def _broken(script: Script, result: RunRecord, seen: Observations) -> Iterator[str]:
    expect = script.expect
    if seen.overdue:
        yield f"was still running after {script.limit_s:g} s (limit_s)"
    for what in seen.trouble:
        yield f"the script could not be carried out: {what}"
    if result.state not in expect.end:
        why = f": {result.failure.what}" if result.failure else ""
        yield f"ended {result.state}{why}; expected {_words(expect.end, ' or ')}"
    if _first_missing(expect.failures, seen.failures):
        yield f"had the failures {_words(seen.failures)}; expected {_words(expect.failures)} in this order"
    others = [kind for kind in dict.fromkeys(seen.failures) if kind not in expect.failures]
    if expect.only_failures and others:
        yield f"also had the failures {_words(others)}; expected none but {_words(expect.failures)}"
    if left := _first_missing(expect.through, seen.states):
        yield f"never entered {left.value} as expected (through {_words(expect.through)})"
    for state in expect.not_through:
        if state in seen.states:
            yield f"entered {state.value}, which was not expected"
    made = sum(step.done for step in result.steps)
    if expect.folds is not None and made != expect.folds:
        yield f"made {made} folds; expected {expect.folds}"
    if expect.within_s is not None and result.robot_time_s > expect.within_s:
        yield f"took {result.robot_time_s:.1f} s of robot time; expected at most {expect.within_s:g} s"
    if expect.passed is not None and result.score is None:
        yield "there is no score"
    elif expect.passed is not None and result.score is not None and result.score.passed != expect.passed:
        yield f"the scorer {'passed' if result.score.passed else 'did not pass'} the run, unexpectedly"
    if expect.parked is not None and seen.parked != expect.parked:
        yield "the arms were not parked with open hands at the end" if expect.parked else "the arms were parked"
    for action in seen.missed:
        yield f"{action} ({action.when}) never happened"


def _first_missing(wanted: Sequence[StrEnum], found: Sequence[StrEnum]) -> StrEnum | None:
    """Return the first item that does not occur in this order; None if all do."""
    rest = iter(found)
    return next((w for w in wanted if w not in rest), None)


def _words(names: Sequence[StrEnum], between: str = ", ") -> str:
    return between.join(name.value for name in names) or "none"
