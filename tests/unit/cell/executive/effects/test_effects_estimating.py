"""The estimate of the garment's state after a failure chooses what follows."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from foldcell.cell.executive.effects import EFFECTS
from foldcell.cell.executive.effects.recovery import estimating
from foldcell.cell.states.run_context import Result
from foldcell.cell.states.transition_table import Effect, Event
from foldcell.robots.errors import Failure, FailureKind
from foldcell.robots.ports import Side
from foldcell.skills.state_estimate.estimate import COMPLETED, PRIORS, StateEstimate
from foldcell.skills.state_estimate.hypothesis import FoldState
from foldcell.skills.vocabulary import GraspId, Outcome, PredictedShape
from tests.builders.contexts import context_with
from tests.fakes import FakeCell
from tests.workcells import fake_workcell

FLAT = np.column_stack([[[0.5, 0.0], [0.7, 0.0], [0.5, 0.2]], np.full(3, 0.001)])
PICTURE = np.zeros((20, 20, 3), np.uint8)


def estimated(
    monkeypatch: pytest.MonkeyPatch, state: FoldState, confidence: float, second: FoldState = FoldState.BEFORE
) -> Result:
    """Perform the effect in a cell whose garment is found in this state. second: the next probable state."""
    rest = dict.fromkeys(FoldState, 0.0) | {second: 1.0 - confidence}
    found = StateEstimate(state, confidence, None, rest | {state: confidence}, (), 12, FLAT[:, :2])
    cell = FakeCell()
    workcell = fake_workcell(cell)
    monkeypatch.setattr(estimating, "simulated_paths", lambda *_: {GraspId.LEFT: None, GraspId.RIGHT: None})
    monkeypatch.setattr(estimating, "observe", lambda *_, **__: Outcome(SimpleNamespace()))
    monkeypatch.setattr(estimating, "estimate_state", lambda *_, **__: found)
    monkeypatch.setattr(estimating, "draw_estimate", lambda *_: PICTURE)
    return EFFECTS[Effect.ESTIMATE](workcell, touched(cell))


def touched(cell: FakeCell, **changes: Any) -> Any:
    """The hands have touched the garment, and the fold was not completed."""
    posture = SimpleNamespace(path=GraspId.LEFT)
    known: dict[str, Any] = {
        "touched": True, "carried": False, "vertices": FLAT, "frame": cell.ports().camera.capture(),
        "predicted": PredictedShape(FLAT, np.array([[0, 1, 2]], np.int32), FLAT[:, :2]),
        "step": SimpleNamespace(name="half", grasps={}),
        "motion": SimpleNamespace(postures={Side.RIGHT: posture}),
    }  # fmt: skip
    return context_with(**{**known, **changes})


@pytest.mark.parametrize(
    ("state", "confidence", "second", "event"),
    [
        (FoldState.BEFORE, 0.9, FoldState.HEAP, Event.DONE),
        (FoldState.AFTER, 0.9, FoldState.HALF_WAY, Event.FOLD_MADE),
        (FoldState.HALF_WAY, 0.9, FoldState.BEFORE, Event.FAILED),
        (FoldState.HEAP, 0.9, FoldState.BEFORE, Event.FAILED),
        (FoldState.HALF_WAY, 0.6, FoldState.BEFORE, Event.DONE),
        (FoldState.HALF_WAY, 0.6, FoldState.AFTER, Event.FOLD_MADE),
        (FoldState.HEAP, 0.6, FoldState.HALF_WAY, Event.DONE),
    ],
)
def test_the_state_chooses_the_event_and_an_uncertain_one_is_left_to_recognition_or_inspection(
    monkeypatch: pytest.MonkeyPatch, state: FoldState, confidence: float, second: FoldState, event: Event
) -> None:
    result = estimated(monkeypatch, state, confidence, second)
    assert result.event is event
    assert result.context.fold.carried == (event is Event.FOLD_MADE)
    assert result.context.fold.estimate is not None and result.context.fold.estimate.state is state
    assert result.record["state"] == state.value and result.record["simulations"] == 12


@pytest.mark.parametrize(
    ("state", "kind"), [(FoldState.HALF_WAY, FailureKind.HALF_FOLDED), (FoldState.HEAP, FailureKind.HEAPED)]
)
def test_the_failure_says_what_lies_there(
    monkeypatch: pytest.MonkeyPatch, state: FoldState, kind: FailureKind
) -> None:
    result = estimated(monkeypatch, state, 0.9)
    failure, (note,) = result.context.failure, result.context.estimates
    assert failure is not None and failure.kind is kind
    assert note.says in failure.what and "confidence 0.90" in note.says and "half" in failure.what
    assert note.picture is PICTURE and failure.hint


def test_a_picture_that_cannot_be_judged_is_a_failure(monkeypatch: pytest.MonkeyPatch) -> None:
    unseen = Failure(FailureKind.NO_GARMENT, "the garment is not visible")
    monkeypatch.setattr(estimating, "simulated_paths", lambda *_: {})
    monkeypatch.setattr(estimating, "observe", lambda *_, **__: Outcome(failure=unseen))
    cell = FakeCell()
    result = EFFECTS[Effect.ESTIMATE](fake_workcell(cell), touched(cell))
    assert result.event is Event.FAILED and result.context.failure == unseen and not result.context.estimates


def test_a_look_tells_whether_the_garment_was_touched() -> None:
    cell = FakeCell()
    workcell, look = fake_workcell(cell), EFFECTS[Effect.LOOK]
    assert look(workcell, touched(cell)).event is Event.TOUCHED
    assert look(workcell, touched(cell, touched=False)).event is Event.DONE
    assert look(workcell, touched(cell, carried=True)).event is Event.DONE
    forgotten = touched(cell)
    forgotten = replace(forgotten, fold=replace(forgotten.fold, attempt=None))
    assert look(workcell, forgotten).event is Event.DONE


def test_a_look_ends_a_repair_and_the_state_is_estimated_again() -> None:
    """Also if the hands came to its end: whether the garment lies as before the fold is seen, not assumed."""
    cell = FakeCell()
    undone = touched(cell, carried=True).fold.attempt
    repair: Any = SimpleNamespace(ended=lambda performed: replace(undone, carried=False))
    result = EFFECTS[Effect.LOOK](fake_workcell(cell), touched(cell, carried=True, repair=repair))
    fold = result.context.fold
    assert result.event is Event.TOUCHED and fold.repair is None and fold.estimate is None
    assert fold.attempt is not None and fold.attempt.predicted is undone.predicted and not fold.carried


@pytest.mark.parametrize(
    ("carried", "failed", "priors"),
    [
        (True, (), COMPLETED),
        (True, (FailureKind.OFF_TARGET,), COMPLETED),
        (True, (FailureKind.SLIPPED,), PRIORS),
        (False, (), PRIORS),
    ],
)
def test_a_fold_in_which_no_loss_was_noticed_is_probably_made(
    monkeypatch: pytest.MonkeyPatch, carried: bool, failed: tuple[FailureKind, ...], priors: Any
) -> None:
    used: list[Any] = []
    found = StateEstimate(FoldState.AFTER, 1.0, None, dict.fromkeys(FoldState, 0.0), (), 0, FLAT[:, :2])
    cell = FakeCell()
    monkeypatch.setattr(estimating, "simulated_paths", lambda *_: {GraspId.LEFT: None})
    monkeypatch.setattr(estimating, "observe", lambda *_, **__: Outcome(SimpleNamespace()))
    monkeypatch.setattr(estimating, "estimate_state", lambda *given, **_: (used.append(given[-1]), found)[1])
    monkeypatch.setattr(estimating, "draw_estimate", lambda *_: PICTURE)
    context = touched(cell, carried=carried)
    for kind in failed:
        context = context.with_failure(Failure(kind, "it failed"))
    EFFECTS[Effect.ESTIMATE](fake_workcell(cell), context)
    assert used == [priors]
    assert sum(priors.values()) == pytest.approx(1.0) and set(priors) == set(FoldState)
