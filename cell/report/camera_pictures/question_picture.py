"""Draws what the operator is asked about over the camera's latest picture: the planned fold, the pressing, or what
was expected before a failure. Keeps the picture of every question in the run's folder."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import suppress
from pathlib import Path

import numpy as np

from foldcell.cell.report.camera_pictures.projected_drawing import Colour, Picture, ProjectedDrawing
from foldcell.cell.states.observers import Step
from foldcell.cell.states.run_context import Result, RunContext
from foldcell.cell.states.stages import Attempt, Plan, Spread
from foldcell.cell.states.transition_table import State
from foldcell.cell.support.files.encoded_picture import jpeg_file
from foldcell.cell.support.files.whole_file import write_whole
from foldcell.robots.errors import StorageError
from foldcell.robots.ports import Array, CameraFrame, Side
from foldcell.skills.fold_figures.drawn_mesh import outline
from foldcell.skills.fold_plan.folding import fold_xy
from foldcell.skills.vocabulary import CameraCalibration, PredictedShape

FOLDER = "questions"
OUTLINE: Colour = (60, 230, 110)
EXPECTED: Colour = (255, 205, 60)
FOLD_LINE: Colour = (255, 255, 255)
POINT: Colour = (255, 90, 80)
ARCS: dict[Side, Colour] = {Side.LEFT: (90, 190, 255), Side.RIGHT: (240, 120, 255)}
EXTRA = 0.04
"""The fold line is drawn this much longer than the garment at both ends [m]."""
BELOW = 12, 22
"""Place of a name beside its point [px]: below it, because the name of a key point is above."""
TOO_SHORT = 0.03
"""Contours whose extent is smaller are noise and are not drawn [m]."""


def draw_plan(frame: CameraFrame, calibration: CameraCalibration, context: RunContext) -> Picture:
    """Draw the planned fold, its repair, or a pull: outline, key points, fold line, the arcs of the hands, and the
    predicted outline, or the one that a pull aims at. Returns (h, w, 3): only the picture if the context has no
    plan or no attempt."""
    drawing, plan, attempt = ProjectedDrawing(frame, calibration), context.plan, context.fold.attempt
    if plan is None or attempt is None:
        return drawing.picture
    entries = []
    garment = present_outline(context)
    if garment is not None:
        drawing.line(garment, OUTLINE, closed=True)
        entries.append(("garment", OUTLINE, False))
    for contour in _contours(attempt.predicted):
        drawing.dashes(contour, EXPECTED, closed=True)
    entries.append((_aim(context), EXPECTED, True))
    pulled = isinstance(context.fold.repair, Spread)
    if not pulled:
        drawing.dashes(_fold_line(attempt, garment), FOLD_LINE, dash=0.006)
        entries.append(("fold line", FOLD_LINE, True))
    if context.fold.index == 0 and not pulled:  # where its key points are in a heap is not known
        for name, point in plan.flat.keypoints.items():
            drawing.dot(fold_xy(attempt.step.earlier, point), POINT, radius=5)
            drawing.name(name.replace("_", " "), fold_xy(attempt.step.earlier, point))
        entries.append(("key point", POINT, False))
    entries += _arcs(drawing, attempt)
    drawing.title(_title(context, plan))
    drawing.legend(entries)
    return drawing.picture


def draw_pressing(frame: CameraFrame, calibration: CameraCalibration, context: RunContext) -> Picture:
    """Draw the planned pressing: the outline of the fold, the paths of the pressing hands. Returns (h, w, 3)."""
    drawing, attempt = ProjectedDrawing(frame, calibration), context.fold.attempt
    if context.plan is None or attempt is None or attempt.press_plan is None:
        return drawing.picture
    inspection = attempt.press_plan.inspection
    drawing.line(inspection.contour, OUTLINE, closed=True)
    entries = [("garment", OUTLINE, False)]
    for side, posture in attempt.press_plan.motion.postures.items():
        drawing.line(attempt.press_plan.paths[posture.path].position, ARCS[side])
        entries.append((f"{side.value} hand presses", ARCS[side], False))
    drawing.title(f"{_title(context, context.plan)}: press it flat?")
    drawing.legend(entries)
    return drawing.picture


def draw_failure(frame: CameraFrame, calibration: CameraCalibration, context: RunContext) -> Picture:
    """Draw what was expected and what is seen after a failure. Returns (h, w, 3)."""
    drawing, attempt = ProjectedDrawing(frame, calibration), context.fold.attempt
    entries = []
    if attempt is not None and context.plan is not None:
        plan = context.plan
        believed = PredictedShape(plan.vertices, plan.mesh.triangles, plan.mesh.rest)
        expected = attempt.predicted if attempt.carried else believed
        for contour in _contours(expected):
            drawing.dashes(contour, EXPECTED, closed=True)
        entries.append(("expected", EXPECTED, True))
        if attempt.inspection is not None:
            drawing.line(attempt.inspection.contour, OUTLINE, closed=True)
            entries.append(("seen", OUTLINE, False))
    if context.failure is not None:
        drawing.title(context.failure.kind.value.replace("_", " "))
    if entries:
        drawing.legend(entries)
    return drawing.picture


def present_outline(context: RunContext) -> Array | None:
    """Return the garment's outline (n, 2) [m] before the present fold, as it was last seen: by the inspection of
    the fold before, else when it was recognised. None before that. Before a repair: as it was estimated to lie;
    before a pull: as it was seen."""
    repair = context.fold.repair
    if isinstance(repair, Spread):
        return repair.contour
    if repair is not None and context.plan is not None:
        return max(outline(repair.vertices, context.plan.mesh.triangles), key=len, default=None)
    last = context.done[-1].inspected if context.done else None
    if last is not None and len(last.contour) >= 3:
        return np.asarray(last.contour)
    return None if context.recognition is None else context.recognition.perception.state.contour


QUESTIONS: Mapping[State, Callable[[CameraFrame, CameraCalibration, RunContext], Picture]] = {
    State.AWAITING_APPROVAL: draw_plan,
    State.AWAITING_PRESSING: draw_pressing,
    State.ASKING: draw_failure,
}
"""The states in which the cell asks, and what is drawn for their questions."""


class QuestionFiles:
    """An observer that writes `questions/NN-STATE.jpg` when the cell asks: the picture that the operator sees. A
    picture that cannot be written never ends the run."""

    def __init__(self, run_folder: Path, calibration: CameraCalibration) -> None:
        self._folder, self._nominal = run_folder / FOLDER, calibration
        self._context = RunContext()
        self._count = 0

    def entered(self, t: float, step: Step) -> None:
        frame = self._context.sight.shown
        if step.target not in QUESTIONS or frame is None:
            return
        self._count += 1
        calibration = self._context.sight.calibration(self._nominal)
        picture = QUESTIONS[step.target](frame, calibration, self._context)
        with suppress(StorageError, OSError):
            self._folder.mkdir(exist_ok=True)
            write_whole(self._folder / f"{self._count:02d}-{step.target.value}.jpg", jpeg_file(picture))

    def performed(self, t: float, step: Step, result: Result) -> None:
        self._context = result.context


def _aim(context: RunContext) -> str:
    repair = context.fold.repair
    if isinstance(repair, Spread):
        return "where it belongs"
    return "after the fold" if repair is None else "after the repair"


def _arcs(drawing: ProjectedDrawing, attempt: Attempt) -> list[tuple[str, Colour, bool]]:
    entries = []
    for side, posture in attempt.motion.postures.items():
        path = attempt.paths[posture.path].position
        drawing.line(path, ARCS[side])
        drawing.dot(path[0], ARCS[side])
        drawing.dot(path[-1], ARCS[side], radius=6)
        drawing.name("grasp", path[0], ARCS[side], BELOW)
        entries.append((f"{side.value} hand", ARCS[side], False))
    return entries


def _fold_line(attempt: Attempt, garment: Array | None) -> Array:
    """Return the ends (2, 2) of the visible part of the fold line [m]."""
    line = attempt.step.line
    shape = attempt.predicted.vertices[:, :2] if garment is None else garment
    along = (shape - line.point) @ line.direction
    near = np.abs(line.signed_distance(shape)) < np.ptp(along)
    ends = np.array([along[near].min() - EXTRA, along[near].max() + EXTRA])
    return np.asarray(line.point + ends[:, None] * line.direction)


def _contours(shape: PredictedShape) -> list[Array]:
    return [c for c in outline(shape.vertices, shape.triangles) if np.ptp(c, axis=0).max() > TOO_SHORT]


def _title(context: RunContext, plan: Plan) -> str:
    step = plan.steps[context.fold.index]
    repair = context.fold.repair
    what = "" if repair is None else f"{repair.name} "
    return f"{what}fold {context.fold.index + 1} of {len(plan.steps)}: {step.name.replace('_', ' ')}"
