"""Chooses the garment whose template fits an outline, and judges how well it fits."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import cv2
import numpy as np

from foldcell.robots.ports import Array
from foldcell.skills.perception.classify import Match, polygon_iou
from foldcell.skills.perception.outline import GarmentOutline, MemberOutline, polygon_area, segment_lengths
from foldcell.skills.perception.registration.register import Registration
from foldcell.skills.perception.segmentation.mask import Segmentation
from foldcell.skills.perception.settings import PerceptionSettings
from foldcell.skills.vocabulary import Failure, FailureKind, Outcome

POLYGON_IOU = 0.91
"""Minimum overlap of a silhouette with the polygon of its key points."""
FREE_POLYGON_IOU, UNNAMED_IOU = 0.86, 0.93
"""Minimum overlap in a photograph, where limbs may be bent as well as swung; and if no garment was named, because
any shape with four corners resembles a towel."""
MEMBER_IOU, MOST_UNUSUAL = 0.90, 0.60
"""Minimum overlap of a member of a family, which has bends, and how unusual its proportions may be. A member with
very unusual ones resembles any outline, such as a rectangular print."""
MAX_DISTORTION = 0.20
"""Maximum difference from the template's proportions: standard deviation, over the outline's edges, of the
logarithm of observed over template length."""
LONGEST_TOWEL = 3.0
"""Maximum ratio of a towel's sides in a photograph: bar towels of 30 x 90 cm have it, and few have more."""
LEAST_WAIST = 0.15
"""Minimum width of a skirt's waist in a photograph, relative to its hem's. The narrowest is that of a full circle,
laid flat as half of one: 0.16 for a length of 60 cm and a waist of 70 cm."""
MOST_UNEQUAL = 1.8
"""Maximum ratio of the areas of two sleeves in a photograph. Those of 35 flat shirts of the real set
(`benchmarks.photographs`) differ by a factor of up to 1.35."""
LEAST_TURN = 0.35
"""Minimum turn of the outline at the place of a sharp corner, relative to the turn of this corner in the
template."""
CLEAR = 0.9
"""If more than this share of an outline is clearly visible, it is the garment's."""
SOLID = 0.95
"""An outline has limbs if its area is less than this share of its convex hull's."""
CATEGORY_MARGIN = 0.03
"""The expected category is accepted unless another category has an overlap that is larger by more than
this."""


def wanted_garment(garments: Sequence[GarmentOutline], expected: str | None) -> GarmentOutline | None:
    if expected is None:
        return None
    for garment in garments:
        if garment.name == expected:
            return garment
    raise ValueError(f"{expected!r} is none of {[g.name for g in garments]}")


def choose_garment(
    matches: tuple[Match, ...], wanted: GarmentOutline | None, settings: PerceptionSettings
) -> Outcome[Match]:
    """Choose the match of the wanted garment, or without one the best match of the right size.

    Failures: UNKNOWN_GARMENT, CATEGORY_MISMATCH.
    """
    if not matches:
        return Outcome(failure=Failure(FailureKind.UNKNOWN_GARMENT, "there is no template to compare with"))
    best = max(matches, key=lambda m: m.iou)
    values = {"best": best.garment.name, "best_iou": best.iou, "scale": best.scale}
    if best.iou < settings.min_template_iou:
        what = f"the silhouette matches no known garment (nearest {best.garment.name}, overlap {best.iou:.2f})"
        hint = "spread the garment flat, or make a template with `foldcell garment new`"
        return Outcome(failure=Failure(FailureKind.UNKNOWN_GARMENT, what, hint, values))
    if wanted is None:
        return _match_of_size(matches, best, settings)
    match = next(m for m in matches if m.garment.name == wanted.name)
    hint = "put the expected garment on the table, or name the right one"
    if best.garment.category != wanted.category and match.iou < best.iou - CATEGORY_MARGIN:
        what = f"expected {wanted.name}, but the silhouette is of category {best.garment.category}"
        values = {**values, "expected": wanted.name, "expected_iou": match.iou}
        return Outcome(failure=Failure(FailureKind.CATEGORY_MISMATCH, what, hint, values))
    if not _fits_in_size(match, settings):
        what = f"expected {wanted.name}, but the garment is {match.scale:.2f} times its size"
        values = {**values, "expected": wanted.name, "scale": match.scale}
        return Outcome(failure=Failure(FailureKind.CATEGORY_MISMATCH, what, hint, values))
    return Outcome(match)


