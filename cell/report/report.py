"""Makes the report of a run from its record, its last context and its recorded frames. page.py has the layout."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from foldcell.cell.config.cell_settings import CellSettings
from foldcell.cell.planning.fold_planning import PREDICTED_FRAMES
from foldcell.cell.record.run_record import RunRecord
from foldcell.cell.record.words import garment_name, length, plain
from foldcell.cell.report.camera_pictures.question_picture import FOLDER as QUESTIONS_FOLDER
from foldcell.cell.report.failure_stories import FailureStory
from foldcell.cell.report.page import FILM, FoldPictures, ReportPictures, render
from foldcell.cell.report.pictures.film import CaptionedPicture, DrawnHold, TrueFrame, spread
from foldcell.cell.report.pictures.fold_pictures import KeyFrame, fold_strip, join
from foldcell.cell.report.pictures.height_map import TICK, height_maps
from foldcell.cell.report.pictures.run_drawing import (
    RunDrawing,
    draw_attempts,
    film_note,
    film_of_run,
    run_drawing,
)
from foldcell.cell.states.run_context import RunContext
from foldcell.cell.states.stages import FoldNote
from foldcell.cell.support.files.encoded_picture import shrunk
from foldcell.cell.support.files.whole_file import write_whole
from foldcell.skills.fold_figures.drawn_mesh import outline
from foldcell.skills.vocabulary import CameraCalibration

STRIP_WIDTH = 300
"""Width of a picture in `fold.png` [px]."""


def report(
    record: RunRecord,
    context: RunContext,
    settings: CellSettings,
    calibration: CameraCalibration | None,
    frames: Sequence[TrueFrame] = (),
    triangles: NDArray[np.int32] | None = None,
    stories: Sequence[FailureStory] = (),
) -> Path:
    """Write `report.html`, `film.webp`, `fold.png`, `last.jpg` (the last camera picture) and, if a fold was
    pressed, `pressing.png` into the run's folder.

    context: the last one; calibration: of the camera (None: pictures show no outline unless the run has refined
    the calibration); stories: of the run's failures. Returns the page's path. Raises StorageError if the page or
    the film cannot be written.
    """
    folder, notes = Path(record.run_dir), context.notes()
    drawing = run_drawing(settings.table, context, frames, calibration)
    drawn = draw_attempts(notes, frames, triangles, drawing)
    with ThreadPoolExecutor(1) as encoder:  # the film takes as long as all other pictures of the report
        film = encoder.submit(film_of_run, context, record.state, notes, drawn, drawing)
        folds = {name: _fold(note, drawn.get(name), drawing) for name, note in notes.items()}
        _write_strip(folder / "fold.png", list(folds.values()))
        _write_pressing(folder / "pressing.png", list(notes.values()))
    pictures = ReportPictures(
        folds=folds,
        overview=(*_overview(context, drawing), *_questions(folder)),
        film=film.result(),
        film_note=film_note(drawn),
        stories=tuple(stories),
        estimates=tuple(_estimates(context, stories)),
    )
    if context.sight.shown is not None:
        cv2.imwrite(str(folder / "last.jpg"), context.sight.shown.rgb[..., ::-1])
    if pictures.film:
        write_whole(folder / FILM, pictures.film)
    if not (context.done or context.fold.carried):  # nothing was folded: nothing to score
        record = replace(record, score=None)
    title = context.plan.garment.title if context.plan else plain(garment_name(record.garment))
    page = folder / "report.html"
    write_whole(
        page, render(record, pictures, title, settings), "free some disk space, or make the run's folder writable"
    )
    return page


def _write_strip(path: Path, folds: Sequence[FoldPictures]) -> None:
    """Write the drawn key frames as one picture. Each fold has a row of predicted frames and a row of simulated
    frames."""
    rows = []
    for fold in folds:
        drawn = [p for p in fold.key_frames if not p.caption.startswith(("camera", "heights"))]
        for at in range(0, len(drawn), PREDICTED_FRAMES):
            row = drawn[at : at + PREDICTED_FRAMES]
            rows.append(join([shrunk(p.rgb, STRIP_WIDTH) for p in row], [p.caption for p in row]))
    if rows:
        width = max(row.shape[1] for row in rows)
        same = [np.pad(r, ((0, 4), (0, width - r.shape[1]), (0, 0)), constant_values=255) for r in rows]
        cv2.imwrite(str(path), np.vstack(same)[..., ::-1])


def _write_pressing(path: Path, notes: Sequence[FoldNote]) -> None:
    """Write the height maps of the last pressed fold, before and after pressing."""
    pictures = next(filter(None, (list(_pressings(note)) for note in reversed(notes))), None)
    if pictures:
        cv2.imwrite(str(path), join([p.rgb for p in pictures], [p.caption for p in pictures])[..., ::-1])


def _fold(note: FoldNote, hold: DrawnHold | None, drawing: RunDrawing) -> FoldPictures:
    attempt = note.attempt
    moments = np.linspace(0.0, 1.0, len(attempt.plan_frames))
    predicted = []
    if drawing.view is not None:
        planned = [KeyFrame(v) for v in attempt.plan_frames]
        predicted = fold_strip(planned, attempt.predicted.triangles, drawing.view, drawing.along(note))
    pictures = [
        CaptionedPicture(p, f"predicted, {100 * m:.0f} %") for p, m in zip(predicted, moments, strict=True)
    ]
    what = "the repair that completed this fold" if attempt.repaired else "the planned tool path"
    made_from = [f"predicted: cloth simulation along {what}"]
    if hold is not None:
        chosen = [(hold.pictures[i], hold.times[i]) for i in spread(len(hold.times), PREDICTED_FRAMES)]
        pictures += [CaptionedPicture(p, f"simulated cell, {t:.1f} s") for p, t in chosen]
        made_from.append("simulated cell: the recorded garment")
    pictures += [CaptionedPicture(drawing.seen(f), f"camera, {f.stamp:.1f} s") for f in attempt.pictures]
    heights = list(_pressings(note)) or list(_refused(note))
    pictures += heights
    made_from.append("camera: over the robot's head")
    if heights:
        made_from.append(f"heights: above the table; one tick of the bar is {length(TICK, 0)}")
    outlines = {
        "original": [] if drawing.scenery.tape is None else [drawing.scenery.tape],
        "predicted": outline(attempt.predicted.vertices, attempt.predicted.triangles),
        "observed": [note.inspected.contour] if note.inspected is not None else [],
    }
    return FoldPictures(tuple(pictures), "; ".join(made_from), outlines)


def _pressings(note: FoldNote) -> Iterator[CaptionedPicture]:
    """Yield the height maps before each pressing and after the last pressing. Yields nothing if the fold was not
    inspected after the last pressing."""
    pressed = note.attempt.pressed
    if not pressed or note.inspected is None or note.inspected is pressed[-1]:
        return
    looks = (*pressed, note.inspected)
    times = ["before"] * len(pressed) + ["after"]
    for look, picture, time in zip(looks, height_maps(looks), times, strict=True):
        yield CaptionedPicture(picture, f"heights seen {time} pressing, {length(look.height_m, 0)}")


def _refused(note: FoldNote) -> Iterator[CaptionedPicture]:
    """Yield the height map of a fold that was not accepted."""
    seen = note.inspected
    if seen is not None and not note.accepted:
        height = f", {length(seen.height_m, 0)}" if np.isfinite(seen.height_m) else ""
        yield CaptionedPicture(height_maps([seen])[0], f"heights seen{height}")


def _estimates(context: RunContext, stories: Sequence[FailureStory]) -> Iterator[CaptionedPicture]:
    """Yield the candidates of each estimate that no story tells, drawn over the picture, with the estimate in
    words. A resumed run does not tell the stories of the run before."""
    names = [step.name for step in context.steps]
    told = {(scene.t, scene.caption) for story in stories for scene in story.thought}
    for note in context.estimates:
        if (note.t, note.says) in told:
            continue
        name = names[note.fold] if note.fold < len(names) else f"fold {note.fold + 1}"
        yield CaptionedPicture(note.picture, f"{note.t:.1f} s, fold {name}: {note.says}")


def _overview(context: RunContext, drawing: RunDrawing) -> Iterator[CaptionedPicture]:
    sight, recognition = context.sight, context.recognition
    if sight.reference is not None:
        yield CaptionedPicture(sight.reference.rgb, "the empty table")
    if recognition is not None:
        yield CaptionedPicture(recognition.overlay, "recognised")
    if sight.shown is not None:
        yield CaptionedPicture(drawing.seen(sight.shown), "the last picture")


def _questions(folder: Path) -> Iterator[CaptionedPicture]:
    """Yield the pictures of the questions that the cell has asked."""
    for path in sorted((folder / QUESTIONS_FOLDER).glob("*.jpg")):
        bgr = cv2.imread(str(path))
        if bgr is not None:
            number, _, state = path.stem.partition("-")
            picture = np.ascontiguousarray(bgr[..., ::-1], dtype=np.uint8)
            yield CaptionedPicture(picture, f"question {int(number)}, {plain(state)}")
