"""Perceives the garment: computes its state on the table from one picture, or gives the reason why it cannot."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from robots.ports import Array, frozen
from skills.perception.camera_fault import camera_fault, same_picture
from skills.perception.candidate import choose_garment, fit_quality, misfit, wanted_garment
from skills.perception.classify import classify, polygon_iou
from skills.perception.family import best_members
from skills.perception.limb_poses import best_poses
from skills.perception.outline import GarmentOutline
from skills.perception.rectification.heights import garment_height
from skills.perception.rectification.table_view import TableView
from skills.perception.registration.accuracy import keypoint_sigmas, probability_within
from skills.perception.registration.details.cloth_picture import ClothPicture
from skills.perception.registration.details.picture_refinement import refine_by_picture
from skills.perception.registration.register import Registration, register
from skills.perception.segmentation.mask import Segmentation
from skills.perception.segmentation.photograph import propose_garments
from skills.perception.settings import PerceptionSettings
from skills.perception.silhouette import segmentations
from skills.perception.usable_region import unusable
from skills.perception.views import Views, open_views
from skills.vocabulary import CameraCalibration, CameraFrame, Failure, FailureKind, GarmentState, Outcome, Table

__all__ = ["Perception", "perceive"]

SURE_FIT = 0.82
"""A proposal with at least this quality of fit (`candidate.fit_quality`) is accepted before the others are
tried."""
ACCURATE_WITHIN = 0.010
"""The confidence is the probability that all key points lie within this distance of their true places, on a
garment of its nominal size."""


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
        for method, segmentation in _regions(views, settings, stages)
    )
    decided = _best(looks)
    if on_region is not None:
        on_region(views.view, decided.segmentation)
    return decided.outcome


_PROPOSAL = "proposal"
"""Name of the method that proposes regions in a photograph (`propose_garments`)."""


@dataclass(frozen=True, eq=False)
class _Look:
    """The result for one region that may be the garment. method: name of the method that found the region."""

    segmentation: Segmentation
    method: str
    outcome: Outcome[Perception]

    @property
    def proposed(self) -> bool:
        return self.method == _PROPOSAL

    @property
    def refusal(self) -> FailureKind | None:
        return self.outcome.failure.kind if self.outcome.failure is not None else None


def _regions(
    views: Views, settings: PerceptionSettings, stages: _StageTimes
) -> Iterator[tuple[str, Segmentation]]:
    """Yield the regions to try in turn, each with the name of the method that found it."""
    for method, found in segmentations(views, settings.method):
        stages.done("segment")
        yield method, found
    if settings.method == "reference" and views.empty is None:
        proposals = propose_garments(views.seen.rgb, views.seen.valid)
        stages.done("segment")
        yield from ((_PROPOSAL, found) for found in proposals)


def _best(looks: Iterator[_Look]) -> _Look:
    """Return the first accepted region of a method, or the accepted proposal that fits best. If none is accepted,
    return the refusal of the region that came furthest."""
    accepted: list[_Look] = []
    refused: list[_Look] = []
    for look in looks:
        if not look.outcome.ok:
            refused.append(look)
        elif not look.proposed or look.outcome.unwrap().fit >= SURE_FIT:
            return look
        else:
            accepted.append(look)
    if accepted:
        return max(accepted, key=lambda look: look.outcome.unwrap().fit)
    with_garment = [look for look in refused if look.refusal is not FailureKind.NO_GARMENT]
    fitted = [look for look in with_garment if look.proposed and look.refusal is FailureKind.LOW_CONFIDENCE]
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

    def look(failure: Failure | None, value: Perception | None = None) -> _Look:
        return _Look(segmentation, method, Outcome(value, failure, notes=dict(stages.notes)))

    view, seen, height = views.view, views.seen, views.height
    stages.notes["segmentation_method"] = method
    stages.notes["segmentation_confidence"] = segmentation.confidence
    if (failure := unusable(segmentation, view, height, settings)) is not None:
        return look(failure)

    top = garment_height(segmentation.mask, height)
    contour = view.to_table(segmentation.contour, top)
    nominal = {garment.name: garment for garment in garments}
    if method == _PROPOSAL:
        # Without a name, a shape with so much freedom would win too easily, and fits of all families take long.
        garments = best_poses(contour, garments) if wanted is None else best_members(contour, garments)
    matches = classify(contour, garments)
    stages.done("classify")
    chosen = choose_garment(matches, wanted, settings)
    if chosen.failure is not None:
        return look(chosen.failure)
    match = chosen.unwrap()
    garment = match.garment
    registration = register(contour, garment)
    cloth = _cloth_picture(views, segmentation.mask, top)
    registration = refine_by_picture(registration, nominal[garment.name], contour, cloth)
    stages.done("register")

    if (failure := misfit(registration, garment, contour, proposed=method == _PROPOSAL)) is not None:
        return look(failure)
    iou = polygon_iou(registration.contour, contour)
    fit = fit_quality(segmentation, iou, registration)
    sigmas = keypoint_sigmas(registration, nominal[garment.name], contour)
    confidence = probability_within(sigmas, ACCURATE_WITHIN * registration.scale)
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
        return look(
            Failure(
                FailureKind.LOW_CONFIDENCE,
                f"the outline of {garment.name} fits only to {fit:.2f} of 1",
                "straighten the garment, or check light and the empty table's picture",
                {"fit": fit, "iou": iou, "boundary_rms_m": registration.residual},
            )
        )
    if confidence < settings.least_confidence:
        return look(_ambiguous(garment.name, sigmas, confidence))
    state = GarmentState(
        garment.category, registration.contour, registration.keypoints, confidence, registration.ambiguous
    )
    rgb, height = frozen(seen.rgb), frozen(height)
    return look(None, Perception(state, garment.name, registration, segmentation, view, rgb, height, top, fit))


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
