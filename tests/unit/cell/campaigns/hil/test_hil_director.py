"""The director of HIL scripts: each action happens at its cell time."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from foldcell.cell.campaigns.hil import director as directing
from foldcell.cell.campaigns.hil.director import Director, scheduled
from foldcell.cell.campaigns.hil.script import Script
from foldcell.cell.campaigns.hil.script_run import broken_expectations
from foldcell.cell.hardware.driver import OpenCell
from foldcell.cell.record.run_record import FoldRecord, RunRecord
from foldcell.cell.states.commands import ANSWERS, CommandQueue
from foldcell.cell.states.observers import Step
from foldcell.cell.states.run_context import Result, RunContext
from foldcell.cell.states.transition_table import Effect, Event, State
from foldcell.robots.errors import Failure, FailureKind
from foldcell.robots.ports import Ports
from tests.builders.records import run_record, score_record
from tests.fakes import FakeCell

PAUSE = frozenset({Event.PAUSE})


def a_script(*actions: dict[str, Any], **expect: Any) -> Script:
    data = {"about": "a test", "garment": "small_towel", "do": actions, "expect": {"end": "folded", **expect}}
    return Script.model_validate(data)


@pytest.fixture(autouse=True)
def no_guards_left(monkeypatch: pytest.MonkeyPatch) -> None:
    """Without this, a director's guard against a stopped clock would act after a test that does not close the
    director."""
    monkeypatch.setattr(directing, "WALL_FACTOR", 1e4)


def begun(*actions: dict[str, Any]) -> tuple[Director, Ports, FakeCell, CommandQueue, list[str]]:
    cell, commands, told = FakeCell(), CommandQueue(), []
    director = Director(a_script(*actions).do, np.zeros(14), told.append)
    return director, director.begin(OpenCell(cell.ports()), commands), cell, commands, told


def enter(director: Director, state: State, cell: FakeCell) -> None:
    director.entered(cell.now, Step(State.IDLE, Event.DONE, state, Effect.NOTHING))


class Diary:
    """A schedule that notes the times of its calls."""

    def __init__(self, due: list[float], cell: FakeCell) -> None:
        self._due, self._cell, self.done = sorted(due), cell, []

    def next_due(self) -> float | None:
        return self._due[0] if self._due else None

    def carry_out(self, now: float) -> None:
        while self._due and self._due[0] <= now:
            self.done.append((self._due.pop(0), self._cell.now))


@settings(max_examples=50)
@given(st.lists(st.floats(0.0, 10.0), max_size=8), st.lists(st.floats(0.0, 10.0), min_size=1, max_size=8))
def test_scheduled_actions_happen_at_their_time_for_any_sleeps(due: list[float], sleeps: list[float]) -> None:
    cell = FakeCell()
    diary = Diary(due, cell)
    clock = scheduled(cell.ports().clock, diary)
    for t in sorted(sleeps):
        clock.sleep_until(t)
        assert clock.now() == t, "the sleep ends at the requested time"
    assert diary.done == [(t, t) for t in sorted(due) if t <= max(sleeps)]


def test_a_command_falls_between_two_set_points() -> None:
    _, ports, cell, commands, _ = begun({"when": {"time_s": 0.255}, "say": "pause"})
    ports.clock.sleep_until(0.25)
    assert commands.take(PAUSE) is None
    ports.clock.sleep_until(0.26)
    assert commands.take(PAUSE) is Event.PAUSE and cell.now == 0.26


def test_a_command_reaches_a_state_whose_effect_does_not_sleep() -> None:
    """Over ROS, a look waits for the camera's messages and not for the cell's clock."""
    director, _, cell, commands, _ = begun({"when": {"state": "looking"}, "say": "pause"})
    enter(director, State.LOOKING, cell)
    assert commands.take(PAUSE) is None, "not before the effect"
    cell.now += 1.2
    step = Step(State.IDLE, Event.DONE, State.LOOKING, Effect.LOOK)
    director.performed(cell.now, step, Result(Event.DONE, RunContext()))
    assert commands.take(PAUSE) is Event.PAUSE, "before the next effect"


def test_an_answer_that_falls_due_in_an_effect_without_a_sleep_is_given_to_the_next_question() -> None:
    """The runner drops earlier answers before it asks."""
    director, ports, cell, commands, _ = begun({"when": {"state": "planning_motion"}, "say": "approve"})
    enter(director, State.PLANNING_MOTION, cell)
    cell.now += 1.2
    step = Step(State.IDLE, Event.DONE, State.PLANNING_MOTION, Effect.PLAN_MOTION)
    director.performed(cell.now, step, Result(Event.DONE, RunContext()))
    commands.drop(ANSWERS)
    enter(director, State.AWAITING_APPROVAL, cell)
    ports.clock.sleep_until(cell.now + 0.1)
    assert commands.take(ANSWERS) is Event.APPROVE


def test_an_action_can_wait_for_a_later_visit_of_a_state() -> None:
    second = {"state": "folding", "visit": 2, "after_s": 0.5}
    director, ports, cell, _, told = begun({"when": second, "tell": "now"})
    for _ in range(2):
        enter(director, State.FOLDING, cell)
        ports.clock.sleep_until(cell.now + 0.4)
        assert not told
        if cell.now < 0.5:
            ports.clock.sleep_until(cell.now + 0.4)
            enter(director, State.RELEASING, cell)
    ports.clock.sleep_until(cell.now + 0.2)
    assert told == ["now"]


def test_an_action_is_missed_if_its_state_was_left_before_it_was_due(monkeypatch: pytest.MonkeyPatch) -> None:
    director, ports, cell, _, told = begun({"when": {"state": "folding", "after_s": 5.0}, "tell": "too late"})
    enter(director, State.FOLDING, cell)
    ports.clock.sleep_until(2.0)
    enter(director, State.RETREATING, cell)
    ports.clock.sleep_until(8.0)
    enter(director, State.FOLDED, cell)
    assert not told and [str(action) for action in director.seen().missed] == ["tell"]


def test_a_command_that_was_never_taken_breaks_the_script() -> None:
    director, ports, cell, commands, _ = begun(
        {"when": {"state": "folding"}, "say": "pause"}, {"when": {"state": "folding"}, "say": "resume"}
    )
    enter(director, State.FOLDING, cell)
    ports.clock.sleep_until(1.0)
    assert commands.take(PAUSE) is Event.PAUSE
    enter(director, State.FOLDED, cell)
    assert [str(action) for action in director.seen().missed] == ["say resume"]


def test_an_error_in_a_script_action_does_not_end_the_run() -> None:
    director, ports, *_ = begun({"when": {"time_s": 1.0}, "fault": {"kind": "no_garment"}})
    ports.clock.sleep_until(2.0)  # the fake cell has no simulation, so the fault cannot be injected
    (trouble,) = director.seen().trouble
    assert "simulated cell" in trouble
    (broken, *_) = broken_expectations(a_script(), result(), director.seen())
    assert "could not be carried out" in broken


def test_commands_wait_for_the_next_tick_but_a_stop_does_not() -> None:
    director, ports, cell, commands, _ = begun(
        {"when": {"state": "approaching"}, "say": "pause"}, {"when": {"state": "approaching"}, "stop": "now"}
    )
    enter(director, State.APPROACHING, cell)
    assert cell.stop_reason == "now" and commands.take(PAUSE) is None
    ports.clock.sleep_until(0.01)
    assert commands.take(PAUSE) is Event.PAUSE


def test_a_run_without_end_is_aborted() -> None:
    director, ports, _, commands, _ = begun()
    ports.clock.sleep_until(599.0)
    assert commands.take(frozenset({Event.ABORT})) is None and not director.seen().overdue
    ports.clock.sleep_until(601.0)
    assert commands.take(frozenset({Event.ABORT})) is Event.ABORT and director.seen().overdue
    assert not ports.stop.state().stopped
    ports.clock.sleep_until(661.0)
    assert ports.stop.state().stopped, "a run that ignores the abort is stopped"
    (broken, *_) = broken_expectations(a_script(), result(), director.seen())
    assert "still running after 600 s" in broken
    director.close()


def result(**changes: Any) -> RunRecord:
    folds = (FoldRecord("half", done=True), FoldRecord("quarter"))
    return run_record(**{"score": score_record(), "steps": folds, "robot_time_s": 30.0, **changes})


FAILED = Failure(FailureKind.MISSED_GRASP, "nothing between the pads", "look again")


def played(monkeypatch: pytest.MonkeyPatch, script: Script, *, away: float = 0.0) -> Director:
    """A run that folds after one missed grasp."""
    cell, commands = FakeCell(np.full(14, away)), CommandQueue()
    director = Director(script.do, np.zeros(14), lambda line: None)
    director.begin(OpenCell(cell.ports()), commands)
    for state in (State.LOOKING, State.GRASPING, State.RECOVERING, State.GRASPING, State.FOLDED):
        enter(director, state, cell)
        event = Event.FAILED if state is State.GRASPING and director.seen().failures == () else Event.DONE
        step = Step(State.IDLE, Event.DONE, state, Effect.NOTHING)
        director.performed(cell.now, step, Result(event, RunContext().with_failure(FAILED)))
    return director


MET = {
    "end": ["not_folded", "folded"], "failures": ["missed_grasp"], "only_failures": True, "folds": 1,
    "through": ["looking", "recovering", "grasping"], "not_through": ["paused"], "within_s": 30, "passed": True,
    "parked": True,
}  # fmt: skip


def test_a_run_that_meets_its_expectations_passes(monkeypatch: pytest.MonkeyPatch) -> None:
    script = a_script(**MET)
    assert broken_expectations(script, result(), played(monkeypatch, script).seen()) == ()


@pytest.mark.parametrize(
    ("expect", "said"),
    [
        ({"end": "stopped"}, "ended folded; expected stopped"),
        ({"failures": ["missed_grasp", "missed_grasp"]}, "had the failures missed_grasp; expected"),
        ({"failures": []}, "also had the failures"),
        ({"through": ["recovering", "looking"]}, "never entered looking"),
        ({"not_through": ["recovering"]}, "entered recovering"),
        ({"folds": 2}, "made 1 folds; expected 2"),
        ({"within_s": 29.9}, "took 30.0 s"),
        ({"passed": False}, "the scorer passed"),
        ({"parked": False}, "the arms were parked"),
    ],
)
def test_each_unmet_expectation_is_reported(
    expect: dict[str, Any], said: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    script = a_script(**{**MET, **expect})
    broken = broken_expectations(script, result(), played(monkeypatch, script).seen())
    assert len(broken) == 1 and said in broken[0]


def test_a_set_point_after_a_stop_breaks_every_script(monkeypatch: pytest.MonkeyPatch) -> None:
    seen = replace(played(monkeypatch, a_script()).seen(), sent_after_stop=2)
    assert "2 set-points were sent after a stop" in broken_expectations(a_script(), result(), seen)


def test_arms_away_from_the_rest_pose_do_not_count_as_parked(monkeypatch: pytest.MonkeyPatch) -> None:
    script = a_script(parked=True)
    (broken,) = broken_expectations(script, result(), played(monkeypatch, script, away=0.1).seen())
    assert "not parked" in broken


def test_actions_that_never_became_due_break_the_script(monkeypatch: pytest.MonkeyPatch) -> None:
    script = a_script({"when": {"state": "asking"}, "tell": "a"}, {"when": {"time_s": 99}, "tell": "b"})
    broken = broken_expectations(script, result(), played(monkeypatch, script).seen())
    assert [b.split(" never")[0] for b in broken] == ["tell (0 s into asking)", "tell (at 99 s)"]


def test_a_random_moment_of_a_stay_that_is_too_short_is_its_end() -> None:
    director, ports, cell, _, told = begun({"when": {"during": {"folding": 1000.0}}, "tell": "now"})
    enter(director, State.FOLDING, cell)
    ports.clock.sleep_until(0.01)
    assert not told
    enter(director, State.RETREATING, cell)
    assert told == ["now"]
    enter(director, State.FOLDED, cell)
    assert director.seen().missed == ()


def test_a_random_moment_within_the_stay_is_met_between_two_set_points() -> None:
    director, ports, cell, _, told = begun({"when": {"during": {"folding": 2.0}, "visits": 3}, "tell": "now"})
    moment = director.seen().missed[0].when
    for visit in range(1, 4):
        enter(director, State.FOLDING, cell)
        began = cell.now
        while cell.now < began + 2.5:
            before = cell.now
            ports.clock.sleep_until(before + 0.01)
            if told:
                assert visit == moment.visit and before <= began + moment.after_s <= cell.now + 1e-9
                return
        enter(director, State.RETREATING, cell)
    raise AssertionError(f"the moment {moment} never came")


def test_set_points_after_a_stop_are_counted_even_if_the_stop_ends_by_itself() -> None:
    director, ports, _, _, _ = begun()
    ports.arms.enable()
    ports.clock.sleep_until(0.1)
    ports.arms.command(np.zeros(14), np.zeros(14))
    assert director.seen().sent_after_stop == 0
    ports.stop.trigger("a loose contact")
    ports.clock.sleep_until(0.11)
    ports.stop.reset()
    ports.clock.sleep_until(0.2)
    ports.arms.command(np.zeros(14), np.zeros(14))
    assert director.seen().sent_after_stop == 1
