"""Inspects a fold: compares the garment on the table with the simulation's prediction."""

from __future__ import annotations

from dataclasses import replace

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
from skills.perception.inspection.result import Inspection, InspectionSettings
from skills.perception.inspection.target_view import FoldTarget, view_target
from skills.perception.perceive import (
    PerceptionSettings,
    camera_fault,
    height_above,
    smooth_height,
    table_unseen,
    touches_border,
)
from skills.perception.rectification.table_view import RectifiedView, TableView
from skills.perception.registration.alignment import align, edge_deviation
from skills.perception.segmentation.mask import Segmentation
from skills.perception.segmentation.segment import methods, segment
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
) -> Outcome[Inspection]:
    """Compare one picture with the predicted mesh and diagnose the fold.

    predicted: the predicted mesh. step: the fold that was made, with its targets and lines; without it only
    silhouette and height are judged. reference: picture of the empty table. previous: the last picture, to detect
    a frozen camera. before: the picture before the fold (previous if None), to detect the cloth that the fold laid
    on top. flat_top: mean height of the flat garment as the camera saw it, `Perception.top` [m]. Creases and pile
    make it higher than the mesh's middle surface; the prediction is raised by the difference. target: the perfect
    fold, with which the observation is compared as well.

    Failures: CAMERA_FAULT, NO_GARMENT or OUT_OF_VIEW if nothing can be judged. A bad fold is not a failure: the
    value's `diagnosis` describes it.
    """
    settings = settings or InspectionSettings()
    fault = camera_fault(frame, calibration, previous, settings.perception)
    if fault is not None:
        return Outcome(failure=fault)
    view = TableView(calibration, table, settings.perception.pixel)
    if (unseen := table_unseen(view, settings.perception)) is not None:
        return Outcome(failure=unseen)
    seen = view.rectify(frame)
    empty = view.rectify(reference) if reference is not None else None
    height = height_above(seen, empty)
    segmented = _segmented(seen, empty, height, settings.perception)
    if segmented.failure is not None:
        return Outcome(failure=segmented.failure)
    found = segmented.unwrap()
    expected = draw_shape(view, predicted)
    if flat_top is not None:
        expected += np.float32(max(flat_top - float(predicted.vertices[:, 2].min()), 0.0))
    figures = _Figures(view, found, height, expected, step, settings)
    edge = None
    before = before or previous
    if step is not None and len(step.grasps) == 2 and before is not None:
        height_before = height_above(view.rectify(before), empty)
        edge = moved_edge(height, height_before, predicted, step, view, figures.R, figures.t)
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


def _segmented(
    seen: RectifiedView, empty: RectifiedView | None, height: NDArray[np.float32], settings: PerceptionSettings
) -> Outcome[Segmentation]:
    """Segment the garment. The result is that of the first method with sufficient confidence, else that of the
    first method that finds a garment.

    seen, empty: the rectified picture, and that of the empty table (or None). height: (H, W) above the table [m].
    """
    bare = empty.rgb if empty is not None else None
    uncertain: list[Segmentation] = []
    out_of_view = False
    for method in methods(settings.method, empty is not None):
        found = segment(method, seen.rgb, bare, seen.valid, height, settings.segmentation)
        if not found.found:
            continue
        if touches_border(found.mask, seen.valid, 2):
            out_of_view = True
        elif found.confidence >= settings.lowest_segmentation:
            return Outcome(value=found)
        else:
            uncertain.append(found)
    if uncertain:
        return Outcome(value=uncertain[0])
    if out_of_view:
        return Outcome(
            failure=Failure(FailureKind.OUT_OF_VIEW, "the garment reaches beyond the view", "move it by hand")
        )
    return Outcome(failure=Failure(FailureKind.NO_GARMENT, "the garment is no longer visible on the table"))


class _Figures:
    """Computes the figures of one comparison. found: the segmentation in `view`. expected: (H, W) predicted
    height [m].

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
    ) -> None:
        self._view, self._found, self._height, self._expected = view, found, height, expected
        self._step, self._settings = step, settings
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
            missing_layer=missing_layer(self._height, moved, view, step, self.R, self.t, settings),
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
