"""The notes of a run's folds."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np

from foldcell.cell.states.run_context import RunContext
from foldcell.robots.errors import FailureKind
from tests.builders.contexts import context_with

STEPS: Any = tuple(SimpleNamespace(name=name) for name in ("half", "quarter"))
PREDICTED: Any = SimpleNamespace(vertices=np.zeros((4, 3)))


def seen(diagnosis: FailureKind | None) -> Any:
    return SimpleNamespace(diagnosis=diagnosis)


def test_a_fold_without_a_prediction_has_no_note() -> None:
    assert context_with(steps=STEPS).fold.note() is None
    assert RunContext().notes() == {}


def test_an_interrupted_fold_keeps_its_prediction() -> None:
    note = context_with(steps=STEPS, predicted=PREDICTED, grasps=2).notes()["half"]
    assert (note.attempt.predicted, note.grasps, note.inspected, note.accepted) == (PREDICTED, 2, None, False)


def test_a_finished_fold_keeps_its_values() -> None:
    made = context_with(steps=STEPS, predicted=PREDICTED, inspection=seen(None)).fold.note()
    assert made is not None
    ended = context_with(steps=STEPS, predicted=PREDICTED, done=(made,))
    assert ended.notes() == {"half": made}, "after the last fold the context still has its attempt"
    refused = context_with(steps=STEPS, index=1, done=(made,), inspection=seen(FailureKind.SAG))
    assert list(refused.notes()) == ["half", "quarter"]
    assert not refused.notes()["quarter"].accepted
