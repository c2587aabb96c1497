"""The pictures of one run: what all of them share, the drawn attempts, and the film."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from foldcell.cell.record.words import plain
from foldcell.cell.report.pictures.film import (
    SIZE,
    CaptionedPicture,
    DrawnHold,
    TrueFrame,
    draw_hold,
    film_file,
    held_during,
    holds,
)
from foldcell.cell.report.pictures.fold_pictures import KeyFrame, Scenery, View, motion_view
from foldcell.cell.report.pictures.garment_look import garment_look, outlined
from foldcell.cell.states.run_context import RunContext
from foldcell.cell.states.stages import FoldNote
from foldcell.robots.ports import Array, CameraFrame
from foldcell.skills.vocabulary import CameraCalibration, GraspTrajectory, Table


@dataclass(frozen=True, eq=False)
class RunDrawing:
    """What all pictures of the run share. view: None if no fold was planned."""

    scenery: Scenery
    view: View | None
    calibration: CameraCalibration | None

    def seen(self, frame: CameraFrame) -> NDArray[np.uint8]:
        return outlined(frame, self.calibration, self.scenery.tape)

    def along(self, note: FoldNote | None) -> Scenery:
        """Return the scenery with the planned arcs of one fold."""
        return self.scenery if note is None else replace(self.scenery, arcs=_arcs(note.attempt.trajectory))


def run_drawing(
    table: Table,
    context: RunContext,
    frames: Sequence[TrueFrame],
    calibration: CameraCalibration | None,
) -> RunDrawing:
    """Choose one view that shows all folds, the colours of the garment and its original outline."""
    colours, outline = garment_look(context)
    shown = [KeyFrame(v, tools) for _, v, tools in frames[::5]]
    shown += [KeyFrame(v) for note in context.notes().values() for v in note.attempt.plan_frames]
    arcs = [arc for note in context.notes().values() for arc in _arcs(note.attempt.trajectory)]
    return RunDrawing(
        Scenery(table, (), outline, colours),
        motion_view(shown, arcs, SIZE) if shown else None,
        context.sight.refined if calibration is None else context.sight.calibration(calibration),
    )


def draw_attempts(
    notes: Mapping[str, FoldNote],
    frames: Sequence[TrueFrame],
    triangles: NDArray[np.int32] | None,
    drawing: RunDrawing,
) -> dict[str, DrawnHold]:
    """Draw the attempts in their order: fold name -> the attempt that made it. Attempts that failed have names of
    their own."""
    if triangles is None or drawing.view is None:
        return {}
    made = {hold[0][0]: note for note in notes.values() if (hold := held_during(note, frames))}
    drawn = {}
    for k, hold in enumerate(holds(frames)):
        note = made.get(hold[0][0])
        name = f"attempt {k + 1}, which did not make a fold" if note is None else note.name
        share = len(hold) / len(frames)
        drawn[name] = draw_hold(name, hold, share, triangles, drawing.view, drawing.along(note))
    return drawn


def film_of_run(
    context: RunContext,
    state: str,
    notes: Mapping[str, FoldNote],
    drawn: Mapping[str, DrawnHold],
    drawing: RunDrawing,
) -> bytes:
    """Return the film's file; empty if nothing moved. state: in which the run ended."""
    recognised, last = context.recognition, context.sight.frame
    ending = f"the last picture: {plain(state)}"
    stills = [
        CaptionedPicture(drawing.seen(f), f"{f.stamp:.1f} s   {note.name}")
        for note in ([] if drawn else notes.values())
        for f in note.attempt.pictures
    ]
    return film_file(
        CaptionedPicture(np.asarray(recognised.overlay, np.uint8), "the garment as it was laid")
        if recognised
        else None,
        list(drawn.values()),
        stills,
        CaptionedPicture(drawing.seen(last), f"{last.stamp:.1f} s   {ending}") if last else None,
    )


def film_note(drawn: Mapping[str, DrawnHold]) -> str:
    """Say what the film shows."""
    source = "drawn from the simulated garment" if drawn else "the pictures of the camera"
    return f"The run in short: {source}, without the time in which no hand holds the garment"


def _arcs(trajectory: GraspTrajectory) -> list[Array]:
    from foldcell.skills.trajectory.arcs.bezier import evaluate

    u = np.linspace(0.0, 1.0, 60)
    return [evaluate(c, u) for c in trajectory.control_points.values()]
