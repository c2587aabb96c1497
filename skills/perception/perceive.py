"""Perceives the garment: computes its state on the table from one picture, or gives the reason why it cannot."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray

from foldcell.robots.ports import Array, frozen
from foldcell.skills.perception.camera_fault import camera_fault, same_picture
from foldcell.skills.perception.candidate import choose_garment, fit_quality, misfit, wanted_garment
from foldcell.skills.perception.classify import Match, classify, polygon_iou
from foldcell.skills.perception.family import best_members
from foldcell.skills.perception.limb_poses import best_poses
from foldcell.skills.perception.outline import GarmentOutline, MemberOutline
from foldcell.skills.perception.rectification.heights import garment_height
from foldcell.skills.perception.rectification.table_view import TableView
from foldcell.skills.perception.registration.accuracy import keypoint_sigmas, probability_within
from foldcell.skills.perception.registration.details.cloth_picture import ClothPicture
from foldcell.skills.perception.registration.details.picture_refinement import refine_by_picture
from foldcell.skills.perception.registration.register import Registration, register
from foldcell.skills.perception.segmentation.mask import Segmentation
from foldcell.skills.perception.segmentation.photograph import propose_garments
from foldcell.skills.perception.settings import PerceptionSettings
from foldcell.skills.perception.silhouette import segmentations
from foldcell.skills.perception.usable_region import unusable
from foldcell.skills.perception.views import Views, open_views
from foldcell.skills.vocabulary import (
    CameraCalibration,
    CameraFrame,
    Failure,
    FailureKind,
    GarmentState,
    Outcome,
    Table,
)

__all__ = ["Perception", "perceive"]

SURE_FIT = 0.82
"""A proposal with at least this quality of fit (`candidate.fit_quality`) is accepted before the others are
tried."""
ACCURATE_WITHIN = 0.010
"""The confidence is the probability that all key points lie within this distance of their true places, on a
garment of its nominal size."""
ACCURATE_SHARE = 0.02
"""The same in a picture of unknown scale, relative to the diagonal of the garment's key points."""
AUTO_CATEGORIES, AUTO_MARGIN = 3, 0.12
"""If no garment is named in a photograph, so many categories are fitted by their family; their overlap, before,
must be within this of the best one's."""
WHOLE = 0.9
"""A region is a part of a garment if it lies within one whose outline is clearly visible by more than this."""
TOO_NEAR, STRAIN_COST = 0.01, 0.1
"""If the likeness of another category is within the first of the best one's, the garment is not recognised. The
likeness is the overlap, less the strain times the second."""


@dataclass(frozen=True, eq=False)
class Perception:
    """The garment's state for planning, with the intermediate results for the record and the overlay.

    garment: name of the garment whose template fits. rgb: (H, W, 3), height: (H, W) above the table [m], mask:
    (H, W), and the contour of `segmentation` are in `view`'s pixels. top: mean height of the garment's upper side
    above the table [m]. fit: quality of the fit (0..1), see `candidate.fit_quality`. The confidence in `state` is
    the probability that all key points are accurate.
    """

    state: GarmentState
    garment: str
    registration: Registration
    segmentation: Segmentation
    view: TableView
    rgb: NDArray[np.uint8]
    height: NDArray[np.float32]
    top: float
    fit: float

    @property
    def mask(self) -> NDArray[np.bool_]:
        return self.segmentation.mask


class _StageTimes:
    """Measures the wall times of the stages, for the record only."""

    def __init__(self) -> None:
        self.notes: dict[str, float | int | str] = {}
        self._last = time.perf_counter()

    def done(self, stage: str) -> None:
        now = time.perf_counter()
        self.notes[f"{stage}_time_s"] = now - self._last
        self._last = now


def perceive(
    frame: CameraFrame,
    calibration: CameraCalibration,
    table: Table,
    reference: CameraFrame | None,
    garments: Sequence[GarmentOutline],
    expected: str | None = None,
    *,
    settings: PerceptionSettings,
    previous: CameraFrame | None = None,
    on_region: Callable[[TableView, Segmentation], None] | None = None,
) -> Outcome[Perception]:
    """Segment, classify and register the garment in one picture.

    reference: picture of the empty table. garments: the candidates. expected: a garment's name, or None to accept
    any of them. previous: an earlier picture, to detect a frozen camera. on_region: called at the end with the
    region that was taken for the garment, even if it is refused.

    Failures: CAMERA_FAULT, VIEW_OBSTRUCTED, NO_GARMENT, OUT_OF_VIEW, NOT_FLAT, UNKNOWN_GARMENT, CATEGORY_MISMATCH,
    LOW_CONFIDENCE. Raises ValueError when `expected` is not among `garments`.
    """
    wanted = wanted_garment(garments, expected)
    stages = _StageTimes()

    if reference is not None:
        fault = camera_fault(reference, calibration, None, settings) or same_picture(frame, reference)
        if fault is not None:
            return Outcome(failure=fault, notes=stages.notes)
    opened = open_views(frame, calibration, table, reference, previous, settings)
    if opened.failure is not None:
        return Outcome(failure=opened.failure, notes=stages.notes)
    views = opened.unwrap()
    stages.done("view")
    looks = (
        _perceive_region(segmentation, method, views, garments, wanted, settings, stages)
        for method, segmentation in _regions(views, settings, stages, wanted is None)
    )
    decided = _best(looks)
    if on_region is not None:
        on_region(views.view, decided.segmentation)
    return decided.outcome


