"""Perceives the garment: computes its state on the table from one picture, or gives the reason why it cannot."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from robots.ports import Array, frozen
from skills.perception.camera_fault import camera_fault, same_picture, table_unseen
from skills.perception.candidate import choose_garment, fit_quality, misfit, wanted_garment
from skills.perception.classify import Match, classify, polygon_iou
from skills.perception.garment_height import garment_height, height_above
from skills.perception.limb_poses import best_poses
from skills.perception.outline import GarmentOutline
from skills.perception.rectification.table_view import RectifiedView, TableView
from skills.perception.registration.accuracy import keypoint_sigmas, probability_within
from skills.perception.registration.details.cloth_picture import ClothPicture
from skills.perception.registration.details.picture_refinement import refine_by_picture
from skills.perception.registration.register import Registration, register
from skills.perception.segmentation.mask import Segmentation
from skills.perception.segmentation.obstruction import obstructed
from skills.perception.segmentation.photograph import propose_garments
from skills.perception.segmentation.segment import methods, segment
from skills.perception.settings import PerceptionSettings
from skills.perception.usable_region import unusable
from skills.vocabulary import CameraCalibration, CameraFrame, Failure, FailureKind, GarmentState, Outcome, Table

__all__ = ["Perception", "perceive"]


@dataclass(frozen=True, eq=False)
class Perception:
    """The garment's state for planning, with the intermediate results for the record and the overlay.

    garment: name of the garment whose template fits. rgb: (H, W, 3), height: (H, W) above the table [m], mask:
    (H, W), and the contour of `segmentation` are in `view`'s pixels. matches: all candidates, best first. top:
    mean height of the garment's upper side above the table [m]. fit: quality of the fit (0..1), see
    `candidate.fit_quality`. The confidence in `state` is the probability that all key points are accurate.
    """

    state: GarmentState
    garment: str
    registration: Registration
    segmentation: Segmentation
    matches: tuple[Match, ...]
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
    settings: PerceptionSettings | None = None,
    previous: CameraFrame | None = None,
    on_region: Callable[[TableView, Segmentation], None] | None = None,
) -> Outcome[Perception]:
    """Segment, classify and register the garment in one picture.

    reference: picture of the empty table. garments: the candidates. expected: a garment's name, or None to accept
    any of them. previous: an earlier picture, to detect a frozen camera. on_region: is given what was taken for
    the garment in the end, also if it is refused.

    Failures: CAMERA_FAULT, VIEW_OBSTRUCTED, NO_GARMENT, OUT_OF_VIEW, NOT_FLAT, UNKNOWN_GARMENT, CATEGORY_MISMATCH,
    LOW_CONFIDENCE. Raises ValueError when `expected` is not among `garments`.
    """
    settings = settings or PerceptionSettings()
    wanted = wanted_garment(garments, expected)
    stages = _StageTimes()

    camera_failure = camera_fault(frame, calibration, previous, settings)
    if camera_failure is None and reference is not None:
        camera_failure = camera_fault(reference, calibration, None, settings) or same_picture(frame, reference)
    if camera_failure is not None:
        return Outcome(failure=camera_failure, notes=stages.notes)
    view = TableView(calibration, table, settings.pixel)
    if (unseen := table_unseen(view, settings)) is not None:
        return Outcome(failure=unseen, notes=stages.notes)
    seen = view.rectify(frame)
    empty = view.rectify(reference) if reference is not None else None
    if (hidden := obstructed(view, seen, empty)) is not None:
        return Outcome(failure=hidden, notes=stages.notes)
    picture = _Picture(view, seen, empty, height_above(seen, empty), frame.rgb)
    stages.done("view")
    looks = _looks(picture, garments, wanted, settings, stages)
    decided = _best(looks, settings)
    if on_region is not None:
        on_region(view, decided.region.segmentation)
    return decided.outcome


@dataclass(frozen=True, eq=False)
class _Picture:
    """The input of the stages. seen: the rectified picture. empty: that of the empty table, or None. height:
    (H, W) above the table [m]. photo: (rows, columns, 3), as the camera took it."""

    view: TableView
    seen: RectifiedView
    empty: RectifiedView | None
    height: NDArray[np.float32]
    photo: NDArray[np.uint8]


@dataclass(frozen=True, eq=False)
class _Region:
    """A region that may be the garment. proposed: by `propose_garments`."""

    segmentation: Segmentation
    method: str
    proposed: bool = False


@dataclass(frozen=True, eq=False)
class _Look:
    region: _Region
    outcome: Outcome[Perception]

    @property
    def fit(self) -> float:
        return self.outcome.unwrap().fit if self.outcome.ok else 0.0


def _looks(
    picture: _Picture,
    garments: Sequence[GarmentOutline],
    wanted: GarmentOutline | None,
    settings: PerceptionSettings,
    stages: _StageTimes,
) -> Iterator[_Look]:
    for region in _segmentations(picture, settings, stages):
        yield _Look(region, _perceive_region(region, picture, garments, wanted, settings, stages))


def _segmentations(picture: _Picture, settings: PerceptionSettings, stages: _StageTimes) -> Iterator[_Region]:
    """Yield the regions to try in turn."""
    seen, empty = picture.seen, picture.empty
    reference = empty.rgb if empty is not None else None
    for method in methods(settings.method, empty is not None):
        found = segment(method, seen.rgb, reference, seen.valid, picture.height, settings.segmentation)
        stages.done("segment")
        yield _Region(found, method)
    if settings.method == "reference" and empty is None:
        proposals = propose_garments(seen.rgb, seen.valid, settings.segmentation.smallest_area)
        stages.done("segment")
        yield from (_Region(found, "proposal", proposed=True) for found in proposals)


def _best(looks: Iterator[_Look], settings: PerceptionSettings) -> _Look:
    """Return the first accepted region of a method, or the accepted proposal that fits best. If none is accepted,
    return the refusal of the region that came furthest."""
    accepted: list[_Look] = []
    refused: list[_Look] = []
    for look in looks:
        if not look.outcome.ok:
            refused.append(look)
        elif not look.region.proposed or look.fit >= settings.sure:
            return look
        else:
            accepted.append(look)
    if accepted:
        return max(accepted, key=lambda look: look.fit)
    with_garment = [look for look in refused if _kind(look) is not FailureKind.NO_GARMENT]
    fitted = [look for look in with_garment if look.region.proposed and _kind(look) is FailureKind.LOW_CONFIDENCE]
    return (fitted or with_garment or refused)[0]


def _kind(look: _Look) -> FailureKind | None:
    return look.outcome.failure.kind if look.outcome.failure is not None else None


def _perceive_region(
    region: _Region,
    picture: _Picture,
    garments: Sequence[GarmentOutline],
    wanted: GarmentOutline | None,
    settings: PerceptionSettings,
    stages: _StageTimes,
) -> Outcome[Perception]:
    view, seen, height, segmentation = picture.view, picture.seen, picture.height, region.segmentation

    def failed(failure: Failure) -> Outcome[Perception]:
        return Outcome(failure=failure, notes=dict(stages.notes))

    stages.notes["segmentation_method"] = region.method
    stages.notes["segmentation_confidence"] = segmentation.confidence
    failure = unusable(segmentation, view, height, settings)
    if failure is not None:
        return failed(failure)

    top = garment_height(segmentation.mask, height)
    contour = view.to_table(segmentation.contour, top)
    nominal = {garment.name: garment for garment in garments}
    if region.proposed:
        garments = best_poses(contour, garments)
        settings = replace(settings, polygon_iou=settings.proposed_polygon_iou)
    matches = classify(contour, garments)
    stages.done("classify")
    chosen, failure = choose_garment(matches, wanted, settings)
    if chosen is None or failure is not None:
        return failed(failure or Failure(FailureKind.UNKNOWN_GARMENT, "there is no template to compare with"))
    garment = next(g for g in garments if g.name == chosen.name)
    registration = register(contour, garment)
    cloth = _cloth_picture(picture, segmentation.mask, top)
    registration = refine_by_picture(registration, nominal[garment.name], contour, cloth)
    stages.done("register")

    if (failure := misfit(registration, garment, contour, settings)) is not None:
        return failed(failure)
    iou = polygon_iou(registration.contour, contour)
    fit = fit_quality(segmentation, iou, registration)
    sigmas = keypoint_sigmas(registration, nominal[garment.name], contour)
    confidence = probability_within(sigmas, settings.within * registration.scale)
    stages.notes |= {
        "iou": iou,
        "scale": chosen.scale,
        "fit": fit,
        "confidence": confidence,
        "boundary_rms_m": registration.residual,
        "updates": len(registration.history) - 1,
        "garment_height_m": top,
        "least_turn": registration.least_turn,
    }
    if fit < settings.min_fit:
        return failed(
            Failure(
                FailureKind.LOW_CONFIDENCE,
                f"the outline of {garment.name} fits only to {fit:.2f} of 1",
                "straighten the garment, or check light and the empty table's picture",
                {"fit": fit, "iou": iou, "boundary_rms_m": registration.residual},
            )
        )
    if confidence < settings.least_confidence:
        return failed(_ambiguous(garment.name, sigmas, confidence))
    state = GarmentState(
        garment.category, registration.contour, registration.keypoints, confidence, registration.ambiguous
    )
    value = Perception(
        state, garment.name, registration, segmentation, matches, view, frozen(seen.rgb), frozen(height), top, fit
    )
    return Outcome(value=value, notes=dict(stages.notes))


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


def _cloth_picture(picture: _Picture, mask: NDArray[np.bool_], top: float) -> ClothPicture:
    """The picture of a garment whose upper side is at the height `top` [m]."""
    view = picture.view

    def to_photo(points: Array) -> Array:
        return view.to_image(np.column_stack([points, np.full(len(points), top)]))

    return ClothPicture(
        picture.seen.rgb, mask, lambda points: view.at_height(points, top), picture.photo, to_photo
    )
