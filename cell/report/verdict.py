"""The verdict of a run and what decided it, in one sentence."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from cell.states.transition_table import State

__all__ = ["FoldEnd", "verdict"]

COUNTS = {0: "All folds were made", 1: "The only fold was made", 2: "Both folds were made"}


@dataclass(frozen=True)
class FoldEnd:
    """How one planned fold ended. attempts: number of grasps; done: whether the run went on from it as made;
    accepted: by its inspection, None if there was none to its end."""

    name: str
    attempts: int
    done: bool
    accepted: bool | None


def verdict(
    result: str,
    state: State | None,
    folds: Sequence[FoldEnd],
    reason: str = "",
    claim: str = "",
    score: str = "",
) -> str:
    """Return one sentence. result: 'folded', 'not_folded' or 'fault'; reason: the failure that ended the run;
    claim: what the executive says of the finished fold; score: what the score says, in simulation. Texts may be
    empty."""
    if result == "folded":
        text = f"{_all(folds)}; {_claimed(claim)}"
    elif claim and state is State.NOT_FOLDED and _only_the_claim_failed(folds):
        text = f"{_all(folds)}, but the garment does not count as folded: by the last picture it is {_end(claim)}"
    else:
        text = f"{_where(result, state, folds)}: {_end(reason) or 'the reason is not known'}"
    return f"{text}; {_end(score)}." if score else f"{text}."


def _only_the_claim_failed(folds: Sequence[FoldEnd]) -> bool:
    return bool(folds) and all(fold.done for fold in folds[:-1]) and folds[-1].accepted is False


def _claimed(claim: str) -> str:
    return f"by the last picture the garment is {_end(claim)}" if claim else "the last fold was not inspected"


def _all(folds: Sequence[FoldEnd]) -> str:
    return COUNTS.get(len(folds), f"All {len(folds)} folds were made")


def _where(result: str, state: State | None, folds: Sequence[FoldEnd]) -> str:
    """Say what ended, and at which fold."""
    missing = next((k for k, fold in enumerate(folds) if not fold.done), None)
    if missing is None:
        place, fold = ("before the first fold" if not folds else "after the last fold"), None
    else:
        fold = folds[missing]
        place = f"at fold {missing + 1} of {len(folds)} ({fold.name.replace('_', ' ')})"
    if state is State.STOPPED:
        return f"The run was stopped {place}"
    if result == "fault":
        return f"A fault ended the run {place}"
    if fold is None:
        return f"The run ended {place}"
    how = "was not made" if not fold.attempts else "was not finished" if fold.accepted is None else "failed"
    return f"Fold {place.removeprefix('at fold ')} {how}"


def _end(text: str) -> str:
    return text.strip().rstrip(".")
