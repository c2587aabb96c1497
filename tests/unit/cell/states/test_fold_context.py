"""The values that a run's record keeps of its folds."""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from cell.states.run_context import RunContext
from robots.errors import FailureKind
from tests.builders.contexts import context_with

STEPS: Any = tuple(SimpleNamespace(name=name) for name in ("half", "quarter"))
PREDICTED: Any = SimpleNamespace(vertices=np.zeros((4, 3)))
TRAJECTORY: Any = SimpleNamespace(source="library")


def seen(diagnosis: FailureKind | None) -> Any:
    return SimpleNamespace(
        iou=0.91, iou_aligned=0.94, drift_m=0.004, height_m=0.03, diagnosis=diagnosis, contour=np.ones((5, 2))
    )


def test_a_fold_without_a_prediction_has_no_note() -> None:
    assert context_with(steps=STEPS).fold.note() is None
    assert RunContext().notes() == {}


def test_an_interrupted_fold_keeps_its_prediction() -> None:
    note = context_with(steps=STEPS, predicted=PREDICTED, trajectory=TRAJECTORY, grasps=2).notes()["half"]
    assert (note.source, note.grasps, note.inspected, note.accepted) == ("library", 2, None, False)
    assert math.isnan(note.observed_iou) and math.isnan(note.height_m) and len(note.observed) == 0


@pytest.mark.parametrize("diagnosis", [None, FailureKind.DROPPED_CORNER])
def test_a_refused_fold_keeps_its_observed_figures(diagnosis: FailureKind | None) -> None:
    note = context_with(steps=STEPS, predicted=PREDICTED, inspection=seen(diagnosis)).fold.note()
    assert note is not None and note.accepted is (diagnosis is None)
    assert (note.observed_iou, note.aligned_iou, note.drift_m, note.height_m) == (0.91, 0.94, 0.004, 0.03)
    assert len(note.observed) == 5


def test_the_duration_of_a_fold_is_that_of_the_arms_motion() -> None:
    """The arc at nominal speed would have another duration."""
    motion: Any = SimpleNamespace(fold=SimpleNamespace(duration=7.5))
    trajectory: Any = SimpleNamespace(source="library", duration=4.0)
    note = context_with(steps=STEPS, predicted=PREDICTED, trajectory=trajectory, motion=motion).fold.note()
    assert note is not None and note.carrying_s == 7.5


def test_a_finished_fold_keeps_its_values() -> None:
    made = context_with(steps=STEPS, predicted=PREDICTED, inspection=seen(None)).fold.note()
    assert made is not None
    ended = context_with(steps=STEPS, predicted=PREDICTED, done=(made,))
    assert ended.notes() == {"half": made}, "after the last fold the context still has its attempt"
    refused = context_with(steps=STEPS, index=1, done=(made,), inspection=seen(FailureKind.SAG))
    assert list(refused.notes()) == ["half", "quarter"]
    assert not refused.notes()["quarter"].accepted
