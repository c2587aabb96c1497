"""Faults of the camera: pictures that are late, old, empty, incomplete or of the wrong size."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import cv2
import numpy as np
from numpy.typing import NDArray

from foldcell.cell.simulation.camera.camera import SimulatedCamera
from foldcell.cell.simulation.camera.slabs import Slab
from foldcell.cell.simulation.faults.board import FaultBoard
from foldcell.cell.simulation.faults.kinds import FaultKind
from foldcell.robots.ports import CameraFrame, frozen

PATCH = 0.08
"""Largest radius of a patch without depth, as a share of the picture's width."""

IN_A_ROW_S = 0.5
"""Longest time between two pictures in a row [s]."""
A_STILL = 3
"""So many single exposures in a row are taken for a still picture, whose depth the driver averages."""

K = FaultKind


class CameraFaults:
    """Takes pictures with the camera faults that are active at that time."""

    def __init__(self, board: FaultBoard, camera: SimulatedCamera) -> None:
        self._board, self._camera = board, camera
        self._still: CameraFrame | None = None
        """The last still picture."""
        self._takes_stills = False
        """False if the driver averages exposures itself: it then takes single exposures in a row."""
        self._in_a_row, self._last = 0, -math.inf
        """Number of pictures in a row, and the stamp of the last one [s]."""

    def take(self, exposures: int, slabs: Sequence[Slab] = ()) -> CameraFrame:
        """Take a picture of several exposures; one exposure is a glimpse, more are a still. slabs: objects that
        lie or are held before the camera. Raises DriverError like the camera."""
        camera, board = self._camera, self._board
        camera.frozen = board.active(K.CAMERA_FREEZE) is not None
        camera.black = board.active(K.CAMERA_BLACK) is not None
        camera.silent = board.active(K.CAMERA_SILENT) is not None
        old = board.active(K.CAMERA_OLD_PICTURE)
        frame = camera.capture(exposures, slabs)
        if old is not None and self._still is not None:
            frame = replace(self._still, stamp=frame.stamp, sequence=frame.sequence)
        else:
            self._takes_stills |= exposures > 1
            self._in_a_row = self._in_a_row + 1 if frame.stamp - self._last <= IN_A_ROW_S else 1
            self._last = frame.stamp
            if exposures > 1 or (self._in_a_row >= A_STILL and not self._takes_stills):
                self._still = frame
        return frame if board.empty else self._altered(frame)

    def lateness(self) -> float:
        """Return by how much a picture that was taken now arrives late [s]."""
        late = self._board.active(K.CAMERA_LATE)
        return late.extent if late else 0.0

    def _altered(self, frame: CameraFrame) -> CameraFrame:
        active = self._board.active
        missing = active(K.CAMERA_DEPTH_HOLES)
        if missing:
            depth = frame.depth.copy()
            depth[holes(depth.shape, missing.extent, missing.seed)] = np.nan
            frame = replace(frame, depth=frozen(depth))
        if active(K.CAMERA_DEPTH_NAN):
            frame = replace(frame, depth=frozen(np.full_like(frame.depth, np.nan)))
        if active(K.CAMERA_WRONG_SIZE):
            frame = replace(frame, rgb=frozen(frame.rgb[::2, ::2]), depth=frozen(frame.depth[::2, ::2]))
        return frame


def holes(shape: tuple[int, ...], share: float, seed: int) -> NDArray[np.bool_]:
    """Return a mask (h, w) of round patches that cover at least `share` of a picture."""
    rng = np.random.default_rng(seed)
    mask = np.zeros(shape, np.uint8)
    while np.count_nonzero(mask) < share * mask.size:
        centre = int(rng.integers(shape[1])), int(rng.integers(shape[0]))
        cv2.circle(mask, centre, int(rng.uniform(0.25, 1.0) * PATCH * shape[1]), 1, -1)
    return mask.astype(bool)
