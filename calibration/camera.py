"""Determine the camera's intrinsics from images of the calibration board in many poses.

The fit is Zhang's method (IEEE T-PAMI 22(11), 2000) as implemented in OpenCV. It fits a pinhole, because the
cell's camera model has no lens distortion. A second fit with radial distortion measures the error of the pinhole
model.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from foldcell.calibration.board import BOARD, BoardView, draw_view, find_board
from foldcell.calibration.effects import Procedure, bring, look, note
from foldcell.robots.errors import ConfigurationError
from foldcell.robots.ports import BoardPlace, Intrinsics
from foldcell.skills.vocabulary import Failure, FailureKind, Outcome

PINHOLE = cv2.CALIB_FIX_K1 | cv2.CALIB_FIX_K2 | cv2.CALIB_FIX_K3 | cv2.CALIB_ZERO_TANGENT_DIST
RADIAL = cv2.CALIB_FIX_K2 | cv2.CALIB_FIX_K3 | cv2.CALIB_ZERO_TANGENT_DIST
MIN_VIEWS = 5
PICTURES_PER_VIEW = 2
"""The largest number of images that are taken is this number times the wanted number of views."""
MIN_CORNERS = 10
"""Smallest number of corners in an accepted image."""
MAX_RMS = 1.0
"""Largest accepted reprojection error [px]. A larger error means that the board is not flat, is another board, or
has moved."""
MAX_FOCAL_SIGMA = 0.004
"""Largest accepted relative standard deviation of a focal length. If the board is tilted too little, or equally in
all views, the views do not determine the focal length."""
MAX_CENTRE_SIGMA = 3.0
"""Largest accepted standard deviation of the principal point [px]."""
MIN_LEAN = float(np.deg2rad(8.0))
"""Smallest accepted mean tilt of the board against the image plane [rad]. If the board faces the camera in all
views, the computed standard deviations are too small."""
MAX_DISTORTION = 2.0
"""Largest accepted displacement of an image corner by radial distortion [px]."""


@dataclass(frozen=True, eq=False)
class IntrinsicsCalibration:
    """Result of a camera calibration. rms: reprojection error [px]; worst_view: largest reprojection error of one
    view [px]. sigma: standard deviations of fx, fy, cx, cy [px]. distortion: displacement of an image corner in a
    fit with radial distortion [px]. views, corners: numbers used in the fit. coverage: fraction of the 8 x 6 cells
    of the image that contain a found corner."""

    intrinsics: Intrinsics
    rms: float
    worst_view: float
    sigma: tuple[float, float, float, float]
    distortion: float
    views: int
    corners: int
    coverage: float


def check_views(count: int) -> None:
    """Raise ConfigurationError if this number of views cannot calibrate a camera."""
    if count < MIN_VIEWS:
        raise ConfigurationError(
            f"{count} views: a camera calibration needs {MIN_VIEWS} or more", "see foldcell calibrate --help"
        )


def calibrate_camera(wanted: int) -> Procedure[IntrinsicsCalibration]:
    """Ask for the board in one pose after another until `wanted` images show it, then fit the intrinsics.

    Failures: OUT_OF_VIEW (too few images show the board), and those of `fit_intrinsics`.
    """
    views: list[BoardView] = []
    max_pictures = PICTURES_PER_VIEW * wanted
    for k in range(max_pictures):
        if len(views) == wanted:
            break
        yield from bring(BoardPlace.SHOWN)
        rgb = (yield from look()).frame.rgb
        view = find_board(rgb)
        if view is None or len(view.index) < MIN_CORNERS:
            found = 0 if view is None else len(view.index)
            yield from note(f"picture {k + 1}: rejected, {found} corners", rgb, f"board-{k + 1:02}-left-out")
            continue
        views.append(view)
        yield from note(
            f"view {len(views)} of {wanted}: {len(view.index)} corners",
            draw_view(rgb, view), f"board-{k + 1:02}",
        )  # fmt: skip
    yield from bring(BoardPlace.AWAY)
    if len(views) < wanted:
        return Outcome(
            failure=Failure(
                FailureKind.OUT_OF_VIEW,
                f"{len(views)} of {max_pictures} pictures show the board; {wanted} are needed",
                "hold the whole card in the picture, nearer and in better light", {"views": len(views)},
            )
        )  # fmt: skip
    return fit_intrinsics(views)


def fit_intrinsics(views: Sequence[BoardView]) -> Outcome[IntrinsicsCalibration]:
    """Fit a pinhole camera to the views.

    Fails with LOW_CONFIDENCE for views that are too similar, a board that is not flat, and a lens
    with distortion.
    """
    size = (views[0].width, views[0].height)
    points = [view.points(BOARD).astype(np.float32) for view in views]
    pixels = [view.pixels.astype(np.float32) for view in views]
    try:
        rms, K, _, rotations, translations, _, _, view_rms = cv2.calibrateCameraExtended(
            points, pixels, size, np.eye(3), np.zeros(5), flags=PINHOLE
        )
        _, _, distortion, _, _, distortion_sigma, _, _ = cv2.calibrateCameraExtended(
            points, pixels, size, K.copy(), np.zeros(5), flags=RADIAL | cv2.CALIB_USE_INTRINSIC_GUESS
        )
    except cv2.error as e:
        return _low_confidence(f"the camera fit failed: {e.err}", "tilt the board, each time in another direction")
    fx, fy, cx, cy = (float(v) for v in (K[0, 0], K[1, 1], K[0, 2], K[1, 2]))
    s = _deviations(K, points, pixels, rotations, translations)
    if rms > MAX_RMS:
        what = f"the corners miss the fit by {rms:.2f} px"
        hint = "check that the board is flat, printed to scale and held still"
        return _low_confidence(what, hint, {"rms_px": float(rms)})
    focal_sigma, lean = max(s[0] / fx, s[1] / fy), _mean_lean(rotations)
    sure = focal_sigma <= MAX_FOCAL_SIGMA and max(s[2:]) <= MAX_CENTRE_SIGMA and lean >= MIN_LEAN
    if not (sure and np.isfinite([fx, fy, cx, cy, *s]).all()):
        what = (
            f"the views are too much alike: the mean tilt of the boards is {np.rad2deg(lean):.0f} degrees, and"
            f" {np.rad2deg(_mean_gap(rotations)):.0f} from their mean direction"
        )
        return _low_confidence(
            what, "tilt the board, each time in another direction, near and far", {"sigma_px": s}
        )
    if not (0 <= cx < size[0] and 0 <= cy < size[1]):
        return _low_confidence(f"the fitted principal point ({cx:.0f}, {cy:.0f}) is outside", "take more views")
    k1 = float(np.asarray(distortion).reshape(-1)[0])
    k1_sigma = float(np.asarray(distortion_sigma).reshape(-1)[4])
    shift = _corner_shift(fx, fy, cx, cy, size, k1)
    if shift > MAX_DISTORTION and abs(k1) > 5.0 * k1_sigma:
        what = f"the lens moves the corners of the picture by {shift:.1f} px; the cell's camera model is a pinhole"
        return _low_confidence(what, "switch on the camera's own rectification", {"distortion_px": shift})
    intrinsics = Intrinsics(size[0], size[1], fx, fy, cx, cy)
    return Outcome(
        IntrinsicsCalibration(
            intrinsics, float(rms), float(np.max(view_rms)), s, shift, len(views),
            sum(len(v.index) for v in views), _coverage(views),
        )
    )  # fmt: skip


def _deviations(
    K: np.ndarray,
    points: Sequence[np.ndarray],
    pixels: Sequence[np.ndarray],
    rotations: Sequence[np.ndarray],
    translations: Sequence[np.ndarray],
) -> tuple[float, float, float, float]:
    """Return the standard deviations of fx, fy, cx, cy [px] of a fit. The unknown poses of the board are
    marginalised (Schur complement).

    OpenCV's own standard deviations omit directions that the views do not determine. For example, parallel boards
    fit any focal length, but OpenCV reports a standard deviation of 0.2 px for them.
    """
    information, squares, free = np.zeros((4, 4)), 0.0, -4
    for object_, seen, rotation, translation in zip(points, pixels, rotations, translations, strict=True):
        expected, J = cv2.projectPoints(object_, rotation, translation, K, np.zeros(5))
        residual = (np.asarray(expected).reshape(-1, 2) - seen).ravel()
        J_lens, J_pose = J[:, 6:10], J[:, :6]
        information += J_lens.T @ J_lens
        information -= J_lens.T @ J_pose @ np.linalg.pinv(J_pose.T @ J_pose) @ J_pose.T @ J_lens
        squares, free = squares + float(residual @ residual), free + len(residual) - 6
    eigenvalues, axes = np.linalg.eigh(information)
    variance = squares / max(free, 1) * (axes**2 / np.maximum(eigenvalues, 1e-12)).sum(axis=1)
    fx, fy, cx, cy = (float(v) for v in np.sqrt(variance))
    return fx, fy, cx, cy


def _mean_lean(rotations: Sequence[np.ndarray]) -> float:
    """Return the mean angle between the boards' normals and the optical axis [rad]."""
    facing = [abs(float(cv2.Rodrigues(np.asarray(w))[0][2, 2])) for w in rotations]
    return float(np.arccos(np.clip(facing, 0.0, 1.0)).mean())