_PROPOSAL = "proposal"
"""Name of the method that proposes regions in a photograph (`propose_garments`)."""


@dataclass(frozen=True, eq=False)
class _Look:
    """The result for one region that may be the garment. free: whether the garment may have any shape of its
    category."""

    segmentation: Segmentation
    free: bool
    outcome: Outcome[Perception]

    @property
    def refusal(self) -> FailureKind | None:
        return self.outcome.failure.kind if self.outcome.failure is not None else None


def _regions(
    views: Views, settings: PerceptionSettings, stages: _StageTimes, any_garment: bool
) -> Iterator[tuple[str, Segmentation]]:
    """Yield the regions to try in turn, each with the name of the method that found it. any_garment: whether none
    is named; parts of a garment, such as the body of a shirt with sleeves of another colour, are then left out."""
    whole: list[Segmentation] = []
    for method, found in segmentations(views, settings.method):
        stages.done("segment")
        whole.append(found)
        yield method, found
    if settings.method == "reference" and views.empty is None:
        proposals = propose_garments(views.seen.rgb, views.seen.valid)
        stages.done("segment")
        whole += proposals
        for found in proposals:
            if not (any_garment and any(_is_part(found, other) for other in whole)):
                yield _PROPOSAL, found


def _is_part(found: Segmentation, other: Segmentation) -> bool:
    """Whether a region lies within a larger one whose whole outline is clearly visible."""
    area = np.count_nonzero(found.mask)
    if other.confidence < WHOLE or not 1.15 * area < np.count_nonzero(other.mask) < 2.5 * area:
        return False
    return bool(np.count_nonzero(found.mask & other.mask) > 0.97 * area)


def _best(looks: Iterator[_Look]) -> _Look:
    """Return the first accepted region of a method, or the accepted proposal that fits best. If none is accepted,
    return the refusal of the region that came furthest."""
    accepted: list[_Look] = []
    refused: list[_Look] = []
    for look in looks:
        if not look.outcome.ok:
            refused.append(look)
        elif not look.free or look.outcome.unwrap().fit >= SURE_FIT:
            return look
        else:
            accepted.append(look)
    if accepted:
        return max(accepted, key=lambda look: look.outcome.unwrap().fit)
    with_garment = [look for look in refused if look.refusal is not FailureKind.NO_GARMENT]
    fitted = [look for look in with_garment if look.free and look.refusal is FailureKind.LOW_CONFIDENCE]
    return (fitted or with_garment or refused)[0]


def _perceive_region(
    segmentation: Segmentation,
    method: str,
    views: Views,
    garments: Sequence[GarmentOutline],
    wanted: GarmentOutline | None,
    settings: PerceptionSettings,
    stages: _StageTimes,
) -> _Look:
    """Judge and register one region."""
    free = method == _PROPOSAL or not settings.size_known

    def look(failure: Failure | None, value: Perception | None = None) -> _Look:
        return _Look(segmentation, free, Outcome(value, failure, notes=dict(stages.notes)))

    view, height = views.view, views.height
    stages.notes["segmentation_method"] = method
    stages.notes["segmentation_confidence"] = segmentation.confidence
    if (failure := unusable(segmentation, view, height, settings, views.empty is not None)) is not None:
        return look(failure)

    top = garment_height(segmentation.mask, height)
    contour = view.to_table(segmentation.contour, top)
    nominal = {garment.name: garment for garment in garments}
    if free and wanted is None:
        matches = _likely(contour, garments)
    else:
        matches = classify(contour, best_members(contour, garments) if free else garments)
    stages.done("classify")
    chosen = choose_garment(matches, wanted, settings)
    if chosen.failure is not None:
        return look(chosen.failure)
    best = chosen.unwrap()
    judge = partial(_judged, free, segmentation, contour, top, views, settings, stages)
    if not free or wanted is not None:
        judged = judge(best, nominal[best.garment.name])
        return look(judged.failure, judged.value)
    rivals: dict[str, Match] = {}
    for match in (best, *matches):
        if match.iou >= best.iou - AUTO_MARGIN and len(rivals) < AUTO_CATEGORIES:
            rivals.setdefault(match.garment.category, match)
    judged_as = {name: judge(match, nominal[match.garment.name]) for name, match in rivals.items()}
    # A category whose key points are uncertain is a doubt; one that does not fit the region is none.
    near = [
        (_likeness(rivals[name]), name)
        for name, judged in judged_as.items()
        if judged.failure is None or "sigma_m" in judged.failure.values
    ]
    if not near:
        return look(judged_as[best.garment.category].failure)
    (likeness, name), *others = sorted(near, reverse=True)
    if others and others[0][0] > likeness - TOO_NEAR:
        return look(_either(rivals[name], rivals[others[0][1]]))
    return look(judged_as[name].failure, judged_as[name].value)


