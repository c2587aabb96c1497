"""Judge a predicted fold by the limits of a run and of its score, and say in plain words what will fail."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from foldcell.robots.ports import Array
from foldcell.skills.cloth.predict import FoldPrediction
from foldcell.skills.fold_plan.folding import fold_xy
from foldcell.skills.garments.garment import Garment
from foldcell.skills.perception.inspection.claim import ClaimSettings
from foldcell.skills.scoring.score import named_edge_pairs
from foldcell.skills.scoring.verdict import Score, ScoreLimits
from foldcell.skills.trajectory.search.acceptance import judge_prediction
from foldcell.skills.vocabulary import FoldLine, FoldStep

MENDED_BY_TENSION = 0.060
"""Releasing the cloth elsewhere can correct a key point that is at most this far from its place [m]."""

_FABRIC = (
    "check the fabric's figures in the garment file (`foldcell calibrate` measures them), move the fold line or"
    " the grasps of this fold, or give it another variant"
)
_LESS_FORCE = "fold more slowly (max_tool_speed in the garment file), or lay the garment on a rougher surface"
_PRESSED = (
    "a run presses its creases (pressing.max_attempts in cell.yaml), which the prediction leaves out; check"
    " thickness and bending_length of the fabric, or fold it less often"
)
_SHAPE = {
    "iou": ("it overlaps its planned shape by {:.2f} (at least {:.2f})", 1.0, _FABRIC),
    "correspondence_m": ("the cloth lies {:.0f} mm off on average (limit {:.0f} mm)", 1e3, _FABRIC),
    "edges_m": ("edges that belong together lie {:.0f} mm apart (limit {:.0f} mm)", 1e3, _FABRIC),
    "drift_m": ("the garment is dragged {:.0f} mm away (limit {:.0f} mm)", 1e3, _LESS_FORCE),
    "drift_rad": ("the garment is turned by {:.0f} degrees (limit {:.0f})", math.degrees(1.0), _LESS_FORCE),
}
_HEIGHTS = {
    "height_m": ("it stands {:.0f} mm high (limit {:.0f} mm)", 1e3, _PRESSED),
    "crease_height_m": ("its creases stand {:.0f} mm high (limit {:.0f} mm)", 1e3, _PRESSED),
}
"""Figure of the score -> text with value and limit, factor to the unit of the text, and hint."""


@dataclass(frozen=True)
class Reason:
    """Why a fold will fail. what: the reason in words, with figure and limit. hint: a possible change. arc:
    whether another arc may help."""

    what: str
    hint: str
    arc: bool = True


def claim_limits(claim: ClaimSettings) -> ScoreLimits:
    """Return the limits of the score, with those of the claim where the settings state them."""
    return ScoreLimits(
        iou=claim.iou, drift=claim.drift, drift_angle=claim.drift_angle, height=claim.stack_margin,
        ideal_height=claim.ideal_margin, ideal_crease_height=claim.crease_margin,
    )  # fmt: skip


def judge_hands(step: FoldStep, prediction: FoldPrediction) -> tuple[Reason, ...]:
    """Return what is wrong with the grasps of a predicted fold."""
    found = []
    for grasp_id, pinch in prediction.pinches.items():
        wanted, hand = step.grasps[grasp_id].layers, f"the {grasp_id.planned_arm} hand"
        if not pinch.held_points:
            hint = "place this grasp on the cloth (`inset` in the garment file)"
            found.append(Reason(f"{hand} closes on no cloth", hint, arc=False))
        elif pinch.layers < wanted:
            hint = "place this grasp where all layers lie (`inset`), or use deeper pads (gripper.pad_depth)"
            found.append(Reason(f"{hand} takes {pinch.layers} of {wanted} layers", hint, arc=False))
        if grasp_id in prediction.dropped:
            hint = "grip harder (grasp.grip_force), fold more slowly (max_tool_speed), or grasp farther inside"
            found.append(Reason(f"{hand} loses its cloth before the fold ends", hint))
    return tuple(found)


def judge_edges(
    garment: Garment, lines: Sequence[FoldLine], keypoints: Mapping[str, Array], limit: float
) -> tuple[Reason, ...]:
    """Judge the edges that belong together (`edge_pairs` of the garment file). Return a reason for each pair that
    does not meet even after the ideal folds about `lines`. keypoints: name -> (2,) place on the flat garment [m];
    limit: largest distance [m]."""
    found = []
    pairs = named_edge_pairs(garment.edge_pairs, keypoints)
    for names, (first, second) in zip(garment.edge_pairs, pairs, strict=True):
        apart = float(np.linalg.norm(fold_xy(lines, first) - fold_xy(lines, second), axis=1).max())
        if apart > limit:
            edges = " and ".join(" to ".join(ends) for ends in names)
            what = f"even after the ideal folds, the edges {edges} lie {_mm(apart)} apart (limit {_mm(limit)})"
            found.append(Reason(what, "correct these key points, or move the fold lines between them", arc=False))
    return tuple(found)


def judge_fold(
    garment: Garment,
    step: FoldStep,
    keypoints: Mapping[str, Array],
    offsets: Mapping[str, Array],
    dissimilarity: float,
    limit: float,
    score: Score,
    edges: bool = True,
) -> tuple[Reason, ...]:
    """Return what is wrong with the shape after a predicted fold; empty if it is within all limits.

    keypoints: name -> (2,) place on the flat garment [m]. offsets: name -> (2,) vector from the place after the
    ideal fold to the predicted place [m]. dissimilarity: D [m]. limit: the largest D with which a run accepts the
    fold [m]. score: of the predicted shape; heights are judged if it has an ideal fold. edges: whether to judge
    the edges that belong together. Leave them out if the plan itself does not bring them together (`judge_edges`).
    """
    found = [*_keypoint(garment, step, keypoints, offsets, score.figures["keypoints_m"].limit)]
    poor = judge_prediction(step.name, dissimilarity, limit)
    if poor is not None:
        what = f"it misses its target by {_mm(dissimilarity)} on average (limit {_mm(limit)})"
        found.append(Reason(what, _FABRIC))
    found += _shape(score, bool(found), edges)
    found += _heights(score)
    return tuple(found)


def _keypoint(
    garment: Garment, step: FoldStep, keypoints: Mapping[str, Array], offsets: Mapping[str, Array], limit: float
) -> Iterator[Reason]:
    """Find the key point that is farthest from its place. If it is too far away, say where it lies and what would
    help."""
    name = max(offsets, key=lambda n: float(np.linalg.norm(offsets[n])), default="")
    far = float(np.linalg.norm(offsets[name])) if name else 0.0
    if far <= limit:
        return
    along, across = float(offsets[name] @ step.line.normal), float(offsets[name] @ step.line.direction)
    moved = bool(step.line.signed_distance(fold_xy(step.earlier, keypoints[name])) > 0.0)
    hint = _FABRIC
    if not moved:
        text, hint = f"the simulation drags {name} {_mm(far)} off its place", _LESS_FORCE
    elif abs(across) > abs(along):
        text = f"the simulation lays {name} {_mm(far)} beside its place"
    elif along > 0.0:
        text = f"the simulation leaves {name} {_mm(far)} short of its place"
    else:
        text = f"the simulation carries {name} {_mm(far)} beyond its place"
    if moved and abs(along) >= abs(across) and far <= MENDED_BY_TENSION:
        past = garment.plan[step.index].tension[0]
        hint = f"release the cloth elsewhere: the `tension` of this fold is {_mm(past)}, try {_mm(past + along)}"
    yield Reason(f"{text} (limit {_mm(limit)})", hint)


def _shape(score: Score, known: bool, with_edges: bool) -> Iterator[Reason]:
    """Say which figures of the silhouette are beyond their limits. known: whether another reason already says that
    the cloth is off its place. Then only the overlap is judged."""
    for name in ("iou",) if known else _SHAPE:
        if with_edges or name != "edges_m":
            yield from _beyond(score, name, _SHAPE[name])


def _heights(score: Score) -> Iterator[Reason]:
    if score.ideal is not None:
        for name, words in _HEIGHTS.items():
            yield from _beyond(score, name, words)


def _beyond(score: Score, name: str, words: tuple[str, float, str]) -> Iterator[Reason]:
    """Yield a reason if a figure is beyond its limit. words: text, factor to the unit of the text, and hint."""
    figure, (text, factor, hint) = score.figures[name], words
    if not figure.passed:
        yield Reason(text.format(factor * figure.value, factor * figure.limit), hint)


def _mm(length: float) -> str:
    return f"{1e3 * length:.0f} mm"
