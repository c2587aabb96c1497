"""Inspects a fold: compares the garment on the table with the simulation's prediction."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
from numpy.typing import NDArray

from robots.ports import frozen
from skills.perception.inspection.diagnosis import diagnose
from skills.perception.inspection.fold_heights import (
    extra_height,
    judged_area,
    missing_layer,
    piled_area,
    upper_height,
)
from skills.perception.inspection.left_behind import left_behind
from skills.perception.inspection.moved_edge import MovedEdge, moved_edge
from skills.perception.inspection.predicted_view import draw_shape, move_view, outline_of
from skills.perception.inspection.repeated_look import averaged_height
from skills.perception.inspection.result import Inspection, InspectionSettings
from skills.perception.inspection.target_view import FoldTarget, view_target
from skills.perception.monitoring.silhouette import find_silhouette
from skills.perception.rectification.heights import height_above, smooth_height
from skills.perception.rectification.table_view import TableView
from skills.perception.registration.alignment import align, edge_deviation
from skills.perception.segmentation.mask import Segmentation
from skills.perception.settings import PerceptionSettings
from skills.perception.views import open_views
from skills.vocabulary import (
    CameraCalibration,
    CameraFrame,
    Failure,
    FailureKind,
    FoldStep,
    Outcome,
    PredictedShape,
    Table,
)

__all__ = ["Inspection", "InspectionSettings", "inspect"]

APART = 0.04
"""What lies nearer than this to the garment or its prediction may be a part of the garment [m]."""


def inspect(
    frame: CameraFrame,
    calibration: CameraCalibration,
    table: Table,
    reference: CameraFrame | None,
    predicted: PredictedShape,
    step: FoldStep | None = None,
    settings: InspectionSettings | None = None,
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

    Failures: CAMERA_FAULT, VIEW_OBSTRUCTED, NO_GARMENT, OUT_OF_VIEW or UNKNOWN_GARMENT (a second garment) if
    nothing can be judged. A bad fold is not a failure: the value's `diagnosis` describes it.
    """
    settings = settings or InspectionSettings()
    opened = open_views(frame, calibration, table, reference, previous, settings.perception)
    if opened.failure is not None:
        return Outcome(failure=opened.failure)
    views = opened.unwrap()
    silhouette = find_silhouette(views, settings.perception)
    if silhouette.failure is not None:
        return Outcome(failure=silhouette.failure)
    view, seen, empty, height = views.view, views.seen, views.empty, views.height
    found = silhouette.unwrap()
    if earlier is not None:
        height = averaged_height(height, found.mask, earlier)
    expected = draw_shape(view, predicted)
    raised = 0.0 if flat_top is None else max(flat_top - float(predicted.vertices[:, 2].min()), 0.0)
    expected += np.float32(raised)
    figures = _Figures(view, found, height, expected, step, settings, raised)
    if (second := _second_garment(found, expected, view, settings.perception)) is not None:
        return Outcome(failure=second)
    edge = None
    before = before or previous
    if step is not None and len(step.grasps) == 2 and before is not None:
        height_before = height_above(view.rectify(before), empty)
        flat = None if target is None else target.shape
        edge = moved_edge(height, height_before, predicted, step, view, figures.R, figures.t, flat=flat)
    inspection = figures.inspection(seen.rgb, edge)
    if target is not None:
        compared = view_target(
            view, found.mask, inspection.contour, height, predicted, target, settings.fold_margin
        )
        inspection = replace(inspection, target=compared)
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


def _second_garment(
    found: Segmentation, expected: NDArray[np.float32], view: TableView, settings: PerceptionSettings
) -> Failure | None:
    """Return UNKNOWN_GARMENT if something lies on the table well outside the predicted outline, else None.
    expected: (H, W) predicted height [m], NaN outside."""
    size = 2 * round(APART / view.pixel) + 1
    near = cv2.dilate((np.isfinite(expected) | found.mask).astype(np.uint8), np.ones((size, size), np.uint8)) > 0
    share = np.count_nonzero(found.others & ~near) / np.count_nonzero(found.mask)
    if share <= settings.litter:
        return None
    return Failure(
        FailureKind.UNKNOWN_GARMENT, "something else lies on the table beside the garment",
        "leave a single garment on the table", {"other_area_share": float(share)},
    )  # fmt: skip


class _Figures:
    """Computes the figures of one comparison. found: the segmentation in `view`. expected: (H, W) predicted
    height [m]. raised: height by which it was raised above the mesh [m].

    R (2, 2), t (2,) [m]: the rigid motion that aligns the prediction with the observation.
    """

    def __init__(
        self,
        view: TableView,
        found: Segmentation,
        height: NDArray[np.float32],
        expected: NDArray[np.float32],
        step: FoldStep | None,
        settings: InspectionSettings,
        raised: float,
    ) -> None:
        self._view, self._found, self._height, self._expected = view, found, height, expected
        self._step, self._settings, self._raised = step, settings, raised
        self._outline = outline_of(view, np.isfinite(expected))
        self._observed = view.to_table(found.contour)
        self.R, self.t = align(self._outline, self._observed)

    def inspection(self, rgb: NDArray[np.uint8], edge: MovedEdge | None) -> Inspection:
        """Compute all figures, without a diagnosis. edge: the moved edge, or None."""
        view, mask, step, settings = self._view, self._found.mask, self._step, self._settings
        where = np.isfinite(self._expected)
        moved = move_view(view, self._expected, self.R, self.t)
        centre = self._outline.mean(axis=0)
        drift = self.R @ centre + self.t - centre
        smooth = smooth_height(self._height, 7)
        excess = smooth - moved
        judged = judged_area(mask, view, step, settings)
        deviation, place = edge_deviation(self._outline @ self.R.T + self.t, self._observed)
        return Inspection(
            iou=_iou(mask, where),
            iou_aligned=_iou(mask, np.isfinite(moved)),
            drift=frozen(drift),
            drift_about=frozen(centre),
            drift_m=float(np.linalg.norm(drift)),
            drift_rad=float(np.arctan2(self.R[1, 0], self.R[0, 0])),
            height_m=upper_height(smooth, judged),
            extra_height_m=extra_height(excess, judged),
            piled_area_m2=piled_area(excess, judged, settings.extra_height, view.pixel),
            edge_deviation_m=deviation,
            edge_place=frozen(place),
            missing_layer=missing_layer(self._height, moved, view, step, self.R, self.t, settings, self._raised),
            edge=edge,
            left_behind=left_behind(view, mask, where, step, settings),
            diagnosis=None,
            confidence=1.0,
            contour=frozen(self._observed),
            mask=frozen(mask),
            predicted=frozen(where),
            height=frozen(self._height),
            view=view,
            rgb=frozen(rgb),
        )


def _iou(a: NDArray[np.bool_], b: NDArray[np.bool_]) -> float:
    union = np.count_nonzero(a | b)
    return float(np.count_nonzero(a & b) / union) if union else 0.0