def _likeness(match: Match) -> float:
    """The overlap of a garment with a region, less for unusual figures."""
    return match.iou - STRAIN_COST * (match.garment.strain if isinstance(match.garment, MemberOutline) else 0.0)


def _likely(contour: Array, garments: Sequence[GarmentOutline]) -> tuple[Match, ...]:
    """Compare the garments with an observed boundary (n, 2) [m], in poses that fit it, and those of the likeliest
    categories with the shape of their family that fits. Best first."""
    nominal = {garment.name: garment for garment in garments}
    posed = classify(contour, best_poses(contour, garments))
    likely: dict[str, str] = {}
    for match in posed:
        if len(likely) < AUTO_CATEGORIES and match.iou >= max(m.iou for m in posed) - AUTO_MARGIN:
            likely.setdefault(match.garment.category, match.garment.name)
    members = best_members(contour, [nominal[name] for name in likely.values()])
    shaped = [member for member in members if isinstance(member, MemberOutline)]
    better = {match.garment.name: match for match in classify(contour, shaped)}
    return tuple(sorted((better.get(m.garment.name, m) for m in posed), key=lambda match: -match.iou))


def _judged(
    free: bool,
    segmentation: Segmentation,
    contour: Array,
    top: float,
    views: Views,
    settings: PerceptionSettings,
    stages: _StageTimes,
    match: Match,
    nominal: GarmentOutline,
) -> Outcome[Perception]:
    """Register a garment in a region, and judge how well it fits. free: see `_Look`. contour: (n, 2) boundary of
    the region [m]. top: height of the garment's upper side [m]. nominal: the garment with its own shape."""
    garment = match.garment
    registered, fitted = register(contour, garment), isinstance(garment, MemberOutline)
    cloth = _cloth_picture(views, segmentation.mask, top)
    registration = refine_by_picture(registered, nominal, contour, cloth, not fitted)
    stages.done("register")

    if (failure := misfit(registered if free else registration, garment, contour, free)) is not None:
        return Outcome(failure=failure)
    iou = polygon_iou(registration.contour, contour)
    fit = fit_quality(segmentation, iou, registration)
    sigmas = keypoint_sigmas(registration, nominal, contour)
    within = ACCURATE_WITHIN * registration.scale
    if not settings.size_known:
        within = ACCURATE_SHARE * float(np.linalg.norm(np.ptp([*registration.keypoints.values()], axis=0)))
    confidence = probability_within(sigmas, within)
    stages.notes |= {
        "iou": iou,
        "scale": match.scale,
        "fit": fit,
        "confidence": confidence,
        "boundary_rms_m": registration.residual,
        "updates": len(registration.history) - 1,
        "garment_height_m": top,
        "least_turn": registration.least_turn,
    }
    if fit < settings.min_fit:
        failure = Failure(
            FailureKind.LOW_CONFIDENCE,
            f"the outline of {garment.name} fits only to {fit:.2f} of 1",
            "straighten the garment, or check the light"
            if views.empty is None
            else "straighten the garment, or check light and the empty table's picture",
            {"fit": fit, "iou": iou, "boundary_rms_m": registration.residual},
        )
        return Outcome(failure=failure)
    if confidence < settings.least_confidence:
        return Outcome(failure=_ambiguous(garment.name, sigmas, confidence))
    state = GarmentState(
        garment.category, registration.contour, registration.keypoints, confidence, registration.ambiguous
    )
    rgb, height = frozen(views.seen.rgb), frozen(views.height)
    return Outcome(Perception(state, garment.name, registration, segmentation, views.view, rgb, height, top, fit))


def _either(first: Match, second: Match) -> Failure:
    """The refusal of a garment that could as well be of another category."""
    names = first.garment.name, second.garment.name
    what = f"the silhouette is that of {names[0]} (overlap {first.iou:.2f}) or of {names[1]} ({second.iou:.2f})"
    values = {"best": names[0], "best_iou": first.iou, "second": names[1], "second_iou": second.iou}
    return Failure(FailureKind.UNKNOWN_GARMENT, what, "name the garment", values)


def _ambiguous(garment: str, sigmas: Mapping[str, float], confidence: float) -> Failure:
    """The refusal of a garment whose key points are not visible well enough. sigmas: name -> [m]."""
    name = max(sigmas, key=lambda name: sigmas[name])
    return Failure(
        FailureKind.LOW_CONFIDENCE,
        f"the picture does not show where the {name} of {garment} is: its key points are accurate only with a "
        f"probability of {confidence:.2f}",
        "lay sleeves and legs apart, or use a table of another colour or more even light",
        {"confidence": confidence, "keypoint": name, "sigma_m": sigmas[name]},
    )


def _cloth_picture(views: Views, mask: NDArray[np.bool_], top: float) -> ClothPicture:
    """The picture of a garment whose upper side is at the height `top` [m]."""
    view = views.view

    def to_photo(points: Array) -> Array:
        return view.to_image(np.column_stack([points, np.full(len(points), top)]))

    return ClothPicture(views.seen.rgb, mask, lambda points: view.at_height(points, top), views.photo, to_photo)
