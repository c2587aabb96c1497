"""The failures of a run as stories: what is told, in which order, and which pictures are shown."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import synthetic_run as show
from synthetic_report import report_pictures
from test_report import page_of

from foldcell.cell.report.failure_stories import FailureStories, FailureStory
from foldcell.cell.states.observers import Step
from foldcell.cell.states.recovery_table import Adjustment, Laying
from foldcell.cell.states.run_context import Result, RunContext
from foldcell.cell.states.stages import EstimateNote
from foldcell.cell.states.transition_table import TRANSITIONS, Effect, Event, State
from foldcell.robots.errors import Failure, FailureKind
from tests.builders.contexts import context_with

SLIPPED = Failure(FailureKind.SLIPPED, "the left hand lost the cloth", "grip harder")
HALF = Failure(FailureKind.HALF_FOLDED, "fold half: the fold is half made", "lay it as it was")
SAYS = "the fold is half made: the left corner slipped out (confidence 0.93)"
ESTIMATE_SHADE = 201


def towel(turned: float, sequence: int, t: float):  # type: ignore[no-untyped-def]
    sheet = show.Towel.make(9, 13)
    vertices = np.column_stack([sheet.material, np.full(len(sheet.material), 0.001)])
    step = show.steps()[0]
    return show.picture(show.turned(vertices, step.line, turned, 0.003), sheet, sequence, t)


def effect_of(state: State) -> Effect:
    """Return the effect that the state is named after; a skipped fold enters INSPECTING without it."""
    if state is State.INSPECTING:
        return Effect.INSPECT
    return next(row.effect for row in TRANSITIONS if row.target is state)


class Run:
    """Performs effects of a pretended run before an observer."""

    def __init__(self) -> None:
        self.stories = FailureStories(show.calibration())
        self.context, self.t = RunContext(), 0.0

    def perform(self, state: State, event: Event = Event.DONE, *, effect: Effect | None = None, **record) -> None:  # type: ignore[no-untyped-def]
        self.t += 1.0
        step = Step(State.IDLE, Event.DONE, state, effect or effect_of(state))
        self.stories.performed(self.t, step, Result(event, self.context, record))

    def look(self, turned: float, state: State = State.LOOKING) -> None:
        frame = towel(turned, int(self.t) + 1, self.t)
        self.context = context_with(self.context, frame=frame)
        self.perform(state, effect=Effect.LOOK)

    def fail(self, state: State, failure: Failure) -> None:
        self.context = self.context.with_failure(failure)
        self.perform(state, Event.FAILED)


@pytest.fixture(scope="module")
def undone() -> tuple[FailureStory, ...]:
    """A hand slips, the cloth is laid back half way, the fold is found half made, undone, and the garment is
    recognised again."""
    run = Run()
    run.look(0.0)
    run.perform(State.RECOGNISING)
    run.context = context_with(run.context, steps=show.steps())
    run.perform(State.APPROACHING)
    run.fail(State.FOLDING, SLIPPED)
    run.perform(State.LAYING_BACK, laying=Laying.BACK.value)
    run.perform(State.CLEARING)
    run.perform(State.RECOVERING, Event.LOOK_AGAIN, change=Adjustment.STRONGER.value)
    run.look(2.0)
    picture = np.full((48, 64, 3), ESTIMATE_SHADE, np.uint8)
    run.context = replace(run.context, estimates=(EstimateNote(0, run.t, SAYS, picture),))
    run.fail(State.ESTIMATING, HALF)
    run.perform(State.RECOVERING, Event.REPAIR, change=Adjustment.NONE.value)
    run.perform(State.PLANNING_MOTION)
    run.perform(State.FOLDING)
    run.look(0.0, State.LOOKING_AFTER)
    run.perform(State.RECOGNISING)
    return run.stories.stories


def test_a_failure_is_told_from_the_picture_before_to_the_picture_after(undone: tuple[FailureStory, ...]) -> None:
    (story,) = undone
    assert story.title == "slipped while folding" and story.what == SLIPPED.what and story.t == 4.0
    assert [scene.caption for scene in story.thought] == [SAYS]
    assert [scene.caption for scene in story.done] == [
        "laid the cloth down where it was taken",
        "opened the hands and parked the arms",
        "looked again, with a firmer grip",
        "planned to put the moved cloth right",
        "fold far half over, once more",
    ]
    assert [scene.caption for scene in story.after] == ["the garment was found, to be folded from here"]
    times = [scene.t for part in (story.thought[:1], story.done[4:], story.after) for scene in part]
    assert times == sorted(times)


def test_a_picture_of_the_empty_table_that_was_refused_is_shown() -> None:
    run = Run()
    seen = context_with(run.context, refused=towel(0.0, 1, 0.0))
    run.context = seen
    run.fail(State.PHOTOGRAPHING, Failure(FailureKind.VIEW_OBSTRUCTED, "something reaches in", "take it away"))
    (story,) = run.stories.stories
    (shown,) = [scene for scene in story.thought if scene.rgb is not None]
    assert shown.caption == "something reaches in" and story.title == "view obstructed while photographing"


def test_each_part_shows_the_picture_of_its_time(undone: tuple[FailureStory, ...]) -> None:
    (story,) = undone
    (before,), (thought,), (after,) = story.before, story.thought, story.after
    assert before.rgb is not None and thought.rgb is not None and after.rgb is not None
    assert (thought.rgb == ESTIMATE_SHADE).all()

    def cloth(rgb: np.ndarray) -> float:
        """Share of the picture that is blue like the towel."""
        r, _, b = (rgb[..., k].astype(int) for k in range(3))
        return float((b > r + 30).mean())

    flat, folded = (cloth(towel(turned, 1, 0.0).rgb) for turned in (0.0, 2.0))
    assert folded < 0.8 * flat
    assert cloth(before.rgb) == pytest.approx(flat, rel=0.05)
    assert cloth(after.rgb) == pytest.approx(flat, rel=0.05)
    assert all(scene.rgb.shape[1] == 640 for scene in (before, after) if scene.rgb is not None)


def test_a_run_without_failures_has_no_story() -> None:
    run = Run()
    run.look(0.0)
    for state in (State.RECOGNISING, State.APPROACHING, State.FOLDING):
        run.perform(state)
    assert run.stories.stories == ()


def test_a_story_that_does_not_end_is_told_up_to_the_last_picture() -> None:
    run = Run()
    run.look(0.0)
    run.perform(State.RECOGNISING)
    run.fail(State.CHECKING, Failure(FailureKind.GARMENT_MOVED, "the garment has moved by 80 mm"))
    run.perform(State.RECOVERING, Event.LOOK_AGAIN)
    run.look(1.0)
    run.fail(State.RECOGNISING, Failure(FailureKind.NO_GARMENT, "there is no garment"))
    run.perform(State.RECOVERING, Event.GIVE_UP, reason="only a person can change what lies on the table")
    (story,) = run.stories.stories
    assert [scene.caption for scene in story.thought] == ["the garment has moved by 80 mm", "there is no garment"]
    assert [scene.rgb is None for scene in story.thought] == [True, False], "the first picture is shown before"
    assert story.done[-1].caption == "ended the run: only a person can change what lies on the table"
    assert [(s.rgb, s.caption) for s in story.after] == [(None, "the run ended, and no other picture was taken")]


def test_each_failure_after_which_the_run_went_on_has_its_own_story() -> None:
    run = Run()
    for what in ("first", "second"):
        run.look(0.0)
        run.perform(State.RECOGNISING)
        run.fail(State.APPROACHING, Failure(FailureKind.TRACKING_ERROR, what))
        run.perform(State.CLEARING)
    run.fail(State.CLEARING_AGAIN, Failure(FailureKind.START_MISMATCH, "an arm was pushed"))
    first, second = run.stories.stories
    assert (first.what, second.what) == ("first", "second")
    assert second.done[-1].caption == "start mismatch while clearing again: an arm was pushed"
    assert len(first.after) == 1


def test_a_fold_that_is_pressed_has_not_ended_its_story() -> None:
    run = Run()
    run.look(1.0, State.LOOKING_AFTER)
    run.fail(State.INSPECTING, Failure(FailureKind.TOO_HIGH, "it stands 40 mm high"))
    run.perform(State.RECOVERING, Event.LOOK_AGAIN)
    run.perform(State.INSPECTING, Event.PRESS)
    assert len(run.stories.stories) == 1 and "no other picture" in run.stories.stories[0].after[0].caption
    run.look(1.5, State.LOOKING_AFTER)
    run.perform(State.INSPECTING, Event.NEXT_FOLD)
    assert [s.after[0].caption for s in run.stories.stories] == ["the fold was accepted"]


def test_the_page_tells_the_story_in_order(undone: tuple[FailureStory, ...]) -> None:
    page = page_of(pictures=replace(report_pictures(), stories=undone))
    assert page.open == []
    parts = ["Slipped while folding", SLIPPED.what, "Before", "What was seen", SAYS, "What was done", "After"]
    begin = page.text.index(parts[0])
    places = [page.text.index(part, begin) for part in parts]
    assert places == sorted(places)
    pictures = [s for s in page.sources if s.startswith("data:image/jpeg")]
    without = [s for s in page_of().sources if s.startswith("data:image/jpeg")]
    assert len(pictures) == len(without) + 4
