"""A fold as it was made, out of what the run believes when it is over."""

from __future__ import annotations

import math

import numpy as np

from cell.states.context import Context, StepNote

__all__ = ["note_of", "notes_by_step"]


def note_of(context: Context) -> StepNote | None:
    """The fold at hand, as far as it came; None before it was predicted. What nobody looked at is NaN or empty."""
    seen, predicted, trajectory = context.inspection, context.predicted, context.trajectory
    if predicted is None or trajectory is None:
        return None
    return StepNote(
        name=context.step.name,
        accepted=seen is not None and seen.diagnosis is None,
        source=trajectory.source,
        dissimilarity_m=context.dissimilarity_m,
        aligned_iou=seen.iou_aligned if seen else math.nan,
        observed_iou=seen.iou if seen else math.nan,
        drift_m=seen.drift_m if seen else math.nan,
        height_m=seen.height_m if seen else math.nan,
        grasps=context.grasps,
        pressed=context.pressed,
        inspected=seen,
        predicted=predicted,
        observed=seen.contour if seen else np.zeros((0, 2)),
        trajectory=trajectory,
        plan_frames=context.plan_frames if context.plan_frames is not None else np.zeros((0, 0, 3)),
        pictures=context.pictures,
        carrying_s=context.motion.fold.duration if context.motion else math.nan,
    )


def notes_by_step(context: Context) -> dict[str, StepNote]:
    """The folds that count as made, and the one at which the run ended. A fold that was skipped has none."""
    notes = {note.name: note for note in context.done}
    if context.steps and context.step.name not in notes:
        last = note_of(context)
        if last is not None:
            notes[last.name] = last
    return notes
