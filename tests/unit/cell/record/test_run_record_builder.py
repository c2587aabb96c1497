"""The record that grows with the run: failures, recoveries and operator commands."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import pytest

from foldcell.cell.record.run_record import FoldRecord, GraspRecord, RunEvent
from foldcell.cell.states.observers import Step
from foldcell.cell.states.run_context import Result, RunContext, RunEnd
from foldcell.cell.states.transition_table import Effect, Event, State
from foldcell.robots.errors import Failure, FailureKind
from foldcell.robots.ports import Side
from foldcell.skills.grasping.confirm import Held, LayerCount
from tests.builders.contexts import context_with
from tests.builders.records import record_builder

FOLDING = Step(State.LIFTING, Event.DONE, State.FOLDING, Effect.FOLD)
PAUSED = Step(State.FOLDING, Event.PAUSE, State.PAUSED, Effect.WAIT)


def told(step: Step, result: Result) -> tuple[RunEvent, ...]:
    builder = record_builder()
    builder.performed(9.0, step, result)
    return builder.events


def test_a_pause_during_a_motion_is_announced_before_the_end_of_the_motion() -> None:
    slipped = RunContext().with_failure(Failure(FailureKind.SLIPPED, "the left hand lost it", "grip harder"))
    said = told(FOLDING, Result(Event.FAILED, slipped, {}, ((5.0, "paused"), (7.5, "resumed"))))
    assert [(r.t, r.kind, r.title) for r in said] == [
        (5.0, "command", "paused"),
        (7.5, "command", "resumed"),
        (9.0, "failure", "slipped while folding"),
    ]
    assert said[0].text == "while folding"


def test_the_begin_and_end_of_a_pause_between_effects_are_announced() -> None:
    assert told(FOLDING, Result(Event.PAUSE, RunContext(), {"interrupted": True})) == (
        RunEvent(9.0, "command", "pause", "before folding"),
    )
    assert told(PAUSED, Result(Event.RESUME, RunContext(), {"command": "resume"})) == (
        RunEvent(9.0, "command", "resume", "while paused"),
    )


def test_the_estimated_state_of_the_garment_is_part_of_the_timeline() -> None:
    estimating = Step(State.LOOKING, Event.TOUCHED, State.ESTIMATING, Effect.ESTIMATE)
    says = "the garment lies as before the fold (confidence 0.97)"
    assert told(estimating, Result(Event.DONE, RunContext(), {"says": says})) == (
        RunEvent(9.0, "estimate", "state of the garment", says),
    )


STEPS: Any = tuple(SimpleNamespace(name=name) for name in ("half", "quarter"))
ARC: Any = SimpleNamespace(source="library", simulations=3, duration=4.0)


def folds_of(context: RunContext) -> tuple[FoldRecord, ...]:
    return record_builder().record(RunEnd(State.NOT_FOLDED, context, 0.0, 9.0, {})).steps


@pytest.mark.parametrize("diagnosis", [None, FailureKind.DROPPED_CORNER])
def test_a_fold_in_progress_has_the_figures_that_it_has_reached(diagnosis: FailureKind | None) -> None:
    seen: Any = SimpleNamespace(
        iou=0.91, iou_aligned=0.94, drift_m=0.004, height_m=float("nan"), diagnosis=diagnosis
    )
    half, quarter = folds_of(context_with(steps=STEPS, trajectory=ARC, grasps=2, inspection=seen))
    assert (half.source, half.simulations, half.attempts, half.done) == ("library", 3, 2, False)
    assert (half.observed_iou, half.aligned_iou, half.drift_m) == (0.91, 0.94, 0.004)
    assert half.observed_height_m is None, "the height was not visible"
    assert half.accepted is (False if diagnosis else None), "an accepted fold that is not done is not told"
    assert quarter == FoldRecord("quarter")


def test_repairs_and_pulls_are_told_in_the_rows_of_their_folds() -> None:
    repairs = ((0, "spread: both hands pull"), (1, "undo: carried back"), (1, "undo: carried back"))
    half, quarter = folds_of(replace(context_with(steps=STEPS, trajectory=ARC), repairs=repairs))
    assert half.repairs == ("spread: both hands pull",)
    assert quarter.repairs == ("undo: carried back",) * 2


def test_the_duration_of_a_fold_is_that_of_the_arms_motion() -> None:
    """The arc at nominal speed would have another duration."""
    motion: Any = SimpleNamespace(fold=SimpleNamespace(duration=7.5))
    half, _ = folds_of(context_with(steps=STEPS, trajectory=ARC, motion=motion))
    assert half.duration_s == 7.5 and half.observed_iou is None


GRASPING = Step(State.APPROACHING, Event.DONE, State.GRASPING, Effect.GRASP)
TOUCHED = {"contact_height_m": {"left": 0.004, "right": 0.006}, "contact_by": {"left": "tip", "right": "effort"}}


def test_each_fold_has_what_the_hands_felt_in_its_grasps() -> None:
    values = {"side": "left", "force_n": 0.21, "opening_m": 0.0011, "layers": 0}
    first = context_with(steps=STEPS, index=0)
    missed = first.failed(Failure(FailureKind.MISSED_GRASP, "nothing", "lower", values), TOUCHED)
    sides = ((Side.LEFT, 1.8, 0.0034), (Side.RIGHT, 1.6, 0.0036))
    held = {s: Held(20.0, grip, opening, LayerCount((0.0, 0.1, 0.9), 2.1, 0.3)) for s, grip, opening in sides}
    holding = context_with(first, held=held)
    builder = record_builder()
    builder.performed(9.0, GRASPING, missed)
    builder.performed(20.0, GRASPING, Result(Event.DONE, holding, TOUCHED))
    untouched = context_with(holding, index=1).failed(Failure(FailureKind.NO_CONTACT, "no table", "look", {}))
    builder.performed(30.0, GRASPING, untouched)
    half, quarter = builder.record(RunEnd(State.NOT_FOLDED, untouched.context, 0.0, 31.0, {})).steps
    assert half.grasps == (
        GraspRecord(9.0, "left", 0.004, "tip", 0.21, 0.0011, 0, FailureKind.MISSED_GRASP),
        GraspRecord(9.0, "right", 0.006, "effort", failed=FailureKind.MISSED_GRASP),
        GraspRecord(20.0, "left", 0.004, "tip", 1.8, 0.0034, 2),
        GraspRecord(20.0, "right", 0.006, "effort", 1.6, 0.0036, 2),
    )
    assert quarter.grasps == (), "hands that touched nothing felt nothing"


def test_a_resumed_run_says_so_first() -> None:
    builder = record_builder(resumed_from="run-0")
    builder.performed(9.0, FOLDING, Result(Event.PAUSE, RunContext()))
    record = builder.record(RunEnd(State.STOPPED, RunContext(), 2.0, 9.0, {}), signal=15)
    assert [(e.t, e.title) for e in record.events] == [(2.0, "resumed run-0"), (9.0, "pause")]
    assert (record.resumed_from, record.result, record.exit_code) == ("run-0", "not_folded", 143)