def _mean_gap(rotations: Sequence[np.ndarray]) -> float:
    """Return the mean angle between the boards' normals and their mean normal [rad]."""
    normals = np.array([cv2.Rodrigues(np.asarray(w))[0][:, 2] for w in rotations])
    mean = normals.sum(axis=0) / np.linalg.norm(normals.sum(axis=0))
    return float(np.arccos(np.clip(normals @ mean, -1.0, 1.0)).mean())


def _corner_shift(fx: float, fy: float, cx: float, cy: float, size: tuple[int, int], k1: float) -> float:
    """Return the displacement of the farthest image corner by the radial distortion 1 + k1 r^2 [px]."""
    x = np.array([(u - cx) / fx for u in (0, size[0])])
    y = np.array([(v - cy) / fy for v in (0, size[1])])
    r2 = float(np.max(x**2) + np.max(y**2))
    return float(abs(k1) * r2**1.5 * 0.5 * (fx + fy))


def _coverage(views: Sequence[BoardView]) -> float:
    fields = {
        (int(8 * u / view.width), int(6 * v / view.height)) for view in views for u, v in view.pixels.tolist()
    }
    return len(fields) / 48.0


def _low_confidence(
    what: str, hint: str, values: dict[str, object] | None = None
) -> Outcome[IntrinsicsCalibration]:
    return Outcome(failure=Failure(FailureKind.LOW_CONFIDENCE, what, hint, values or {}))
