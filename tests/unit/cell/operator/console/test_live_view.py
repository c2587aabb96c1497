"""The operator's picture: when it is taken, how old it is, and that it changes nothing at the ports."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from cell.operator.console.live_view import PERIOD_S, LiveView
from cell.states.observers import Step
from cell.states.run_context import Result
from cell.states.transition_table import Effect, Event, State
from robots.errors import DriverError, FailureKind
from robots.ports import CameraFrame, Side
from tests.builders.contexts import context_with
from tests.fakes import FakeCell
from tests.scenes import Scene, camera, render


class Watch:
    """A clock in the hands of the test."""

    def __init__(self) -> None:
        self.t = 100.0

    def __call__(self) -> float:
        return self.t


def at_once(work: Callable[[], None]) -> bool:
    work()
    return True


def enter(view: LiveView, state: State, t: float = 1.0) -> None:
    view.entered(t, Step(State.IDLE, Event.DONE, state, Effect.NOTHING))


def perform(view: LiveView, context: object) -> None:
    step = Step(State.IDLE, Event.DONE, State.LOOKING, Effect.LOOK)
    view.performed(1.0, step, Result(Event.DONE, context))  # type: ignore[arg-type]


def test_a_picture_is_taken_when_the_stop_is_polled_but_not_too_often() -> None:
    cell, watch = FakeCell(), Watch()
    view = LiveView(camera(), watch, at_once)
    ports = view.between(cell.ports())
    numbers = []
    for _ in range(40):
        assert not ports.stop.state().stopped
        numbers.append(view.about()["number"])  # type: ignore[index]
        watch.t += 0.3 * PERIOD_S
    taken = len(set(numbers))
    assert taken == 10, "one picture in four polls"


def test_the_age_counts_from_the_moment_of_the_picture() -> None:
    cell, watch = FakeCell(), Watch()
    view = LiveView(camera(), watch, at_once)
    view.between(cell.ports()).stop.state()
    watch.t += 3.0
    assert view.about()["age_s"] == pytest.approx(3.0)  # type: ignore[index]


def test_a_camera_that_fails_only_ages_the_picture() -> None:
    cell, watch, answers = FakeCell(), Watch(), [render(Scene(), camera())]
    view = LiveView(camera(), watch, at_once)

    def take() -> Callable[[], CameraFrame]:
        if not answers:
            raise DriverError(FailureKind.CAMERA_FAULT, "the camera does not answer")
        frame = answers.pop()
        return lambda: frame

    ports = view.between(cell.ports(), take)
    ports.stop.state()
    watch.t += 5.0
    assert not ports.stop.state().stopped
    assert view.about()["age_s"] == pytest.approx(5.0)  # type: ignore[index]


def test_no_picture_is_taken_of_a_stopped_robot() -> None:
    """A stop must be noticed at once."""
    cell = FakeCell()
    cell.stop_reason = "test"
    view = LiveView(camera(), offer=at_once)
    assert view.between(cell.ports()).stop.state().stopped
    assert view.about() is None


def test_the_grips_are_those_that_the_cell_has_read() -> None:
    cell = FakeCell()
    cell.pads[Side.LEFT] = 7.0
    view = LiveView(camera(), offer=at_once)
    ports = view.between(cell.ports())
    reading = ports.tactile[Side.LEFT].reading()
    ports.stop.state()
    assert reading.grip == pytest.approx(7.0, abs=0.05)
    assert view.about()["grip_n"]["left"] == pytest.approx(reading.grip, abs=0.05)  # type: ignore[index]


def test_a_question_shows_the_picture_that_the_plan_was_made_from() -> None:
    seen = render(Scene(), camera())
    view = LiveView(camera(), offer=at_once)
    perform(view, context_with(frame=seen))
    enter(view, State.AWAITING_APPROVAL)
    about, drawn = view.about(), view.jpeg()
    assert about is not None and about["question"] and about["progress"] is None
    assert drawn is not None and drawn[0] == about["number"]


def test_progress_is_the_share_of_the_arc_that_is_done() -> None:
    cell, watch = FakeCell(), Watch()
    view = LiveView(camera(), watch, at_once)
    frames = np.zeros((5, 3, 3))
    perform(view, context_with(frame=render(Scene(), camera()), plan_frames=frames))  # the arc takes 2 s
    ports = view.between(cell.ports())
    enter(view, State.FOLDING, t=10.0)
    cell.now = 11.5
    ports.stop.state()
    assert view.about()["progress"] == pytest.approx(0.75)  # type: ignore[index]
    enter(view, State.RELEASING, t=12.0)
    assert view.about()["progress"] is None  # type: ignore[index]


def test_a_simulated_cell_gives_its_own_pictures_for_display() -> None:
    """Taking them must not count at the camera that the executive uses."""
    cell, frame = FakeCell(), render(Scene(), camera())
    view, inner, taken = LiveView(camera(), offer=at_once), cell.ports(), []
    view.between(inner, lambda: taken.append(1) or (lambda: frame)).stop.state()
    assert taken == [1] and view.about() is not None


def test_the_executive_does_not_wait_for_a_picture_that_is_being_rendered() -> None:
    """Its age counts from the moment at which it was taken, and no other picture is taken meanwhile."""
    watch, frame, works = Watch(), render(Scene(), camera()), []
    view, taken = LiveView(camera(), watch, lambda work: works.append(work) or True), []
    ports = view.between(FakeCell().ports(), lambda: taken.append(watch.t) or (lambda: frame))
    for _ in range(3):
        ports.stop.state()
        watch.t += 2.0 * PERIOD_S
    assert len(taken) == 1 and view.about() is None
    works.pop()()
    assert view.about()["age_s"] == pytest.approx(watch.t - taken[0])  # type: ignore[index]
    ports.stop.state()
    assert len(taken) == 2


def test_a_picture_of_an_earlier_state_has_no_progress() -> None:
    cell, works = FakeCell(), []
    view = LiveView(camera(), offer=lambda work: works.append(work) or True)
    frames = np.zeros((5, 3, 3))
    perform(view, context_with(frame=render(Scene(), camera()), plan_frames=frames))
    ports = view.between(cell.ports())
    enter(view, State.FOLDING, t=10.0)
    ports.stop.state()
    enter(view, State.RELEASING, t=12.0)
    works.pop()()
    assert view.about()["progress"] is None  # type: ignore[index]
