"""Make the claim about a finished fold, from the camera alone."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from foldcell.robots.ports import Array
from foldcell.skills.perception.inspection.claim import Claim, ClaimSettings
from foldcell.skills.perception.inspection.diagnosis import beyond_limits, edge_corner
from foldcell.skills.perception.inspection.height_expectation import (
    CameraBias,
    Flatness,
    IdealHeights,
    Normal,
    estimate_bending,
    expected_heights,
    judge_flatness,
)
from foldcell.skills.perception.inspection.result import Inspection, InspectionSettings
from foldcell.skills.perception.inspection.target_view import TargetView
from foldcell.skills.vocabulary import FailureKind

OVERLAP, BY_PREDICTED, BY_CREASE, OVERLAP_SIGMA = 0.271, 0.719, 0.211, 0.0021
"""The overlap with the target, as the score measures it: `OVERLAP`, plus a share of the aligned overlap with the
prediction, less the strip that the highest crease draws in, `BY_CREASE` times as wide as it is high. Such a
strip counts more on a small garment, and so does the error, a strip with the standard deviation `OVERLAP_SIGMA`
[m]. Least squares over 172 runs of eleven garments; the error is 1.2 to 2.6 mm for each of them, and 2.0 mm in
29 other runs of small towels. The camera's own overlap with the target is 0.02 to 0.06 larger for towels and
trousers: it is aligned by the outline alone. That hides that on one side the creases are drawn in, while on the
other side the lowest layers reach out from under the upper ones."""
DRIFT_SIGMA = 0.004
DRIFT_ANGLE_SIGMA = float(np.deg2rad(1.0))
"""Standard deviations of the displacement [m] and its angle [rad]."""

SURE = 2.0 / 3.0
"""Smallest probability with which the shape, the flatness, and both together are claimed. A false claim counts
twice as much as a good fold that is not claimed."""
SURE_AFTER = 0.85
"""The same for the shape after a disturbance, because the errors above are those of runs without one, and layers
may lie under others; two hidden folds may pass (`HIDDEN_GOOD`). Heights are seen as well as before."""
UNSEEN_RELIEF, RELIEF_SIGMA = 0.12, 0.08
"""Share by which the picture shows the relief of a stack too low, and its standard deviation, in 29 folds. Depth
is averaged over squares, and a camera that looks at an angle does not see all flanks."""

STAYING = 0.75
"""Share of the height above the flat layers that stays after one pressing. In runs 0.82 and 0.85 stayed after two
dabs, 0.57 after five and 0.48 after nine; in 16 more pressings of two or three dabs, 0.43 to 1.0."""
RAISED = 0.002
"""By how much hands leave the first crease higher than it is in the ideal fold [m]. With this and the standard
deviations `first_crease_sigma` and `ideal_sigma`, the ideal heights of 101 runs of eleven garments are expected
without bias, within 1.8 mm away from creases and 1.5 mm near them."""
MOST_PRESSINGS = 5
"""Number of pressings whose effect is predicted."""

HIDDEN_GOOD = 0.95
"""Probability that a fold is still good of which layers were disturbed and are hidden since: after faults and
kills, 3 of 61 claims were false."""

MOST_APART = 0.030
"""Largest distance of an edge from its pair, and of a key point from its place, in a good fold [m]."""
USUALLY_APART, BY_OUTLINE, BY_CORNER, APART_SIGMA = 0.008, 0.75, 0.35, 0.006
"""The true distance of the farthest edge or key point: `USUALLY_APART` [m], plus these shares of the deviation of
the outline and of the lag of the moved edge's corner in the worst fold, with this standard deviation [m]. From 131
runs, 65 of them campaigns on fresh seeds, in which the outline says less (a share of 0.4) than in runs with faults
(1.15); of the 121 good ones none is doubted too much to be claimed."""

SHAPE_KEPT = frozenset({None, FailureKind.DRIFT, FailureKind.PILING})
"""Diagnoses that do not concern the shape. The claim has its own limit for the drift, and piled cloth concerns
flatness."""


@dataclass(frozen=True)
class Layers:
    """The layers of the garment. sheets: of the flat garment. stated: thickness of a layer in the garment's file
    [m], with which the camera's bias, the target and the ideal heights were computed. thickness: what is known of
    it [m]; the hands may have measured it."""

    sheets: int
    stated: float
    thickness: Normal

    def thicker(self, height: float) -> Normal:
        """Return by how much a flat stack is higher than `height` [m], because its layers are not as thick as
        stated."""
        share = self.thickness.mean / self.stated
        return Normal(height * (share - 1.0), height * self.thickness.sigma / self.stated)

    def correct(self, bias: CameraBias) -> CameraBias:
        """Return the camera's bias for the true thickness, if it was measured on the flat garment."""
        if not bias.measured:
            return bias
        more = self.thicker((self.sheets - 0.5) * self.stated)
        return replace(bias, value=bias.value - more.mean, sigma=more.sigma)


@dataclass(frozen=True)
class Displacement:
    """Displacement of the garment since it was first seen: length [m] and angle [rad]."""

    drift_m: float
    drift_rad: float


