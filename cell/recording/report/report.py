"""Makes the report of a run from its end, its result and its recorded frames. page.py has the layout."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from importlib import metadata
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from cell.recording.camera_pictures.question_files import FOLDER as QUESTIONS_FOLDER
from cell.recording.outline import outline
from cell.recording.report.fold_pictures import KeyFrame, fold_strip, join
from cell.recording.report.height_map import height_maps
from cell.recording.report.page import Picture, RunRecord, ScoreRow, StepRecord, TimelineItem, write_report
from cell.recording.report.recording_losses import recording_losses
from cell.recording.report.run_events import RunEvent
from cell.states.fold_request import FoldRequest, FoldResult
from cell.states.run_end import RunEnd
from cell.states.step_note import StepNote
from robots.ports import Array, Side
from skills.vocabulary import GraspTrajectory

__all__ = ["TrueFrame", "report"]

TrueFrame = tuple[float, Array, Mapping[Side, Array]]
"""(cell time [s], vertices (n, 3), tool positions (3,)) of a simulated garment, for pictures only."""

LEVELS = {"failure": "failure", "recovery": "recovery", "command": "operator", "estimate": "note"}
UNITS = {"drift_rad": "rad", "iou": ""}
"""Units of the figures of the score; all others are lengths."""
KEY_FRAMES = 6
BREAK_S = 3.0
"""If the time between two frames of the held garment is longer than this [s], the frames belong to different
attempts."""


def report(
    folder: Path,
    request: FoldRequest,
    end: RunEnd,
    result: FoldResult,
    events: Sequence[RunEvent],
    frames: Sequence[TrueFrame],
    triangles: NDArray[np.int32] | None,
) -> Path:
    """Write `report.html`, `fold.png`, `last.jpg` (the last camera picture) and, if a fold was pressed,
    `pressing.png` into the run's folder.

    Returns the page's path. Raises StorageError if the page cannot be written.
    """
    context = end.context
    notes = context.notes()
    steps = [
        _step(notes[s["name"]], s, _held_during(notes[s["name"]], frames), triangles, request)
        if s["name"] in notes
        else StepRecord(name=s["name"], attempts=s["attempts"], recoveries=tuple(s["recoveries"]))
        for s in result.steps
    ]
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
        score=tuple(_score(result.score)),
        verdicts={name: result.score.get(name) for name in ("shape", "flat")} if result.score else {},
        invalid_ideal=str(((result.score or {}).get("ideal") or {}).get("reason") or ""),
        pictures=(*_pictures(end), *_questions(folder)),
        estimates=tuple(_estimates(end)),
        versions={d: metadata.version(d) for d in ("foldcell", "pin", "ruckig", "pybullet", "rerun-sdk", "numba")},
        settings=request.settings.model_dump(mode="json", by_alias=True),
        recording="run.rrd",
        recording_note="; ".join(f"not kept: {loss}" for loss in recording_losses(result.recording)),
    )
    _write_strip(folder / "fold.png", steps)
    _write_pressing(folder / "pressing.png", list(notes.values()))
    if context.sight.frame is not None:
        cv2.imwrite(str(folder / "last.jpg"), context.sight.frame.rgb[..., ::-1])
    return write_report(folder / "report.html", record)


def _claim(claim: Mapping[str, Any] | None) -> str:
    """Return the claim as a sentence with its reliability; empty if there is none."""
    return f"{claim['says']} (reliability {100 * claim['reliability']:.0f} %)" if claim else ""


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
            rows.append(join([p.rgb for p in row], [p.caption for p in row]))
    if rows:
        width = max(row.shape[1] for row in rows)
        same = [np.pad(r, ((0, 4), (0, width - r.shape[1]), (0, 0)), constant_values=255) for r in rows]
        cv2.imwrite(str(path), np.vstack(same)[..., ::-1])


def _write_pressing(path: Path, notes: Sequence[StepNote]) -> None:
    """Write the height maps of the last pressed fold, before and after pressing."""
    pictures = next(filter(None, (list(_pressings(note)) for note in reversed(notes))), None)
    if pictures:
        cv2.imwrite(str(path), join([p.rgb for p in pictures], [p.caption for p in pictures])[..., ::-1])


def _step(
    note: StepNote,
    figures: Mapping[str, Any],
    shown: Sequence[TrueFrame],
    triangles: NDArray[np.int32] | None,
    request: FoldRequest,
) -> StepRecord:
    table = request.settings.table
    arcs = _arcs(note.trajectory)
    moments = np.linspace(0.0, 1.0, len(note.plan_frames))
    predicted = fold_strip(
        [KeyFrame(v) for v in note.plan_frames], note.predicted.triangles, arcs=arcs, table=table
    )
    pictures = [Picture(p, f"predicted, {100 * m:.0f} %") for p, m in zip(predicted, moments, strict=True)]
    made_from = ["predicted: cloth simulation along the planned tool path"]
    if shown and triangles is not None:
        chosen = [shown[i] for i in np.linspace(0, len(shown) - 1, KEY_FRAMES).astype(int)]
        drawn = fold_strip([KeyFrame(v, tools) for _, v, tools in chosen], triangles, arcs=arcs, table=table)
        pictures += [Picture(p, f"simulated cell, {t:.1f} s") for p, (t, *_) in zip(drawn, chosen, strict=True)]
        made_from.append("simulated cell: the recorded garment")
    pictures += [Picture(f.rgb, f"camera, {f.stamp:.1f} s") for f in note.pictures]
    pictures += list(_pressings(note)) or list(_refused(note))
    return StepRecord(
        name=note.name,
        source=note.source,
        simulations=note.trajectory.simulations,
        dissimilarity_m=note.dissimilarity_m,
        aligned_iou=note.aligned_iou,
        observed_iou=note.observed_iou,
        drift_m=note.drift_m,
        attempts=note.grasps,
        recoveries=tuple(figures["recoveries"]),
        duration_s=note.carrying_s if np.isfinite(note.carrying_s) else None,
        accepted=figures["accepted"],
        key_frames=tuple(pictures),
        key_frames_note="; ".join([*made_from, "camera: over the robot's head"]),
        predicted=tuple(outline(note.predicted.vertices, note.predicted.triangles)),
        observed=(note.observed,) if len(note.observed) else (),
        height_m=note.height_m if np.isfinite(note.height_m) else None,
        pressed_from_m=tuple(before.height_m for before in note.pressed),
    )


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


def _arcs(trajectory: GraspTrajectory) -> list[Array]:
    from skills.trajectory.bezier import evaluate

    u = np.linspace(0.0, 1.0, 60)
    return [evaluate(c, u) for c in trajectory.control_points.values()]


def _held_during(note: StepNote, frames: Sequence[TrueFrame]) -> list[TrueFrame]:
    """Return the recorded frames of the attempt during which the fold's pictures were taken. The frames of other
    attempts are left out, because those attempts failed."""
    holds: list[list[TrueFrame]] = []
    last = -np.inf
    for frame in frames:
        if frame[0] - last > BREAK_S:
            holds.append([])
        holds[-1].append(frame)
        last = frame[0]
    taken = [p.stamp for p in note.pictures]
    return next((h for h in holds if taken and h[0][0] <= max(taken) and min(taken) <= h[-1][0]), [])


def _score(score: Mapping[str, Any] | None) -> Iterator[ScoreRow]:
    known = score or {}
    for name, limit in known.get("limits", {}).items():
        ideal, unit = known.get(f"ideal_{name}"), UNITS.get(name, "m")
        yield ScoreRow(name, known[name], limit, at_least=name == "iou", unit=unit, ideal=ideal)


def _estimates(end: RunEnd) -> Iterator[Picture]:
    """Yield the candidates of each estimate, drawn over the picture, with the estimate in words."""
    names = [step.name for step in end.context.steps]
    for note in end.context.estimates:
        name = names[note.fold] if note.fold < len(names) else f"fold {note.fold + 1}"
        yield Picture(note.picture, f"{note.t:.1f} s, fold {name}: {note.says}")


def _pictures(end: RunEnd) -> Iterator[Picture]:
    sight, recognition = end.context.sight, end.context.recognition
    if sight.reference is not None:
        yield Picture(sight.reference.rgb, "the empty table")
    if recognition is not None:
        yield Picture(recognition.overlay, "recognised")
    if sight.frame is not None:
        yield Picture(sight.frame.rgb, "the last picture")


def _questions(folder: Path) -> Iterator[Picture]:
    """Yield the pictures of the questions that the cell has asked."""
    for path in sorted((folder / QUESTIONS_FOLDER).glob("*.jpg")):
        bgr = cv2.imread(str(path))
        if bgr is not None:
            number, _, state = path.stem.partition("-")
            picture = np.ascontiguousarray(bgr[..., ::-1], dtype=np.uint8)
            yield Picture(picture, f"question {int(number)}, {state.replace('_', ' ')}")
