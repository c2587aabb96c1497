"""The operator's picture: when it is taken, how old it is, and that it changes nothing at the ports."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from itertools import count
from types import SimpleNamespace

import numpy as np
import pytest

from foldcell.cell.operator.console.live_view import PERIOD_S, LiveView
from foldcell.cell.simulation import Display
from foldcell.cell.states.observers import Step
from foldcell.cell.states.run_context import Result, RunContext
from foldcell.cell.states.transition_table import Effect, Event, State
from foldcell.robots.errors import DriverError, FailureKind
from foldcell.robots.ports import ArmTrajectory, CameraFrame, Side
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


def display(
    take: Callable[[], Callable[[], CameraFrame | None]], progress: Callable[[], int] | None = None
) -> Display:
    """Pictures of a simulated cell. By default it advances with every question about its progress."""
    return Display(take, progress or count().__next__, lambda tell: None)


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


def frame_of(brightness: int) -> CameraFrame:
    seen = render(Scene(), camera())
    return replace(seen, rgb=np.full_like(seen.rgb, brightness))


def test_the_same_picture_becomes_younger_and_is_not_sent_again() -> None:
    watch = Watch()
    view, shown = LiveView(camera(), watch, at_once), iter([10, 10, 20])

    def take() -> Callable[[], CameraFrame]:
        frame = frame_of(next(shown))
        return lambda: frame

    ports = view.between(FakeCell().ports(), display(take))
    seen = []
    for _ in range(3):
        ports.stop.state()
        seen.append(view.about())
        watch.t += 2.0 * PERIOD_S
    assert [about["age_s"] for about in seen] == [0.0, 0.0, 0.0]  # type: ignore[index]
    numbers = [about["number"] for about in seen]  # type: ignore[index]
    assert numbers[0] == numbers[1] < numbers[2]


def test_a_camera_that_fails_only_ages_the_picture() -> None:
    cell, watch, answers = FakeCell(), Watch(), [render(Scene(), camera())]
    view = LiveView(camera(), watch, at_once)

    def take() -> Callable[[], CameraFrame]:
        if not answers:
            raise DriverError(FailureKind.CAMERA_FAULT, "the camera does not answer")
        frame = answers.pop()
        return lambda: frame

    ports = view.between(cell.ports(), display(take))
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


def folding(seen: CameraFrame) -> RunContext:
    """A context with an arc that bends all joints by 1 rad in 2 s."""
    t = np.linspace(0.0, 2.0, 201)
    q = np.outer(t / 2.0, np.ones(14))
    motion = SimpleNamespace(fold=ArmTrajectory(t, q, q, q), tool_paths={}, postures={}, duration=12.0)
    return context_with(frame=seen, plan_frames=np.zeros((5, 3, 3)), motion=motion)


def test_progress_is_the_share_of_the_arc_that_is_done() -> None:
    """A pause does not count as progress: the arms are at the same place after it."""
    cell, watch = FakeCell(np.full(14, 0.75)), Watch()
    view = LiveView(camera(), watch, at_once)
    perform(view, folding(render(Scene(), camera())))
    ports = view.between(cell.ports())
    enter(view, State.FOLDING, t=10.0)
    ports.arms.command(np.full(14, 0.75), np.zeros(14))
    for pause in (1.5, 8.0):
        cell.now += pause
        watch.t += pause
        ports.stop.state()
        assert view.about()["progress"] == pytest.approx(0.75)  # type: ignore[index]
    enter(view, State.RELEASING, t=22.0)
    assert view.about()["progress"] is None  # type: ignore[index]


def test_a_simulated_cell_gives_its_own_pictures_for_display() -> None:
    """Taking them must not count at the camera that the executive uses."""
    cell, frame = FakeCell(), render(Scene(), camera())
    view, inner, taken = LiveView(camera(), offer=at_once), cell.ports(), []
    view.between(inner, display(lambda: taken.append(1) or (lambda: frame))).stop.state()
    assert taken == [1] and view.about() is not None


def test_the_executive_does_not_wait_for_a_picture_that_is_being_rendered() -> None:
    """Its age counts from the moment at which it was taken, and no other picture is taken meanwhile."""
    watch, frame, works = Watch(), render(Scene(), camera()), []
    view, taken = LiveView(camera(), watch, lambda work: works.append(work) or True), []
    ports = view.between(FakeCell().ports(), display(lambda: taken.append(watch.t) or (lambda: frame)))
    for _ in range(3):
        ports.stop.state()
        watch.t += 2.0 * PERIOD_S
    assert len(taken) == 1 and view.about() is None
    works.pop()()
    assert view.about()["age_s"] == pytest.approx(watch.t - taken[0])  # type: ignore[index]
    ports.stop.state()
    assert len(taken) == 2


def test_a_picture_of_an_earlier_state_has_no_progress() -> None:
    works: list[Callable[[], None]] = []
    view = LiveView(camera(), offer=lambda work: works.append(work) or True)  # type: ignore[func-returns-value]
    perform(view, folding(render(Scene(), camera())))
    ports = view.between(FakeCell().ports())
    enter(view, State.FOLDING, t=10.0)
    ports.arms.command(np.zeros(14), np.zeros(14))
    ports.stop.state()
    enter(view, State.RELEASING, t=12.0)
    works.pop()()
    assert view.about()["progress"] is None  # type: ignore[index]


def test_a_picture_shows_the_present_as_long_as_the_simulated_cell_stands_still() -> None:
    """While the computer computes, the time of a simulated cell stands still: no picture is needed."""
    watch, frame, taken, steps = Watch(), render(Scene(), camera()), [], [0]
    view = LiveView(camera(), watch, at_once)
    pictures = display(lambda: taken.append(watch.t) or (lambda: frame), lambda: steps[0])
    ports = view.between(FakeCell().ports(), pictures)
    ports.stop.state()
    watch.t += 4.0
    ports.stop.state()
    assert len(taken) == 1 and view.about()["age_s"] == 0.0  # type: ignore[index]
    steps[0] += 1
    watch.t += 0.5
    assert view.about()["age_s"] == pytest.approx(0.5)  # type: ignore[index]
    ports.stop.state()
    assert len(taken) == 2


def test_pictures_are_also_taken_while_the_simulated_cell_advances_without_a_poll() -> None:
    frame = render(Scene(), camera())
    told: list[Callable[[bool], None]] = []
    view = LiveView(camera(), offer=at_once)
    view.between(FakeCell().ports(), Display(lambda: lambda: frame, count().__next__, told.append))
    assert view.about() is None
    told[0](False)
    assert view.about() is not None


def test_a_picture_is_drawn_once_before_the_page_hears_of_it() -> None:
    cell, watch = FakeCell(), Watch()
    view = LiveView(camera(), watch, at_once)
    ports = view.between(cell.ports())
    ports.stop.state()
    view.jpeg()  # a page is open
    watch.t += 2.0 * PERIOD_S
    ports.stop.state()
    first = view.jpeg()
    assert first is not None and first[0] == view.about()["number"]  # type: ignore[index]
    assert view.jpeg() is first


def test_a_picture_that_was_taken_before_a_question_does_not_hide_its_plan() -> None:
    """The question was entered while the picture was being drawn: what is shown is drawn for the question."""
    works: list[Callable[[], None]] = []
    view = LiveView(camera(), offer=lambda work: works.append(work) or True)  # type: ignore[func-returns-value]
    frame = render(Scene(), camera())
    perform(view, context_with(frame=frame))
    entered = iter([lambda: enter(view, State.AWAITING_APPROVAL)])

    def draw() -> CameraFrame:
        next(entered)()
        return frame

    ports = view.between(FakeCell().ports(), display(lambda: draw))
    ports.stop.state()
    works.pop()()
    assert view.about()["question"]  # type: ignore[index]


def test_the_last_picture_before_the_simulated_cell_stands_still_is_not_lost() -> None:
    """Neither because one was taken just before, nor because that one is still being drawn."""
    works: list[Callable[[], None]] = []
    told: list[Callable[[bool], None]] = []
    frames = iter(render(Scene(), camera()) for _ in range(4))
    view = LiveView(camera(), Watch(), lambda work: works.append(work) or True)  # type: ignore[func-returns-value]
    taken: list[CameraFrame] = []

    def take() -> Callable[[], CameraFrame]:
        taken.append(next(frames))
        frame = taken[-1]
        return lambda: frame

    view.between(FakeCell().ports(), Display(take, count().__next__, told.append))
    for rests in (False, False, True, True):
        told[0](rests)
    assert len(taken) == 3 and len(works) == 1
    works.pop()()
    assert view._moment.frame is taken[-1]