@dataclass(frozen=True)
class SeenFolds:
    """What was seen of all folds. doubtful: names of the earlier folds that were not found good; a later fold can
    cover their defects, so the shape is not claimed then. hidden: names of the folds of which layers were
    disturbed and are hidden since. earlier: the last inspections of the earlier folds. disturbed: whether any fold
    was repaired, or the garment was moved otherwise than planned."""

    doubtful: tuple[str, ...] = ()
    hidden: tuple[str, ...] = ()
    earlier: tuple[Inspection, ...] = ()
    disturbed: bool = False


def displacement_of(target: TargetView, R: Array, t: Array) -> Displacement:
    """Return the displacement since the garment was first seen. R (2, 2), t (2,) [m]: the motion p -> R p + t that
    the plan has followed since then; the target's drift is added to it."""
    before = R.T @ (target.about - t)
    turn = float(np.arctan2(R[1, 0], R[0, 0])) + target.drift_rad
    return Displacement(
        float(np.linalg.norm(target.about + target.drift - before)), abs(math.remainder(turn, 2.0 * math.pi))
    )


def claim_fold(
    seen: Inspection,
    target: TargetView,
    moved: Displacement,
    bias: CameraBias,
    ideal: IdealHeights,
    first: TargetView | None,
    layers: Layers,
    settings: InspectionSettings,
    folds: SeenFolds,
) -> Claim:
    """Make the claim about the last fold.

    bias: as measured with the stated thickness of a layer. ideal: table of the ideal fold's heights. first: view
    of the first fold, whose crease shows the fabric; None if it was not observed. Cloth that stands higher than
    the prediction for a usual fabric counts as heaped up only if the fabric is not known.
    """
    errors = settings.claim
    if first is not None and seen.diagnosis is FailureKind.PILING:
        seen = replace(seen, diagnosis=None)
    bias, flat_heights = layers.correct(bias), (target.flat.height_m, target.flat.crease_height_m)
    observed = None if first is None else Normal(
        first.observed.crease_height_m - RAISED - bias.value - layers.thicker(first.flat.crease_height_m).mean,
        math.hypot(errors.first_crease_sigma, bias.sigma),
    )  # fmt: skip
    bending = estimate_bending(ideal, observed)
    expected = expected_heights(ideal, bending, errors.ideal_sigma)
    away, near = (
        Normal(e.mean + layers.thicker(h).mean, e.sigma) for e, h in zip(expected, flat_heights, strict=True)
    )
    flats = tuple(h + 0.5 * layers.stated for h in flat_heights)
    stack, crease_stack = (h + layers.thicker(h).mean for h in flats)
    relief = target.observed.relief_m
    height = target.observed.height_m - bias.value + UNSEEN_RELIEF * relief
    crease = target.observed.crease_height_m - bias.value

    def judge(staying: float) -> Flatness:
        """Judge the flatness if this share of the height above the flat layers stays."""
        low, crease_low = height - (1.0 - staying) * max(height - stack, 0.0), crease
        if math.isfinite(crease):
            crease_low -= (1.0 - staying) * max(crease - crease_stack, 0.0)
        return judge_flatness(
            Normal(low, math.hypot(errors.height_sigma, RELIEF_SIGMA * staying * relief, bias.sigma)),
            Normal(crease_low, math.hypot(errors.crease_sigma, bias.sigma)) if math.isfinite(crease) else None,
            (away, near),
            Normal(stack, layers.thicker(flats[0]).sigma),
            errors,
        )

    judged = judge(1.0)
    visible = math.isfinite(height)
    probable_flat = judged.probability if visible else 0.0
    if seen.diagnosis is FailureKind.PILING:
        probable_flat = min(probable_flat, 1.0 - seen.confidence)
    flat = judged.flat and seen.diagnosis is not FailureKind.PILING and probable_flat >= SURE
    wrong = (
        *_wrong_shape(seen, target, moved, settings),
        *(f"{name} was not found good" for name in folds.doubtful),
    )
    probable_shape = _probable_shape(seen, target, moved, errors, folds)
    pressed: tuple[float, ...] = ()
    if not wrong and visible:
        pressed = tuple(
            judge(s).probability * _probable_shape(seen, target, moved, errors, folds, s)
            for s in STAYING ** np.arange(1, MOST_PRESSINGS + 1)
        )
    if not wrong and probable_shape < (SURE_AFTER if folds.disturbed else SURE):
        wrong = (
            f"its shape or place is so near to a limit that it is good with a probability of {probable_shape:.2f}",
        )
    elif not wrong and flat and (both := probable_shape * probable_flat) < SURE:
        wrong = (
            f"its shape and height are so near to limits that both are good with a probability of {both:.2f}",
        )
    if seen.diagnosis not in SHAPE_KEPT:
        probable_shape = min(probable_shape, 1.0 - seen.confidence)
    if folds.doubtful:
        probable_shape *= 0.5
    holds = probable_shape * probable_flat
    claim = Claim(
        shape=not wrong,
        flat=flat,
        reliability=holds if flat and not wrong else 1.0 - holds,
        height_m=height,
        height_limit_m=judged.height_limit_m,
        crease_height_m=crease,
        crease_height_limit_m=judged.crease_height_limit_m,
        camera_bias_m=bias.value,
        bending_length_m=bending.mean,
        target_iou=target.iou,
        drift_m=moved.drift_m,
        drift_rad=moved.drift_rad,
        says="",
        probable_flat=probable_flat,
        probable_pressed=pressed,
    )
    return replace(claim, says=_sentence(claim, wrong, seen, settings))


