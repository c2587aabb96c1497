"""Run events on the page and in the report: failures, recoveries and operator commands."""

from __future__ import annotations

from cell.report.run_events import RunEvent, RunEvents
from cell.states.observers import Step
from cell.states.run_context import Result, RunContext
from cell.states.transition_table import Effect, Event, State
from robots.errors import Failure, FailureKind

FOLDING = Step(State.LIFTING, Event.DONE, State.FOLDING, Effect.FOLD)
PAUSED = Step(State.FOLDING, Event.PAUSE, State.PAUSED, Effect.WAIT)


def told(step: Step, result: Result) -> list[RunEvent]:
    remarks = RunEvents()
    remarks.performed(9.0, step, result)
    return remarks.list


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
    assert told(FOLDING, Result(Event.PAUSE, RunContext(), {"interrupted": True})) == [
        RunEvent(9.0, "command", "pause", "before folding")
    ]
    assert told(PAUSED, Result(Event.RESUME, RunContext(), {"command": "resume"})) == [
        RunEvent(9.0, "command", "resume", "while paused")
    ]


def test_the_estimated_state_of_the_garment_is_part_of_the_timeline() -> None:
    estimating = Step(State.LOOKING, Event.TOUCHED, State.ESTIMATING, Effect.ESTIMATE)
    says = "the garment lies as before the fold (confidence 0.97)"
    assert told(estimating, Result(Event.DONE, RunContext(), {"says": says})) == [
        RunEvent(9.0, "estimate", "state of the garment", says)
    ]