def _match_of_size(matches: tuple[Match, ...], best: Match, settings: PerceptionSettings) -> Outcome[Match]:
    """Return the first match whose size fits, among those whose IoU is within `CATEGORY_MARGIN` of the best;
    otherwise a failure.

    `choose_garment` applies the same size limit to an expected garment. Therefore a garment chosen here is not
    refused for its size by a later perception that expects it.
    """
    near = [m for m in matches if m.iou >= best.iou - CATEGORY_MARGIN]
    fitting = next((m for m in near if _fits_in_size(m, settings)), None)
    if fitting is not None:
        return Outcome(fitting)
    nearest, scale = near[0].garment.name, near[0].scale
    return Outcome(
        failure=Failure(
            FailureKind.UNKNOWN_GARMENT,
            f"no known garment has this shape and size (nearest {nearest}, but {scale:.2f} times its size)",
            "put a known garment on the table, or make a template with `foldcell garment new`",
            {"best": nearest, "best_iou": near[0].iou, "scale": scale},
        )
    )


def _fits_in_size(match: Match, settings: PerceptionSettings) -> bool:
    return not settings.size_known or bool(abs(np.log(match.scale)) <= np.log1p(settings.size_tolerance))


def misfit(
    registration: Registration, garment: GarmentOutline, contour: Array, free: bool, named: bool
) -> Failure | None:
    """Return UNKNOWN_GARMENT, LOW_CONFIDENCE or NOT_FLAT when the key points do not fit the garment, else None.

    The registered contour bends freely and follows any silhouette, but the polygon of its key points does not.
    This polygon is therefore compared with the silhouette. free: whether the garment may have any shape of its
    category. named: whether this garment is expected.
    LOW_CONFIDENCE: a key point that should be a sharp corner lies where the outline has no corner. NOT_FLAT: one
    sleeve is much smaller than the other.
    """
    if free and (failure := _unequal_sleeves(registration.keypoints)) is not None:
        return failure
    polygon = np.array([registration.keypoints[name] for name in garment.keypoints])
    lengths = segment_lengths(np.asarray(garment.template, dtype=float))
    ratio = np.log(np.maximum(segment_lengths(polygon), 1e-6) / lengths)
    least, unusual = (FREE_POLYGON_IOU if named else UNNAMED_IOU) if free else POLYGON_IOU, 0.0
    impossible = free and _without_waist(registration.keypoints)
    if isinstance(garment, MemberOutline):
        least, unusual = MEMBER_IOU, garment.unusual
        impossible = impossible or unusual > MOST_UNUSUAL
        # Its bends belong to the shape, and an edge of a few millimetres, as an underarm seam, has any ratio.
        overlap = polygon_iou(garment.placed, contour)
        middle = np.average(ratio, weights=lengths)
        distortion = float(np.sqrt(np.average((ratio - middle) ** 2, weights=lengths)))
    else:
        sides = segment_lengths(polygon) + np.roll(segment_lengths(polygon), 2)
        if free and garment.category == "towel" and sides.max() <= LONGEST_TOWEL * sides.min():
            # Its sides may have any proportions, so that only opposite ones are compared.
            ratio = 0.5 * (ratio - np.roll(ratio, 2))
        overlap, distortion = polygon_iou(polygon, contour), float(ratio.std())
    if overlap >= least and distortion <= MAX_DISTORTION and not impossible:
        if registration.least_turn >= LEAST_TURN:
            return None
        return Failure(
            FailureKind.LOW_CONFIDENCE,
            f"the outline has no corner at the {registration.straightest} of {garment.name}",
            "straighten the garment, especially its ends, or make a template with `foldcell garment new`",
            {"least_turn": registration.least_turn, "keypoint": registration.straightest},
        )
    return Failure(
        FailureKind.UNKNOWN_GARMENT,
        f"the silhouette is not that of {garment.name} (polygon of the key points overlaps by {overlap:.2f}, "
        f"proportions differ by {distortion:.0%})"
        if not impossible
        else f"the silhouette fits {garment.name} only in proportions that no such garment has",
        "spread the garment flat, or make a template with `foldcell garment new`",
        {"polygon_iou": overlap, "distortion": distortion, "unusual": unusual},
    )


