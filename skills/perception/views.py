"""Opens a picture: checks it, rectifies it, and puts the picture of the empty table beside it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from foldcell.skills.perception.camera_fault import camera_fault, depth_fault, table_unseen
from foldcell.skills.perception.rectification.heights import height_above
from foldcell.skills.perception.rectification.table_view import RectifiedView, TableView
from foldcell.skills.perception.segmentation.obstruction import obstructed
from foldcell.skills.perception.settings import VIEW_PIXEL, PerceptionSettings
from foldcell.skills.vocabulary import CameraCalibration, CameraFrame, Outcome, Table


@dataclass(frozen=True, eq=False)
class Views:
    """A picture of the table, in the pixels of `view`. seen: the rectified picture. empty: that of the empty
    table, or None. height: (H, W) above the table [m], NaN where unknown. photo: (rows, columns, 3) uint8, the
    picture as the camera took it."""

    view: TableView
    seen: RectifiedView
    empty: RectifiedView | None
    height: NDArray[np.float32]
    photo: NDArray[np.uint8]


def open_views(
    frame: CameraFrame,
    calibration: CameraCalibration,
    table: Table,
    reference: CameraFrame | None,
    previous: CameraFrame | None,
    settings: PerceptionSettings,
    arms_in_view: bool = False,
) -> Outcome[Views]:
    """Check and rectify a picture.

    reference: picture of the empty table. previous: an earlier picture, to detect a frozen camera. arms_in_view:
    whether the robot's own arms are over the table; the search for obstructions is then omitted.

    Fails with CAMERA_FAULT for an unusable picture, or with VIEW_OBSTRUCTED if something reaches into it.
    """
    if (fault := camera_fault(frame, calibration, previous, settings)) is not None:
        return Outcome(failure=fault)
    view = TableView(calibration, table, VIEW_PIXEL)
    if (unseen := table_unseen(view)) is not None:
        return Outcome(failure=unseen)
    seen = view.rectify(frame)
    empty = view.rectify(reference) if reference is not None else None
    pictures = [(frame, seen)] + ([(reference, empty)] if reference is not None and empty is not None else [])
    for taken, rectified in pictures:
        if (wrong := depth_fault(view, taken, rectified, settings.depth_holes)) is not None:
            return Outcome(failure=wrong)
    if not arms_in_view and (hidden := obstructed(view, seen, empty)) is not None:
        return Outcome(failure=hidden)
    return Outcome(Views(view, seen, empty, height_above(seen, empty), frame.rgb))
