"""An observer of the runner. It tells each failure as a story in pictures: the garment before, the estimate of its
state, the actions of the cell, and the garment after."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from foldcell.cell.record.words import COMMANDS, laying_in_words, plain, recovery_in_words
from foldcell.cell.report.camera_pictures.projected_drawing import ProjectedDrawing
from foldcell.cell.report.camera_pictures.question_picture import OUTLINE, draw_failure, draw_plan
from foldcell.cell.states.observers import FAILING, Step
from foldcell.cell.states.run_context import Result, RunContext
from foldcell.cell.states.transition_table import Effect, Event
from foldcell.cell.support.files.encoded_picture import shrunk
from foldcell.robots.errors import Failure
from foldcell.robots.ports import Array, CameraFrame
from foldcell.skills.fold_figures.drawn_mesh import outline
from foldcell.skills.vocabulary import CameraCalibration

SEEING = frozenset({Effect.PHOTOGRAPH_TABLE, Effect.LOOK, Effect.RECOGNISE, Effect.INSPECT, Effect.CHECK_PLACE})
"""Effects whose failure says what the picture shows."""
WIDTH = 640
"""Width of the pictures [px]."""


@dataclass(frozen=True, eq=False)
class Scene:
    """One moment of a story, at cell time t [s]. rgb: (h, w, 3), or None without a picture."""

    t: float
    caption: str
    rgb: NDArray[np.uint8] | None = None


@dataclass(eq=False)
class FailureStory:
    """The story of a failure, which grows until it ends. title: the failure and the state in which it happened;
    what: as the operator reads it."""

    t: float
    title: str
    what: str
    before: list[Scene]
    thought: list[Scene] = field(default_factory=list)
    done: list[Scene] = field(default_factory=list)
    after: list[Scene] = field(default_factory=list)


class FailureStories:
    """Collects the stories of a run. A story begins with a failure. It ends when the garment is recognised, a fold
    is accepted, or the run ends.

    calibration: of the camera, as measured before the run.
    """

    def __init__(self, calibration: CameraCalibration) -> None:
        self._nominal = calibration
        self._told: list[FailureStory] = []
        self._open: FailureStory | None = None
        self._before: CameraFrame | None = None  # the last picture before which nothing had failed
        self._shown: CameraFrame | None = None  # the last picture in the present story
        self._context = RunContext()
        self._t = 0.0

    @property
    def stories(self) -> tuple[FailureStory, ...]:
        """The stories so far. A story that has not ended is told up to the last picture."""
        if self._open is None:
            return tuple(self._told)
        frame, picture, says = self._context.sight.shown, None, "the run ended, and no other picture was taken"
        if frame is not None and frame is not self._shown:
            picture, says = draw_failure(frame, self._calibration, self._context), "the last picture of the run"
        return (*self._told, replace(self._open, after=[Scene(self._t, says, _small(picture))]))

    def entered(self, t: float, step: Step) -> None: ...

    def performed(self, t: float, step: Step, result: Result) -> None:
        before, self._context, self._t = self._context, result.context, t
        if result.event in FAILING and result.context.failure is not None:
            self._failed(t, step, before, result.context.failure)
            return
        if self._open is not None:
            self._went_on(t, step, result, self._open, before)
        settled = _settled(step.effect, result.event)
        if settled:
            self._settle(t, step.effect, settled)

    def _failed(self, t: float, step: Step, before: RunContext, failure: Failure) -> None:
        title = plain(f"{failure.kind} while {step.target}")
        story, frame = self._open, self._context.sight.shown
        if story is None:
            story = self._open = FailureStory(t, title, failure.what, self._scene_before(before))
            self._shown = self._before
        elif step.effect not in SEEING | {Effect.ESTIMATE}:
            story.done.append(Scene(t, f"{title}: {failure.what}"))
        if step.effect in SEEING:
            new = frame is not None and frame is not self._shown
            picture = draw_failure(frame, self._calibration, self._context) if frame is not None and new else None
            story.thought.append(Scene(t, failure.what, _small(picture)))
            self._shown = frame
        if not self._estimated(t, story, before) and step.effect is Effect.ESTIMATE:
            story.thought.append(Scene(t, failure.what))

    def _went_on(self, t: float, step: Step, result: Result, story: FailureStory, before: RunContext) -> None:
        frame = self._context.sight.frame
        self._estimated(t, story, before)
        if step.effect is Effect.CHOOSE_RECOVERY:
            story.done.append(Scene(t, recovery_in_words(result.event, result.record)))
        elif step.effect is Effect.LAY_BACK:
            story.done.append(Scene(t, laying_in_words(result.record)))
        elif step.effect in {Effect.CLEAR, Effect.CLEAR_AGAIN}:
            story.done.append(Scene(t, "opened the hands and parked the arms"))
        elif step.effect is Effect.PLAN_MOTION and frame is not None and self._context.plan is not None:
            picture = draw_plan(frame, self._calibration, self._context)
            story.done.append(Scene(t, _planned(self._context), _small(picture)))
        elif "command" in result.record:
            answer = COMMANDS[Event(str(result.record["command"]))]
            story.done.append(Scene(t, f"the operator answered: {answer}"))

    def _estimated(self, t: float, story: FailureStory, before: RunContext) -> bool:
        """Add the estimate that was just made. Returns whether one was made."""
        notes = self._context.estimates
        if len(notes) <= len(before.estimates):
            return False
        story.thought.append(Scene(notes[-1].t, notes[-1].says, _small(notes[-1].picture)))
        self._shown = self._context.sight.frame
        return True

    def _scene_before(self, context: RunContext) -> list[Scene]:
        """Return the last good picture with the plan of the attempt that failed, if it was planned from there."""
        frame = self._before
        if frame is None:
            return []
        if context.plan is not None and context.fold.attempt is not None:
            return [Scene(frame.stamp, "the planned fold", _small(draw_plan(frame, self._calibration, context)))]
        return [Scene(frame.stamp, "the garment before", frame.rgb)]

    def _settle(self, t: float, effect: Effect, settled: str) -> None:
        """End the story: the cell knows how the garment lies."""
        frame = self._context.sight.frame
        if self._open is not None:
            picture = None if frame is None else _outlined(frame, self._calibration, _seen(effect, self._context))
            self._told.append(replace(self._open, after=[Scene(t, settled, _small(picture))]))
            self._open = None
        self._before = frame

    @property
    def _calibration(self) -> CameraCalibration:
        return self._context.sight.calibration(self._nominal)


def _planned(context: RunContext) -> str:
    assert context.plan is not None
    fold = plain(context.plan.steps[context.fold.index].name)
    repair = context.fold.repair
    return f"fold {fold}, once more" if repair is None else f"fold {fold}: {repair.in_words()}"


def _settled(effect: Effect, event: Event) -> str:
    """Return in words that the cell knows how the garment lies; empty if it does not know it yet."""
    if effect is Effect.RECOGNISE:
        return "the garment was found, to be folded from here"
    if effect not in {Effect.INSPECT, Effect.NEXT_STEP} or event not in {
        Event.NEXT_FOLD,
        Event.ALL_FOLDED,
        Event.GIVE_UP,
    }:
        return ""
    return "the fold was accepted" if effect is Effect.INSPECT else "the run went on from this fold"


def _seen(effect: Effect, context: RunContext) -> list[Array]:
    """Return the outlines (n, 2) of the garment as the effect has seen it [m]."""
    if effect is not Effect.RECOGNISE:
        last = context.done[-1].inspected if context.done else None
        return [last.contour] if last is not None and len(last.contour) >= 3 else []
    if context.fold.index and context.plan is not None:
        return outline(context.plan.vertices, context.plan.mesh.triangles)
    return [] if context.recognition is None else [context.recognition.perception.state.contour]


def _outlined(frame: CameraFrame, calibration: CameraCalibration, contours: Sequence[Array]) -> NDArray[np.uint8]:
    drawing = ProjectedDrawing(frame, calibration)
    for contour in contours:
        drawing.line(contour, OUTLINE, closed=True)
    if contours:
        drawing.legend([("garment", OUTLINE, False)])
    return drawing.picture


def _small(picture: NDArray[np.uint8] | None) -> NDArray[np.uint8] | None:
    """Return the picture at the width at which the report shows it."""
    return None if picture is None else shrunk(picture, WIDTH)