def _without_waist(keypoints: Mapping[str, Array]) -> bool:
    """Whether a skirt runs to a point, as any outline with a tip can be fitted by one."""
    if not {f"{end}_{side}" for end in ("waist", "hem") for side in ("left", "right")} <= set(keypoints):
        return False
    waist, hem = (np.linalg.norm(keypoints[f"{end}_left"] - keypoints[f"{end}_right"]) for end in ("waist", "hem"))
    return bool(waist < LEAST_WAIST * hem)


def _unequal_sleeves(keypoints: Mapping[str, Array]) -> Failure | None:
    """Return NOT_FLAT if one sleeve is much smaller than the other: it is folded over or pushed together."""
    parts = "shoulder", "cuff_upper", "cuff_lower", "armpit"
    if not {f"{part}_{side}" for part in parts for side in ("left", "right")} <= set(keypoints):
        return None
    areas = {
        side: abs(polygon_area(np.array([keypoints[f"{part}_{side}"] for part in parts])))
        for side in ("left", "right")
    }
    small, large = sorted(areas, key=lambda side: areas[side])
    if areas[large] <= MOST_UNEQUAL * areas[small]:
        return None
    share = areas[small] / areas[large]
    return Failure(
        FailureKind.NOT_FLAT,
        f"the {small} sleeve is only {share:.0%} as large as the {large} one",
        "stretch the sleeve out, with nothing folded over",
        {"sleeve_share": share, "keypoint": f"cuff_upper_{small}"},
    )


def fit_quality(segmentation: Segmentation, iou: float, registration: Registration) -> float:
    """Compute how well the outline fits (0..1), which decides whether the garment is accepted: the product of the
    confidence of the segmentation, the overlap with the template (0.85..0.97 -> 0..1) and the residual of the
    registration (8..2 mm -> 0..1)."""
    overlap = float(np.clip((iou - 0.85) / 0.12, 0.0, 1.0))
    fit = float(np.clip((0.008 - registration.residual) / 0.006, 0.0, 1.0))
    return segmentation.confidence * overlap * fit


def flatness(failure: Failure, segmentation: Segmentation, settings: PerceptionSettings) -> Failure:
    """Return NOT_FLAT in place of a misfit in a photograph, which has no depth: a garment whose outline is clearly
    visible, but which no flat garment has, is folded, bunched or in a heap. A sleeve without corners at its cuff
    is bunched. Other failures stay."""
    outline = segmentation.contour.astype(np.float32)
    limbs = cv2.contourArea(outline) < SOLID * cv2.contourArea(cv2.convexHull(outline))
    bunched = limbs and "least_turn" in failure.values and str(failure.values["keypoint"]).startswith("cuff")
    misfits = failure.kind is FailureKind.UNKNOWN_GARMENT or "fit" in failure.values or bunched
    if settings.size_known or not misfits or segmentation.confidence < CLEAR:
        return failure
    return Failure(
        FailureKind.NOT_FLAT,
        f"no flat garment has this outline, which is clearly visible: {failure.what}",
        "spread it flat, with nothing folded over, and sleeves and legs stretched out",
        failure.values,
    )
