"""Inspects a fold: compares the garment on the table with the simulation's prediction."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
from numpy.typing import NDArray

from foldcell.robots.ports import frozen
from foldcell.skills.perception.inspection.diagnosis import diagnose
from foldcell.skills.perception.inspection.figures import (
    extra_height,
    judged_area,
    left_behind,
    missing_layer,
    piled_area,
    upper_height,
)
from foldcell.skills.perception.inspection.moved_edge import moved_edge
from foldcell.skills.perception.inspection.predicted_view import draw_shape, mask_iou, move_view, outline_of
from foldcell.skills.perception.inspection.result import FOLD_MARGIN, Inspection, InspectionSettings
from foldcell.skills.perception.inspection.target_view import FoldTarget, view_target
from foldcell.skills.perception.rectification.heights import height_above, smooth_height
from foldcell.skills.perception.rectification.table_view import TableView
from foldcell.skills.perception.registration.alignment import align, edge_deviation
from foldcell.skills.perception.segmentation.mask import Segmentation
from foldcell.skills.perception.settings import LITTER_SHARE
from foldcell.skills.perception.silhouette import find_silhouette
from foldcell.skills.perception.views import open_views
from foldcell.skills.vocabulary import (
    CameraCalibration,
    CameraFrame,
    Failure,
    FailureKind,
    FoldStep,
    Outcome,
    PredictedShape,
    Table,
    refuse,
    skill,
)

APART = 0.04
"""An object nearer than this to the garment or to its prediction may be a part of the garment [m]."""
STILL_IOU = 0.97
"""Least overlap of the silhouettes in two looks at a garment that lies still."""
STILL_M, NEARLY_ALL = 0.002, 0.99
"""Largest difference between the smoothed heights of such a garment in two looks, on nearly all of its inner part
[m]. In pictures of a garment at rest the difference was 0.7 to 0.8 mm. After the garment had been pressed, it was
6.6 mm."""
UNKNOWN = 0.15
"""Largest share of the garment whose height may be unknown in a picture by which a fold is judged. In pictures
without a fault it is 0.005 to 0.06. A hole over a third of the moved edge made a sag of what was seen beside
it."""
RIM = 5
"""Width of the outer part, where the smoothed heights of cloth and table mix [pixels]."""


@skill
def inspect(
    frame: CameraFrame,
    calibration: CameraCalibration,
    table: Table,
    reference: CameraFrame | None,
    predicted: PredictedShape,
    step: FoldStep | None = None,
    *,
    settings: InspectionSettings,
    previous: CameraFrame | None = None,
    flat_top: float | None = None,
    before: CameraFrame | None = None,
    target: FoldTarget | None = None,
    earlier: Inspection | None = None,
) -> Outcome[Inspection]:
    """Compare one picture with the predicted mesh and diagnose the fold.

    predicted: the predicted mesh. step: the fold that was made, with its targets and lines; without it only
    silhouette and height are judged. reference: picture of the empty table. previous: the last picture, to detect
    a frozen camera. before: the picture before the fold (previous if None), to detect the cloth that the fold laid
    on top. flat_top: mean height of the flat garment as the camera saw it, `Perception.top` [m]. Creases and pile
    make it higher than the mesh's middle surface; the prediction is raised by the difference. target: the perfect
    fold, with which the observation is compared as well. earlier: an inspection of the same garment at rest;
    heights are averaged over both looks.

    Failures: CAMERA_FAULT (also if the height of too much of the garment is unknown), VIEW_OBSTRUCTED, NO_GARMENT,
    OUT_OF_VIEW or UNKNOWN_GARMENT (a second garment) if nothing can be judged. A bad fold is not a failure: the
    value's `diagnosis` describes it.
    """
    views = open_views(frame, calibration, table, reference, previous, settings.perception).unwrap()
    found = find_silhouette(views, settings.perception).unwrap()
    view, seen, empty, height = views.view, views.seen, views.empty, views.height
    if earlier is not None:
        height = averaged_height(height, found.mask, earlier)
    expected = draw_shape(view, predicted)
    raised = 0.0 if flat_top is None else max(flat_top - float(predicted.vertices[:, 2].min()), 0.0)
    expected += np.float32(raised)
    planned = np.isfinite(expected)
    outline, observed = outline_of(view, planned), view.to_table(found.contour)
    R, t = align(outline, observed)
    refuse(_second_garment(found, planned, view))
    if step is not None:
        refuse(_height_unknown(found.mask, height))
    edge = None
    before = before or previous
    if step is not None and len(step.grasps) == 2 and before is not None:
        height_before = height_above(view.rectify(before), empty)
        flat = None if target is None else target.shape
        edge = moved_edge(height, height_before, predicted, step, view, R, t, flat)
    moved, centre = move_view(view, expected, R, t), outline.mean(axis=0)
    drift = R @ centre + t - centre
    smooth, judged = smooth_height(height, 7), judged_area(found.mask, view, step)
    excess = smooth - moved
    deviation, place = edge_deviation(outline @ R.T + t, observed)
    margin = FOLD_MARGIN
    inspection = Inspection(
        iou=mask_iou(found.mask, planned),
        iou_aligned=mask_iou(found.mask, np.isfinite(moved)),
        drift=frozen(drift),
        drift_about=frozen(centre),
        drift_m=float(np.linalg.norm(drift)),
        drift_rad=float(np.arctan2(R[1, 0], R[0, 0])),
        height_m=upper_height(smooth, judged),
        extra_height_m=extra_height(excess, judged),
        piled_area_m2=piled_area(excess, judged, settings.extra_height, view.pixel),
        edge_deviation_m=deviation,
        edge_place=frozen(place),
        missing_layer=missing_layer(height, moved, view, step, R, t, raised),
        edge=edge,
        left_behind=left_behind(view, found.mask, planned, step),
        diagnosis=None,
        confidence=1.0,
        contour=frozen(observed),
        mask=frozen(found.mask),
        predicted=frozen(planned),
        height=frozen(height),
        view=view,
        rgb=frozen(seen.rgb),
        target=None
        if target is None
        else view_target(view, found.mask, observed, height, predicted, target, margin),
    )
    kind, confidence = diagnose(inspection, step, settings)
    inspection = replace(inspection, diagnosis=kind, confidence=confidence)
    notes: dict[str, float | int | str] = {
        "iou": inspection.iou,
        "iou_aligned": inspection.iou_aligned,
        "drift_m": inspection.drift_m,
        "drift_rad": inspection.drift_rad,
        "height_m": inspection.height_m,
        "extra_height_m": inspection.extra_height_m,
        "edge_deviation_m": inspection.edge_deviation_m,
        "segmentation_confidence": found.confidence,
    }
    return Outcome(value=inspection, notes=notes)


def _second_garment(found: Segmentation, planned: NDArray[np.bool_], view: TableView) -> Failure | None:
    """Return UNKNOWN_GARMENT if something lies on the table well outside the predicted silhouette, `planned`
    (H, W), else None."""
    size = 2 * round(APART / view.pixel) + 1
    near = cv2.dilate((planned | found.mask).astype(np.uint8), np.ones((size, size), np.uint8)) > 0
    share = np.count_nonzero(found.others & ~near) / np.count_nonzero(found.mask)
    if share <= LITTER_SHARE:
        return None
    return Failure(
        FailureKind.UNKNOWN_GARMENT, "something else lies on the table beside the garment",
        "leave a single garment on the table", {"other_area_share": float(share)},
    )  # fmt: skip


def _height_unknown(mask: NDArray[np.bool_], height: NDArray[np.float32]) -> Failure | None:
    """Return CAMERA_FAULT if the height (H, W) of too much of the garment (mask, (H, W)) is unknown, else None."""
    share = float(np.mean(~np.isfinite(height[mask])))
    if share <= UNKNOWN:
        return None
    return Failure(
        FailureKind.CAMERA_FAULT, f"the camera gives no depth for {share:.0%} of the garment",
        "keep sunlight and mirrors off the garment, or restart the camera", {"depth_holes": share},
    )  # fmt: skip


def averaged_height(
    height: NDArray[np.float32], mask: NDArray[np.bool_], earlier: Inspection
) -> NDArray[np.float32]:
    """Return the mean of the height (H, W) and that of an earlier look [m], where both are known. If the garment
    (mask, (H, W)) now lies elsewhere or differently, return the height itself. A second look at a garment at rest
    thus has less noise than the first."""
    if earlier.mask.shape != mask.shape:
        return height
    if mask_iou(mask, earlier.mask) < STILL_IOU:
        return height
    inner = cv2.erode((mask & earlier.mask).astype(np.uint8), np.ones((2 * RIM + 1,) * 2)) > 0
    difference = np.abs(smooth_height(height) - smooth_height(earlier.height))[inner]
    difference = difference[np.isfinite(difference)]
    if not len(difference) or np.quantile(difference, NEARLY_ALL) > STILL_M:
        return height
    both = np.isfinite(height) & np.isfinite(earlier.height)
    return np.where(both, 0.5 * (height + earlier.height), height).astype(np.float32)
