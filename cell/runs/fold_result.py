"""Build the result of a run after the state machine has ended."""

from __future__ import annotations

import math
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from cell.config.deciding_setting import deciding_setting
from cell.hardware.driver import is_simulated
from cell.states.fold_request import FoldRequest, FoldResult
from cell.states.run_context import RunContext
from cell.states.run_end import RunEnd
from cell.states.step_note import StepNote
from cell.states.transition_table import State
from robots.errors import Failure
from skills.perception.inspection.claim import claim_to_dict

__all__ = ["failure_to_dict", "fold_result"]

RESULTS = {
    State.FOLDED: "folded",
    State.NOT_FOLDED: "not_folded",
    State.STOPPED: "not_folded",
    State.FAULT: "fault",
}


def fold_result(
    request: FoldRequest,
    folder: Path,
    began: float,
    end: RunEnd,
    score: dict[str, Any] | None,
    received: Sequence[int],
    recording: dict[str, Any],
    resumed_from: str | None,
) -> FoldResult:
    """Build the result. began: time.monotonic() at the request [s]; score: None if the run was not scored;
    received: numbers of the signals received."""
    context, claim = end.context, end.context.claim()
    seen = context.recognition.perception if context.recognition else None
    failure = context.failure if end.state is not State.FOLDED else None
    return FoldResult(
        garment=request.garment,
        seed=request.seed,
        driver=request.driver,
        simulated=is_simulated(request.driver),
        world=request.world if is_simulated(request.driver) else None,
        result=RESULTS[end.state],
        state=end.state.value,
        failure=None if failure is None else failure_to_dict(failure, _setting(failure, request)),
        claim=None if claim is None else claim_to_dict(claim),
        score=score,
        steps=tuple(_steps(context)),
        robot_time_s=end.ended - end.started - context.waited_s,
        wall_time_s=time.monotonic() - began,
        stage_times_s={k: round(v, 3) for k, v in end.stage_times.items()},
        run_dir=str(folder),
        signal=received[0] if received else None,
        recording=recording,
        resumed_from=resumed_from,
        recognised=None if seen is None else {"garment": seen.garment, "confidence": seen.state.confidence},
    )


def _setting(failure: Failure, request: FoldRequest) -> str:
    return deciding_setting(failure.kind, request.settings)


def failure_to_dict(failure: Failure, setting: str = "") -> dict[str, str]:
    """Return a failure as a mapping, in the form that results use. setting: the one that decided, if there is
    one."""
    words = {"kind": failure.kind.value, "what": failure.what, "hint": failure.hint}
    return {**words, "setting": setting} if setting else words


def _steps(context: RunContext) -> Iterator[dict[str, Any]]:
    """Yield one entry per planned fold. The entry of an unfinished fold also has the figures that the fold has
    reached."""
    notes, done = context.notes(), {note.name for note in context.done}
    for index, step in enumerate(context.steps):
        note = notes.get(step.name)
        yield {
            "name": step.name,
            "done": step.name in done,
            "accepted": _accepted(note, step.name in done),
            "source": note.source if note else None,
            "dissimilarity_m": _known(note.dissimilarity_m if note else math.nan),
            "aligned_iou": _known(note.aligned_iou if note else math.nan),
            "predicted_iou": _known(note.aligned_iou if note else math.nan),  # former name of aligned_iou
            "observed_iou": _known(note.observed_iou if note else math.nan),
            "drift_m": _known(note.drift_m if note else math.nan),
            "observed_height_m": _known(note.height_m if note else math.nan),
            "pressed_from_m": [before.height_m for before in note.pressed] if note else [],
            "attempts": note.grasps if note else (context.fold.grasps if index == context.fold.index else 0),
            "recoveries": [text for i, text in context.recoveries if i == index],
            "estimates": [note.says for note in context.estimates if note.fold == index],
        }


def _accepted(note: StepNote | None, done: bool) -> bool | None:
    """Whether the inspection accepted the fold. None: the fold was not inspected, or the run ended before the fold
    was done."""
    if note is None or note.inspected is None or (note.accepted and not done):
        return None
    return note.accepted


def _known(figure: float) -> float | None:
    return figure if math.isfinite(figure) else None