def _wrong_shape(
    seen: Inspection, target: TargetView, moved: Displacement, settings: InspectionSettings
) -> tuple[str, ...]:
    """Say what is wrong with the shape, one text each; empty if nothing is."""
    errors = settings.claim
    texts = [] if seen.diagnosis in SHAPE_KEPT else list(beyond_limits(seen, settings))
    if not target.iou >= errors.iou:
        texts.append(f"its overlap with the plan is {target.iou:.2f} (at least {errors.iou:.2f})")
    if moved.drift_m > errors.drift:
        texts.append(f"it lies {_mm(moved.drift_m)} from where it was laid (at most {_mm(errors.drift)})")
    if moved.drift_rad > errors.drift_angle:
        turned, most = (f"{math.degrees(a):.0f} degrees" for a in (moved.drift_rad, errors.drift_angle))
        texts.append(f"it has turned by {turned} (at most {most})")
    if seen.diagnosis not in SHAPE_KEPT and not texts:
        texts.append(f"it is not as predicted ({seen.diagnosis})")
    return tuple(texts)


def _probable_shape(
    seen: Inspection,
    target: TargetView,
    moved: Displacement,
    errors: ClaimSettings,
    folds: SeenFolds,
    staying: float = 1.0,
) -> float:
    """Probability that the true figures of the shape are within their limits, if this share of the crease's height
    stays."""
    within = (
        HIDDEN_GOOD ** len(folds.hidden),
        max(map(_apart, (*folds.earlier, seen)), key=lambda apart: apart.mean).at_most(Normal(MOST_APART, 0.0)),
        Normal(errors.iou, 0.0).at_most(_overlap(seen, target, staying)),
        Normal(moved.drift_m, DRIFT_SIGMA).at_most(Normal(errors.drift, 0.0)),
        Normal(moved.drift_rad, DRIFT_ANGLE_SIGMA).at_most(Normal(errors.drift_angle, 0.0)),
    )
    return math.prod(within)


def _overlap(seen: Inspection, target: TargetView, staying: float) -> Normal:
    """Return the overlap with the target that the score would measure. Where no crease is seen, the predicted one
    counts."""
    crease, flat = target.observed.crease_height_m, target.flat.crease_height_m
    if not math.isfinite(crease):
        crease = target.predicted.crease_height_m
    stays = flat + staying * (crease - flat) if crease > flat else crease
    drawn_in = BY_CREASE * stays if math.isfinite(stays) else 0.0
    side = target.side
    return Normal(OVERLAP + BY_PREDICTED * seen.iou_aligned - drawn_in / side, OVERLAP_SIGMA / side)


def _apart(seen: Inspection) -> Normal:
    """Return the distance of the fold's farthest edge or key point, as its deviations suggest [m]."""
    corner = float(np.fmax(edge_corner(seen), 0.0))  # 0 if it is unknown
    off = BY_OUTLINE * abs(seen.edge_deviation_m) + BY_CORNER * corner
    return Normal(USUALLY_APART + off, APART_SIGMA)


def _sentence(claim: Claim, wrong: tuple[str, ...], seen: Inspection, settings: InspectionSettings) -> str:
    if wrong:
        return f"not folded as planned: {', '.join(wrong)}"
    above, crease_above = (
        claim.height_m - claim.height_limit_m,
        claim.crease_height_m - claim.crease_height_limit_m,
    )
    if not claim.flat and claim.too_high:
        if crease_above > max(above, 0.0):
            return f"folded, but a crease stands {_mm(claim.crease_height_m)} high, {_over(crease_above)}"
        return f"folded, but stands {_mm(claim.height_m)} high, {_over(above)}"
    if not claim.flat and seen.diagnosis is FailureKind.PILING:
        return f"folded, but cloth is heaped up: {', '.join(beyond_limits(seen, settings))}"
    if not claim.flat and math.isfinite(claim.height_m):
        share, height, most = claim.probable_flat, _mm(claim.height_m), _mm(claim.height_limit_m)
        near = f"so near to a limit that it is flat with a probability of {share:.2f}"
        return f"folded, but {height} high (at most {most}) and {near}"
    if not claim.flat:
        return "folded, but its height cannot be seen"
    return f"folded as planned, {_mm(claim.height_m)} high (at most {_mm(claim.height_limit_m)})"


def _over(length: float) -> str:
    amount = f"{1e3 * length:.0f} mm" if length >= 0.0015 else f"{1e3 * length:.1f} mm"
    return f"{amount} more than it should"


def _mm(length: float) -> str:
    return f"{1e3 * length:.0f} mm"
