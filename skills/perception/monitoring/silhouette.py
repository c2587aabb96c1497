"""Finds the garment's silhouette in a picture, without recognising it: after a fold, and before the hands go
down."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from skills.perception.camera_fault import camera_fault, table_unseen
from skills.perception.garment_height import height_above
from skills.perception.rectification.table_view import RectifiedView, TableView
from skills.perception.segmentation.mask import Segmentation
from skills.perception.segmentation.obstruction import obstructed, obstruction_failure
from skills.perception.segmentation.segment import methods, segment
from skills.perception.settings import PerceptionSettings
from skills.perception.usable_region import touches_border
from skills.vocabulary import CameraCalibration, CameraFrame, Failure, FailureKind, Outcome, Table

__all__ = ["Silhouette", "Views", "find_silhouette", "open_views"]

_MARGIN = 2
"""A garment nearer than this to the border of the view is out of view [px]."""


class Views:
    """A rectified picture with that of the empty table. height: (H, W) above the table [m], NaN where unknown."""

    def __init__(self, view: TableView, seen: RectifiedView, empty: RectifiedView | None) -> None:
        self.view, self.seen, self.empty = view, seen, empty
        self.height: NDArray[np.float32] = height_above(seen, empty)


Silhouette = Segmentation
"""The garment's silhouette, in the pixels of a view."""


def open_views(
    frame: CameraFrame,
    calibration: CameraCalibration,
    table: Table,
    reference: CameraFrame | None,
    previous: CameraFrame | None,
    settings: PerceptionSettings,
    arms_in_view: bool = False,
) -> Outcome[Views]:
    """Rectify a picture. previous: an earlier picture, to detect a frozen camera. arms_in_view: whether the
    robot's own arms are over the table, so that something reaches into the picture in any case.

    Fails with CAMERA_FAULT for an unusable picture, or with VIEW_OBSTRUCTED if something reaches into it.
    """
    fault = camera_fault(frame, calibration, previous, settings)
    if fault is not None:
        return Outcome(failure=fault)
    view = TableView(calibration, table, settings.pixel)
    if (unseen := table_unseen(view, settings)) is not None:
        return Outcome(failure=unseen)
    seen = view.rectify(frame)
    empty = view.rectify(reference) if reference is not None else None
    hidden = None if arms_in_view else obstructed(view, seen, empty)
    return Outcome(failure=hidden) if hidden is not None else Outcome(Views(view, seen, empty))


def find_silhouette(views: Views, settings: PerceptionSettings) -> Outcome[Silhouette]:
    """Segment the garment. The result is that of the first method with sufficient confidence, else that of the
    first method that finds a garment.

    Failures: NO_GARMENT, OUT_OF_VIEW, VIEW_OBSTRUCTED (something flat reaches into the picture, beside the
    garment).
    """
    seen, empty = views.seen, views.empty
    bare = empty.rgb if empty is not None else None
    uncertain: list[Segmentation] = []
    out_of_view = False
    for method in methods(settings.method, empty is not None):
        found = segment(method, seen.rgb, bare, seen.valid, views.height, settings.segmentation)
        if not found.found:
            continue
        if touches_border(found.mask, seen.valid, _MARGIN):
            out_of_view = True
        elif found.confidence >= settings.lowest_segmentation:
            return _alone(views.view, found, settings)
        else:
            uncertain.append(found)
    if uncertain:
        return _alone(views.view, uncertain[0], settings)
    if out_of_view:
        what, hint = "the garment reaches beyond the view", "move it to the middle of the table by hand"
        return Outcome(failure=Failure(FailureKind.OUT_OF_VIEW, what, hint))
    what, hint = "the garment is no longer visible on the table", "lay it back as it was"
    return Outcome(failure=Failure(FailureKind.NO_GARMENT, what, hint))


def _alone(view: TableView, found: Segmentation, settings: PerceptionSettings) -> Outcome[Silhouette]:
    """Return the silhouette, or VIEW_OBSTRUCTED if something else touches the border of the view."""
    share = np.count_nonzero(found.others) / np.count_nonzero(found.mask)
    if share > settings.intruder and touches_border(found.others, view.valid, _MARGIN):
        values = {"other_area_share": float(share)}
        return Outcome(failure=obstruction_failure(view, found.others, "something flat", values))
    return Outcome(found)
