"""Makes the report of a run from its end, its result and its recorded frames. page.py has the layout."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from importlib import metadata
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from cell.config.cell_settings import load_settings
from cell.config.changed_settings import changed_settings
from cell.report.camera_pictures.question_files import FOLDER as QUESTIONS_FOLDER
from cell.report.failure_stories import FailureStory
from cell.report.page import Picture, RunRecord, ScoreRow, StepRecord, TimelineItem, write_report
from cell.report.pictures.fold_pictures import KeyFrame, fold_strip, join
from cell.report.pictures.height_map import TICK, height_maps
from cell.report.pictures.recorded_holds import TrueFrame, spread
from cell.report.pictures.run_drawing import (
    RunDrawing,
    draw_attempts,
    film_note,
    film_of_run,
    run_drawing,
)
from cell.report.pictures.run_film import SIZE, DrawnHold
from cell.report.recording_losses import recording_losses
from cell.report.run_events import RunEvent
from cell.states.fold_request import FoldRequest, FoldResult
from cell.states.run_context import RunContext
from cell.states.run_end import RunEnd
from cell.states.step_note import StepNote
from cell.support.files.whole_file import write_whole
from skills.fold_figures.outline import outline
from skills.vocabulary import CameraCalibration

__all__ = ["TrueFrame", "report"]

LEVELS = {"failure": "failure", "recovery": "recovery", "command": "operator", "estimate": "note"}
UNITS = {"drift_rad": "rad", "iou": ""}
"""Units of the figures of the score; all others are lengths."""
KEY_FRAMES = 6
STRIP_WIDTH = 300
"""Width of a picture in `fold.png` [px]."""
FILM = "film.webp"
CHANGED = "Only the settings that differ from the shipped ones. cell.yaml in the run's folder has all."
UNCHANGED = "All settings are the shipped ones; cell.yaml in the run's folder has them."


def report(
    folder: Path,
    request: FoldRequest,
    end: RunEnd,
    result: FoldResult,
    events: Sequence[RunEvent],
    frames: Sequence[TrueFrame],
    triangles: NDArray[np.int32] | None,
    calibration: CameraCalibration | None = None,
    stories: Sequence[FailureStory] = (),
) -> Path:
    """Write `report.html`, `film.webp`, `fold.png`, `last.jpg` (the last camera picture) and, if a fold was
    pressed, `pressing.png` into the run's folder.

    calibration: of the camera; None: pictures show no outline unless the run has refined the calibration. stories:
    of the run's failures. Returns the page's path. Raises StorageError if the page or the film cannot be written.
    """
    context = end.context
    notes = context.notes()
    drawing = run_drawing(request.settings.table, context, frames, calibration)
    drawn = draw_attempts(notes, frames, triangles, drawing)
    with ThreadPoolExecutor(1) as encoder:  # the film takes as long as all other pictures of the report
        film = encoder.submit(film_of_run, context, result.state, notes, drawn, drawing)
        steps = _steps(notes, result, drawn, drawing)
        _write_strip(folder / "fold.png", steps)
        _write_pressing(folder / "pressing.png", list(notes.values()))
    film_content = film.result()
    score = result.score if context.done or context.fold.carried else None  # nothing was folded: nothing to score
    changed, shipped = changed_settings(request.settings, load_settings())
    failure = result.failure or {}
    record = RunRecord(
        run_id=folder.name,
        garment=result.garment,
        result=result.result,
        state=end.state,
        seed=result.seed,
        driver=result.driver,
        simulated=result.simulated,
        world=result.world or "",
        title=context.plan.garment.title if context.plan else result.garment,
        reason=str(failure.get("what", "")),
        hint=str(failure.get("hint", "")),
        claim=_claim(result.claim),
        robot_time_s=result.robot_time_s,
        wall_time_s=result.wall_time_s,
        steps=tuple(steps),
        stage_times_s=result.stage_times_s,
        timeline=tuple(_timeline(end, result, events)),
        score=tuple(_score(score)),
        verdicts={name: score.get(name) for name in ("shape", "flat")} if score else {},
        invalid_ideal=str(((score or {}).get("ideal") or {}).get("reason") or ""),
        film=film_content,
        film_name=FILM,
        film_note=film_note(drawn),
        pictures=(*_pictures(context, drawing), *_questions(folder)),
        stories=tuple(stories),
        estimates=tuple(_estimates(end, stories)),
        versions={d: metadata.version(d) for d in ("foldcell", "pin", "ruckig", "pybullet", "rerun-sdk", "numba")},
        settings=changed,
        shipped=shipped,
        settings_note=CHANGED if changed else UNCHANGED,
        recording="run.rrd",
        recording_note="; ".join(f"not kept: {loss}" for loss in recording_losses(result.recording)),
    )
    if context.sight.frame is not None:
        cv2.imwrite(str(folder / "last.jpg"), context.sight.frame.rgb[..., ::-1])
    if film_content:
        write_whole(folder / FILM, film_content)
    return write_report(folder / "report.html", record)


def _steps(
    notes: Mapping[str, StepNote], result: FoldResult, drawn: Mapping[str, DrawnHold], drawing: RunDrawing
) -> list[StepRecord]:
    """Return the folds of the plan. Those that were not begun have no pictures."""
    return [
        _step(notes[s["name"]], s, drawn.get(s["name"]), drawing)
        if s["name"] in notes
        else StepRecord(
            name=s["name"],
            attempts=s["attempts"],
            recoveries=tuple(s["recoveries"]),
            accepted=s["accepted"],
            done=s["done"],
        )
        for s in result.steps
    ]


def _claim(claim: Mapping[str, Any] | None) -> str:
    """Return the claim as a sentence with its reliability; empty if there is none."""
    return f"{claim['says']}, reliability {100 * claim['reliability']:.0f} %" if claim else ""


def _timeline(end: RunEnd, result: FoldResult, events: Sequence[RunEvent]) -> Iterator[TimelineItem]:
    if result.resumed_from:  # the page also shows the folds of the resumed run
        yield TimelineItem(end.started, "operator", f"resumed {result.resumed_from}", "")
    for event in events:
        yield TimelineItem(event.t, LEVELS[event.kind], event.title, event.text)


def _write_strip(path: Path, steps: Sequence[StepRecord]) -> None:
    """Write the drawn key frames as one picture. Each fold has a row of predicted frames and a row of simulated
    frames."""
    rows = []
    for step in steps:
        drawn = [p for p in step.key_frames if not p.caption.startswith(("camera", "heights"))]
        for at in range(0, len(drawn), KEY_FRAMES):
            row = drawn[at : at + KEY_FRAMES]
            rows.append(join([_small(p.rgb) for p in row], [p.caption for p in row]))
    if rows:
        width = max(row.shape[1] for row in rows)
        same = [np.pad(r, ((0, 4), (0, width - r.shape[1]), (0, 0)), constant_values=255) for r in rows]
        cv2.imwrite(str(path), np.vstack(same)[..., ::-1])


def _small(rgb: NDArray[np.uint8]) -> NDArray[np.uint8]:
    size = STRIP_WIDTH, round(rgb.shape[0] * STRIP_WIDTH / rgb.shape[1])
    return np.asarray(cv2.resize(rgb, size, interpolation=cv2.INTER_AREA), dtype=np.uint8)


def _write_pressing(path: Path, notes: Sequence[StepNote]) -> None:
    """Write the height maps of the last pressed fold, before and after pressing."""
    pictures = next(filter(None, (list(_pressings(note)) for note in reversed(notes))), None)
    if pictures:
        cv2.imwrite(str(path), join([p.rgb for p in pictures], [p.caption for p in pictures])[..., ::-1])


def _step(note: StepNote, figures: Mapping[str, Any], hold: DrawnHold | None, drawing: RunDrawing) -> StepRecord:
    moments = np.linspace(0.0, 1.0, len(note.plan_frames))
    predicted = fold_strip(
        [KeyFrame(v) for v in note.plan_frames], note.predicted.triangles,
        size=SIZE, scenery=drawing.along(note), view=drawing.view,
    )  # fmt: skip
    pictures = [Picture(p, f"predicted, {100 * m:.0f} %") for p, m in zip(predicted, moments, strict=True)]
    made_from = ["predicted: cloth simulation along the planned tool path"]
    if hold is not None:
        chosen = [(hold.pictures[i], hold.times[i]) for i in spread(len(hold.times), KEY_FRAMES)]
        pictures += [Picture(p, f"simulated cell, {t:.1f} s") for p, t in chosen]
        made_from.append("simulated cell: the recorded garment")
    pictures += [Picture(drawing.seen(f), f"camera, {f.stamp:.1f} s") for f in note.pictures]
    heights = list(_pressings(note)) or list(_refused(note))
    pictures += heights
    made_from.append("camera: over the robot's head")
    if heights:
        made_from.append(f"heights: above the table; one tick of the bar is {TICK * 1e3:.0f} mm")
    return StepRecord(
        name=note.name,
        source=note.source,
        simulations=note.trajectory.simulations,
        dissimilarity_m=_known(note.dissimilarity_m),
        aligned_iou=_known(note.aligned_iou),
        observed_iou=_known(note.observed_iou),
        drift_m=_known(note.drift_m),
        attempts=note.grasps,
        recoveries=tuple(figures["recoveries"]),
        duration_s=_known(note.carrying_s),
        done=figures["done"],
        accepted=figures["accepted"],
        key_frames=tuple(pictures),
        key_frames_note="; ".join(made_from),
        predicted=tuple(outline(note.predicted.vertices, note.predicted.triangles)),
        observed=(note.observed,) if len(note.observed) else (),
        original=() if drawing.look.outline is None else (drawing.look.outline,),
        height_m=_known(note.height_m),
        pressed_from_m=tuple(before.height_m for before in note.pressed),
    )


def _known(figure: float) -> float | None:
    return figure if np.isfinite(figure) else None


def _pressings(note: StepNote) -> Iterator[Picture]:
    """Yield the height maps before each pressing and after the last pressing. Yields nothing if the fold was not
    inspected after the last pressing."""
    if not note.pressed or note.inspected is None or note.inspected is note.pressed[-1]:
        return
    looks = (*note.pressed, note.inspected)
    times = ["before"] * len(note.pressed) + ["after"]
    for look, picture, time in zip(looks, height_maps(looks), times, strict=True):
        yield Picture(picture, f"heights seen {time} pressing, {look.height_m * 1e3:.0f} mm")


def _refused(note: StepNote) -> Iterator[Picture]:
    """Yield the height map of a fold that was not accepted."""
    if note.inspected is not None and not note.accepted:
        height = f", {note.height_m * 1e3:.0f} mm" if np.isfinite(note.height_m) else ""
        yield Picture(height_maps([note.inspected])[0], f"heights seen{height}")


def _score(score: Mapping[str, Any] | None) -> Iterator[ScoreRow]:
    known = score or {}
    for name, limit in known.get("limits", {}).items():
        ideal, unit = known.get(f"ideal_{name}"), UNITS.get(name, "m")
        yield ScoreRow(name, known[name], limit, at_least=name == "iou", unit=unit, ideal=ideal)


def _estimates(end: RunEnd, stories: Sequence[FailureStory]) -> Iterator[Picture]:
    """Yield the candidates of each estimate that no story tells, drawn over the picture, with the estimate in
    words. A resumed run does not tell the stories of the run before."""
    names = [step.name for step in end.context.steps]
    told = {(scene.t, scene.caption) for story in stories for scene in story.thought}
    for note in end.context.estimates:
        if (note.t, note.says) in told:
            continue
        name = names[note.fold] if note.fold < len(names) else f"fold {note.fold + 1}"
        yield Picture(note.picture, f"{note.t:.1f} s, fold {name}: {note.says}")


def _pictures(context: RunContext, drawing: RunDrawing) -> Iterator[Picture]:
    sight, recognition = context.sight, context.recognition
    if sight.reference is not None:
        yield Picture(sight.reference.rgb, "the empty table")
    if recognition is not None:
        yield Picture(recognition.overlay, "recognised")
    if sight.frame is not None:
        yield Picture(drawing.seen(sight.frame), "the last picture")


def _questions(folder: Path) -> Iterator[Picture]:
    """Yield the pictures of the questions that the cell has asked."""
    for path in sorted((folder / QUESTIONS_FOLDER).glob("*.jpg")):
        bgr = cv2.imread(str(path))
        if bgr is not None:
            number, _, state = path.stem.partition("-")
            picture = np.ascontiguousarray(bgr[..., ::-1], dtype=np.uint8)
            yield Picture(picture, f"question {int(number)}, {state.replace('_', ' ')}")
