"""Perceives the garment: computes its state on the table from one picture, or gives the reason why it cannot."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from robots.ports import Array, frozen
from skills.perception.classify import Match, classify, polygon_iou
from skills.perception.limb_poses import best_poses
from skills.perception.rectification.table_height import table_height
from skills.perception.rectification.table_view import RectifiedView, TableView
from skills.perception.registration.energy import segment_lengths
from skills.perception.registration.register import Registration, RegistrationSettings, register
from skills.perception.segmentation.mask import Segmentation, SegmentationSettings
from skills.perception.segmentation.obstruction import obstructed, obstruction_failure
from skills.perception.segmentation.photograph import propose_garments
from skills.perception.segmentation.segment import methods, segment
from skills.perception.template import GarmentOutline
from skills.vocabulary import (
    CameraCalibration,
    CameraFrame,
    Failure,
    FailureKind,
    GarmentState,
    Outcome,
    Table,
)

__all__ = [
    "Perception", "PerceptionSettings", "camera_fault", "garment_height", "perceive", "table_unseen",
    "touches_border",
]  # fmt: skip


_MAX_CONFIDENCE = 0.97
"""Confidence of a perfect fit: the measured share of such fits in which every key point is within 10 mm (`bench
perception`)."""


@dataclass(frozen=True)
class PerceptionSettings:
    """Thresholds of recognition. Lengths [m]; shares and overlaps 0..1.

    method: 'reference', 'plain', 'grabcut' or 'watershed' (the paper's). Without a picture of the empty table,
    'reference' means 'plain', if that finds no garment 'grabcut', and last the proposals of `propose_garments`.
    """

    pixel: float = 0.002
    method: str = "reference"
    segmentation: SegmentationSettings = field(default_factory=SegmentationSettings)
    registration: RegistrationSettings = field(default_factory=RegistrationSettings)
    lowest_segmentation: float = 0.5
    litter: float = 0.08
    """Maximum area of other objects on the table, relative to the area of the garment."""
    intruder: float = 0.02
    """Maximum area of objects that reach into the picture from its edge, relative to the area of the garment."""
    min_template_iou: float = 0.80
    """Minimum overlap of a silhouette with the best template; below it the garment is unknown."""
    polygon_iou: float = 0.91
    """Minimum overlap of a silhouette with the polygon of its key points."""
    proposed_polygon_iou: float = 0.86
    """The same for a proposal, whose limbs may be bent as well as swung."""
    sure: float = 0.8
    """A proposal with this confidence is accepted before the others are tried."""
    proportions: float = 0.20
    """Maximum difference from the template's proportions: standard deviation, over the outline's edges, of the
    logarithm of observed over template length."""
    least_turn: float = 0.35
    """Minimum turn of the outline at the place of a sharp corner, relative to the turn of this corner in the
    template."""
    category_margin: float = 0.03
    """The expected category is accepted unless another category has an overlap that is larger by more than
    this."""
    size_tolerance: float = 0.20
    """Maximum relative difference of the observed size from a garment's nominal size."""
    flat_height: float = 0.025
    """Maximum height of a flat garment (95th percentile over the garment)."""
    border: float = 0.006
    min_confidence: float = 0.6
    dark_level: float = 6.0
    white_level: float = 254.0
    depth_holes: float = 0.5


@dataclass(frozen=True, eq=False)
class Perception:
    """The garment's state for planning, with the intermediate results for the record and the overlay.

    garment: name of the garment whose template fits. rgb: (H, W, 3), height: (H, W) above the table [m], mask:
    (H, W), and the contour of `segmentation` are in `view`'s pixels. matches: all candidates, best first. top:
    mean height of the garment's upper side above the table [m].
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
    wanted = _wanted(garments, expected)
    stages = _StageTimes()

    camera_failure = camera_fault(frame, calibration, previous, settings)
    if camera_failure is None and reference is not None:
        camera_failure = camera_fault(reference, calibration, None, settings) or _same_picture(frame, reference)
    if camera_failure is not None:
        return Outcome(failure=camera_failure, notes=stages.notes)
    view = TableView(calibration, table, settings.pixel)
    if (unseen := table_unseen(view, settings)) is not None:
        return Outcome(failure=unseen, notes=stages.notes)
    seen = view.rectify(frame)
    empty = view.rectify(reference) if reference is not None else None
    if (hidden := obstructed(view, seen, empty)) is not None:
        return Outcome(failure=hidden, notes=stages.notes)
    picture = _Picture(view, seen, empty, height_above(seen, empty))
    stages.done("view")
    looks = _looks(picture, garments, wanted, settings, stages)
    decided = _best(looks, settings)
    if on_region is not None:
        on_region(view, decided.region.segmentation)
    return decided.outcome


@dataclass(frozen=True, eq=False)
class _Picture:
    """The input of the stages. seen: the rectified picture. empty: that of the empty table, or None. height:
    (H, W) above the table [m]."""

    view: TableView
    seen: RectifiedView
    empty: RectifiedView | None
    height: NDArray[np.float32]


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
    def confidence(self) -> float:
        return self.outcome.unwrap().state.confidence if self.outcome.ok else 0.0


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
    """Return the first accepted region of a method, or the most confident accepted proposal. If none is accepted,
    return the refusal of the region that came furthest."""
    accepted: list[_Look] = []
    refused: list[_Look] = []
    for look in looks:
        if not look.outcome.ok:
            refused.append(look)
        elif not look.region.proposed or look.confidence >= settings.sure:
            return look
        else:
            accepted.append(look)
    if accepted:
        return max(accepted, key=lambda look: look.confidence)
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
    failure = _unusable(segmentation, view, height, settings)
    if failure is not None:
        return failed(failure)

    top = garment_height(segmentation.mask, height)
    contour = view.to_table(segmentation.contour, top)
    if region.proposed:
        garments = best_poses(contour, garments)
        settings = replace(settings, polygon_iou=settings.proposed_polygon_iou)
    matches = classify(contour, garments)
    stages.done("classify")
    chosen, failure = _choose(matches, wanted, settings)
    if chosen is None or failure is not None:
        return failed(failure or Failure(FailureKind.UNKNOWN_GARMENT, "there is no template to compare with"))
    garment = next(g for g in garments if g.name == chosen.name)
    registration = register(contour, garment, settings.registration)
    stages.done("register")

    if (failure := _misfit(registration, garment, contour, settings)) is not None:
        return failed(failure)
    iou = polygon_iou(registration.contour, contour)
    confidence = _confidence(segmentation, iou, registration)
    stages.notes |= {
        "iou": iou,
        "scale": chosen.scale,
        "confidence": confidence,
        "boundary_rms_m": registration.residual,
        "updates": len(registration.history) - 1,
        "garment_height_m": top,
        "least_turn": registration.least_turn,
    }
    if confidence < settings.min_confidence:
        return failed(
            Failure(
                FailureKind.LOW_CONFIDENCE,
                f"the outline of {garment.name} fits only with confidence {confidence:.2f}",
                "straighten the garment, or check light and the empty table's picture",
                {"confidence": confidence, "iou": iou, "boundary_rms_m": registration.residual},
            )
        )
    state = GarmentState(
        garment.category, registration.contour, registration.keypoints, confidence, registration.ambiguous
    )
    value = Perception(
        state, garment.name, registration, segmentation, matches, view, frozen(seen.rgb), frozen(height), top
    )
    return Outcome(value=value, notes=dict(stages.notes))


def camera_fault(
    frame: CameraFrame,
    calibration: CameraCalibration,
    previous: CameraFrame | None = None,
    settings: PerceptionSettings | None = None,
) -> Failure | None:
    """Return CAMERA_FAULT for a picture that has the wrong size, is black, is white, has no depth or equals
    `previous`; else None."""
    settings = settings or PerceptionSettings()
    expected_shape = (calibration.intrinsics.height, calibration.intrinsics.width)
    hint = "check the camera's cable, exposure and driver, then look again"
    if frame.rgb.shape != (*expected_shape, 3) or frame.depth.shape != expected_shape:
        return Failure(
            FailureKind.CAMERA_FAULT,
            f"the camera is calibrated for {expected_shape[1]} x {expected_shape[0]} pixels, the picture has "
            f"{frame.rgb.shape[1]} x {frame.rgb.shape[0]}, its depth {frame.depth.shape[1]} x "
            f"{frame.depth.shape[0]}",
            "set the camera's resolution back, or calibrate it anew",
        )
    level = float(frame.rgb[::4, ::4].mean())
    if level < settings.dark_level:
        return Failure(FailureKind.CAMERA_FAULT, "the picture is black", hint, {"mean_level": level})
    if level > settings.white_level:
        return Failure(FailureKind.CAMERA_FAULT, "the picture is white", hint, {"mean_level": level})
    holes = float(np.mean(~np.isfinite(frame.depth)))
    if holes > settings.depth_holes:
        return Failure(
            FailureKind.CAMERA_FAULT, f"{holes:.0%} of the depth is missing", hint, {"depth_holes": holes}
        )
    if previous is not None and _frozen_camera(frame, previous):
        return Failure(
            FailureKind.CAMERA_FAULT,
            "the camera repeats its last picture",
            hint,
            {"sequence": frame.sequence, "stamp_s": frame.stamp},
        )
    return None


def table_unseen(view: TableView, settings: PerceptionSettings | None = None) -> Failure | None:
    """Return CAMERA_FAULT when the visible area of the table is smaller than a garment, else None."""
    settings = settings or PerceptionSettings()
    if np.count_nonzero(view.valid) >= settings.segmentation.smallest_area:
        return None
    return Failure(
        FailureKind.CAMERA_FAULT,
        "by its calibration the camera does not look at the table",
        "calibrate its pose (calibrate hand-eye), or correct the table's place in cell.yaml",
        {"seen_m2": float(np.count_nonzero(view.valid)) * view.pixel**2},
    )


def _same_picture(frame: CameraFrame, reference: CameraFrame) -> Failure | None:
    """Return CAMERA_FAULT if the picture equals that of the empty table, else None. Real pictures differ by
    noise."""
    if not np.array_equal(frame.rgb, reference.rgb):
        return None
    return Failure(
        FailureKind.CAMERA_FAULT, "the picture is identical to that of the empty table",
        "the camera is frozen, or one file was given twice: take a new picture",
    )  # fmt: skip


def _frozen_camera(frame: CameraFrame, previous: CameraFrame) -> bool:
    """Whether the camera repeats a picture; noise makes pictures of a still scene differ."""
    if frame is previous or frame.stamp == previous.stamp:
        return False
    return frame.sequence == previous.sequence or (
        np.array_equal(frame.rgb, previous.rgb) and np.array_equal(frame.depth, previous.depth, equal_nan=True)
    )


def height_above(seen: RectifiedView, empty: RectifiedView | None) -> NDArray[np.float32]:
    """Compute the height (H, W) above the measured empty table [m], which cancels the calibration's error."""
    if empty is None:
        return seen.height
    return np.asarray(seen.height - table_height(empty.height), dtype=np.float32)


def touches_border(mask: NDArray[np.bool_], valid: NDArray[np.bool_], margin: int) -> bool:
    """Whether a region comes within `margin` pixels of the border of the valid view."""
    size = 2 * margin + 1
    inner = cv2.erode(valid.astype(np.uint8), np.ones((size, size), np.uint8), borderValue=0) > 0
    return bool((mask & ~inner).any())


def _wanted(garments: Sequence[GarmentOutline], expected: str | None) -> GarmentOutline | None:
    if expected is None:
        return None
    for garment in garments:
        if garment.name == expected:
            return garment
    raise ValueError(f"{expected!r} is none of {[g.name for g in garments]}")


def _unusable(
    segmentation: Segmentation, view: TableView, height: NDArray[np.float32], settings: PerceptionSettings
) -> Failure | None:
    if not segmentation.found:
        return Failure(
            FailureKind.NO_GARMENT, "no garment is visible on the table", "lay one flat in the camera's view"
        )
    margin = max(round(settings.border / view.pixel), 1)
    if (failure := _not_alone(segmentation, view, margin, settings)) is not None:
        return failure
    if segmentation.confidence < settings.lowest_segmentation:
        return Failure(
            FailureKind.LOW_CONFIDENCE,
            f"only {segmentation.confidence:.0%} of the garment's boundary is clearly visible",
            "the fabric has the table's colour, or the light changed: take a new picture of the empty table",
            {"segmentation_confidence": segmentation.confidence},
        )
    if touches_border(segmentation.mask, view.valid, margin):
        return Failure(
            FailureKind.OUT_OF_VIEW,
            "the garment extends beyond the camera's view or the table's edge",
            "lay it nearer to the middle of the table",
        )
    top = _upper_height(segmentation.mask, height)
    if top > settings.flat_height:
        return Failure(
            FailureKind.NOT_FLAT,
            f"the garment reaches {top * 1e3:.0f} mm above the table",
            "spread it flat",
            {"height_m": top},
        )
    return None


def _not_alone(
    segmentation: Segmentation, view: TableView, margin: int, settings: PerceptionSettings
) -> Failure | None:
    """Return UNKNOWN_GARMENT for a second garment, VIEW_OBSTRUCTED for something flat that reaches into the
    picture, else None."""
    share = np.count_nonzero(segmentation.others) / np.count_nonzero(segmentation.mask)
    values = {"other_area_share": float(share)}
    if share > settings.intruder and touches_border(segmentation.others, view.valid, margin):
        return obstruction_failure(view, segmentation.others, "something flat", values)
    if share <= settings.litter:
        return None
    return Failure(
        FailureKind.UNKNOWN_GARMENT, "more than one thing lies on the table",
        "leave a single garment on the table", values,
    )  # fmt: skip


def _upper_height(mask: NDArray[np.bool_], height: NDArray[np.float32]) -> float:
    """95th percentile of the smoothed height within a mask [m]; 0 without depth."""
    smooth = smooth_height(height)
    samples = smooth[mask & np.isfinite(smooth)]
    return float(np.quantile(samples, 0.95)) if len(samples) > 100 else 0.0


def garment_height(mask: NDArray[np.bool_], height: NDArray[np.float32]) -> float:
    """Mean height of a garment above the table, limited to 0..0.02 [m]; 0 without depth. Its outline is assumed to
    lie at this height."""
    samples = height[mask & np.isfinite(height)]
    return float(np.clip(samples.mean(dtype=float), 0.0, 0.02)) if len(samples) > 1000 else 0.0


def smooth_height(height: NDArray[np.float32], size: int = 9) -> NDArray[np.float32]:
    """Average the height over the known part of a square of `size` pixels around each pixel [m]; NaN where too
    little is known."""
    known = np.isfinite(height)
    total = cv2.boxFilter(np.where(known, height, np.float32(0.0)), -1, (size, size))
    share = cv2.boxFilter(known.astype(np.float32), -1, (size, size))
    return np.where(share > 0.25, total / np.maximum(share, 1e-6), np.float32(np.nan)).astype(np.float32)


def _choose(
    matches: tuple[Match, ...], wanted: GarmentOutline | None, settings: PerceptionSettings
) -> tuple[Match | None, Failure | None]:
    if not matches:
        return None, None
    best = max(matches, key=lambda m: m.iou)
    values = {"best": best.name, "best_iou": best.iou, "scale": best.scale}
    if best.iou < settings.min_template_iou:
        return None, Failure(
            FailureKind.UNKNOWN_GARMENT,
            f"the silhouette matches no known garment (nearest {best.name}, overlap {best.iou:.2f})",
            "spread the garment flat, or make a template with `foldcell garment new`",
            values,
        )
    if wanted is None:
        return _match_of_size(matches, best, settings)
    match = next(m for m in matches if m.name == wanted.name)
    if best.category != wanted.category and match.iou < best.iou - settings.category_margin:
        return None, Failure(
            FailureKind.CATEGORY_MISMATCH,
            f"expected {wanted.name}, but the silhouette is of category {best.category}",
            "put the expected garment on the table, or name the right one",
            {**values, "expected": wanted.name, "expected_iou": match.iou},
        )
    if not _fits_in_size(match, settings):
        return None, Failure(
            FailureKind.CATEGORY_MISMATCH,
            f"expected {wanted.name}, but the garment is {match.scale:.2f} times its size",
            "put the expected garment on the table, or name the right one",
            {**values, "expected": wanted.name, "scale": match.scale},
        )
    return match, None


def _match_of_size(
    matches: tuple[Match, ...], best: Match, settings: PerceptionSettings
) -> tuple[Match | None, Failure | None]:
    """Return the first match whose size fits, among those whose IoU is within `category_margin` of the best;
    otherwise a failure.

    `_choose` applies the same size limit to an expected garment. Therefore a garment chosen here is not refused
    for its size by a later perception that expects it.
    """
    near = [m for m in matches if m.iou >= best.iou - settings.category_margin]
    for match in near:
        if _fits_in_size(match, settings):
            return match, None
    nearest = near[0]
    return None, Failure(
        FailureKind.UNKNOWN_GARMENT,
        f"no known garment has this shape and size (nearest {nearest.name}, "
        f"but {nearest.scale:.2f} times its size)",
        "put a known garment on the table, or make a template with `foldcell garment new`",
        {"best": nearest.name, "best_iou": nearest.iou, "scale": nearest.scale},
    )


def _fits_in_size(match: Match, settings: PerceptionSettings) -> bool:
    return bool(abs(np.log(match.scale)) <= np.log1p(settings.size_tolerance))


def _misfit(
    registration: Registration, garment: GarmentOutline, contour: Array, settings: PerceptionSettings
) -> Failure | None:
    """Return UNKNOWN_GARMENT or LOW_CONFIDENCE when the key points do not fit the garment, else None.

    The registered contour bends freely and follows any silhouette, but the polygon of its key points does not.
    This polygon is therefore compared with the silhouette. LOW_CONFIDENCE: a key point that should be a sharp
    corner lies where the outline has none.
    """
    polygon = np.array([registration.keypoints[name] for name in garment.keypoints])
    overlap = polygon_iou(polygon, contour)
    ratio = np.log(segment_lengths(polygon) / segment_lengths(np.asarray(garment.template, dtype=float)))
    distortion = float(ratio.std())
    if overlap >= settings.polygon_iou and distortion <= settings.proportions:
        if registration.least_turn >= settings.least_turn:
            return None
        return Failure(
            FailureKind.LOW_CONFIDENCE,
            f"the outline has no corner where one of {garment.name} should be",
            "straighten the garment, especially its ends, or make a template with `foldcell garment new`",
            {"least_turn": registration.least_turn},
        )
    return Failure(
        FailureKind.UNKNOWN_GARMENT,
        f"the silhouette is not that of {garment.name} (polygon of the key points overlaps by {overlap:.2f}, "
        f"proportions differ by {distortion:.0%})",
        "spread the garment flat, or make a template with `foldcell garment new`",
        {"polygon_iou": overlap, "distortion": distortion},
    )


def _confidence(segmentation: Segmentation, iou: float, registration: Registration) -> float:
    """Compute the confidence: `_MAX_CONFIDENCE` times three factors, which are the confidence of the segmentation,
    the overlap with the template (0.85..0.97 -> 0..1) and the residual of the registration (8..2 mm -> 0..1)."""
    overlap = float(np.clip((iou - 0.85) / 0.12, 0.0, 1.0))
    fit = float(np.clip((0.008 - registration.residual) / 0.006, 0.0, 1.0))
    return _MAX_CONFIDENCE * segmentation.confidence * overlap * fit
