"""The garment in one picture, reduced to what is compared with the hypotheses: its silhouette and its heights."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from foldcell.robots.ports import Array, frozen
from foldcell.skills.perception.rectification.table_view import TableView
from foldcell.skills.perception.settings import PerceptionSettings
from foldcell.skills.perception.silhouette import find_silhouette
from foldcell.skills.perception.views import open_views
from foldcell.skills.vocabulary import CameraCalibration, CameraFrame, Outcome, Table, skill


@dataclass(frozen=True, eq=False)
class Observation:
    """mask: (H, W) silhouette, height: (H, W) above the table [m], NaN where unknown, rgb: (H, W, 3), all in
    `view`'s pixels. contour: (n, 2) boundary of the silhouette [m]."""

    view: TableView
    mask: NDArray[np.bool_]
    height: NDArray[np.float32]
    contour: Array
    rgb: NDArray[np.uint8]


@skill
def observe(
    frame: CameraFrame,
    calibration: CameraCalibration,
    table: Table,
    reference: CameraFrame | None,
    previous: CameraFrame | None = None,
    *,
    settings: PerceptionSettings,
) -> Outcome[Observation]:
    """Find the garment in a picture, in whatever state it lies. reference: picture of the empty table. previous:
    the last picture, to detect a frozen camera.

    Failures: CAMERA_FAULT, VIEW_OBSTRUCTED, NO_GARMENT or OUT_OF_VIEW.
    """
    views = open_views(frame, calibration, table, reference, previous, settings).unwrap()
    found = find_silhouette(views, settings).unwrap()
    contour = frozen(views.view.to_table(found.contour))
    return Outcome(
        Observation(views.view, frozen(found.mask), frozen(views.height), contour, frozen(views.seen.rgb))
    )
