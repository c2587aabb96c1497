"""The calibration board: a ChArUco chessboard on an A4 card. The same description is used for drawing and for
detection.

`foldcell calibrate board` writes the board as a sheet to print (calibration/board_sheet.py). Board frame: origin
in the middle of the board, x along its long side, y down its short side, z into the card (away from the viewer). A
gripper holds the card by a tab below the pattern.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from foldcell.robots.ports import Array, frozen

DICTIONARY = "DICT_4X4_50"
"""OpenCV's name of the marker dictionary."""


@dataclass(frozen=True)
class Board:
    """A board of columns x rows squares with side `square` [m]. Its white squares contain markers with side
    `marker` [m]. A white border of width `margin` [m] surrounds the pattern. tab: distance from the board's lower
    edge to the tips of the pads that hold it [m]."""

    columns: int = 7
    rows: int = 5
    square: float = 0.036
    marker: float = 0.025
    margin: float = 0.012
    tab: float = 0.010

    @property
    def size(self) -> tuple[float, float]:
        """Width and height of the card [m]."""
        return self.columns * self.square + 2 * self.margin, self.rows * self.square + 2 * self.margin

    @property
    def corners(self) -> Array:
        """Inner chessboard corners (n, 3) in the board frame [m], indexed by their ChArUco id."""
        middle = np.array([0.5 * self.columns, 0.5 * self.rows, 0.0]) * self.square
        return frozen(np.asarray(self._charuco().getChessboardCorners(), dtype=np.float64) - middle)

    @property
    def T_tool_board(self) -> Array:
        """Nominal pose (4, 4) of the board in a gripper: the tab is between the pads, the card lies in the tool's
        x-z plane, its front faces the tool's -y, and its lower edge is at the distance `tab` from the tips."""
        T = np.eye(4)
        T[:3, :3] = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])
        T[2, 3] = self.tab + 0.5 * self.size[1]
        return frozen(T)

    def image(self, pixels_per_metre: float) -> NDArray[np.uint8]:
        """Return a grey image (h, w) of the card, for printing."""
        w, h = (round(s * pixels_per_metre) for s in self.size)
        margin = round(self.margin * pixels_per_metre)
        return np.asarray(self._charuco().generateImage((w, h), marginSize=margin), dtype=np.uint8)

    def _charuco(self) -> cv2.aruco.CharucoBoard:
        dictionary = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, DICTIONARY))
        return cv2.aruco.CharucoBoard((self.columns, self.rows), self.square, self.marker, dictionary)


BOARD = Board()
MIN_CORNERS = 6
"""Smallest number of corners in a valid view. Four determine a homography; more corners reveal outliers."""
MIN_TOLERANCE = 0.25
"""A corner is always accepted as an inlier if its distance from the position that the homography predicts is at
most this [px]."""


@dataclass(frozen=True, eq=False)
class BoardView:
    """Corners found in one image. index: (n,) indices into `Board.corners`; pixels: (n, 2); width, height: size of
    the image [px]."""

    index: NDArray[np.int64]
    pixels: Array
    width: int
    height: int

    def points(self, board: Board) -> Array:
        """Return the positions (n, 3) of the found corners in the board frame [m]."""
        return np.asarray(board.corners[self.index])


def find_board(rgb: NDArray[np.uint8]) -> BoardView | None:
    """Find the board's corners in an image (h, w, 3) RGB. Returns None if fewer than MIN_CORNERS are found."""
    grey = cv2.cvtColor(rgb, cv2.COLOR_RGB2GRAY)
    corners, ids, _, _ = cv2.aruco.CharucoDetector(BOARD._charuco()).detectBoard(grey)
    if corners is None or ids is None or len(ids) < MIN_CORNERS:
        return None
    index = np.asarray(ids, dtype=np.int64).reshape(-1)
    pixels = np.asarray(corners, dtype=np.float64).reshape(-1, 2)
    keep = _homography_inliers(BOARD.corners[index, :2], pixels)
    if np.count_nonzero(keep) < MIN_CORNERS:
        return None
    return BoardView(index[keep], frozen(pixels[keep]), rgb.shape[1], rgb.shape[0])


def _homography_inliers(points: Array, pixels: Array) -> NDArray[np.bool_]:
    """Return (n,) whether each corner fits the homography of most corners. A pinhole camera maps a flat board by a
    homography; a corner that was displaced by a marker or by the image border does not fit."""
    keep = np.ones(len(points), dtype=bool)
    for _ in range(3):
        H, _ = cv2.findHomography(points[keep], pixels[keep], 0)
        if H is None:
            return np.zeros(len(points), dtype=bool)
        mapped = np.column_stack((points, np.ones(len(points)))) @ H.T
        distance = np.linalg.norm(mapped[:, :2] / mapped[:, 2:] - pixels, axis=1)
        inliers = distance <= max(MIN_TOLERANCE, 3.0 * float(np.median(distance[keep])))
        if (inliers == keep).all() or np.count_nonzero(inliers) < MIN_CORNERS:
            return inliers
        keep = inliers
    return keep


def draw_view(rgb: NDArray[np.uint8], view: BoardView) -> NDArray[np.uint8]:
    """Return a copy of the image with the found corners drawn in."""
    picture = np.ascontiguousarray(rgb).copy()
    for k, (u, v) in zip(view.index, view.pixels, strict=True):
        centre = (round(float(u) * 16), round(float(v) * 16))
        cv2.circle(picture, centre, 4 * 16, (255, 0, 0), 1, cv2.LINE_AA, 4)
        cv2.putText(picture, str(int(k)), (centre[0] // 16 + 5, centre[1] // 16 - 4), cv2.FONT_HERSHEY_SIMPLEX,
                    0.35, (0, 0, 255), 1, cv2.LINE_AA)  # fmt: skip
    return picture
