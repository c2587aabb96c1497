"""The camera's focal lengths and centre, from pictures of the calibration board held before it in many poses.

Zhang's method (IEEE T-PAMI 22(11), 2000) as OpenCV has it, for a pinhole: the cell's camera model knows no lens
distortion. A second fit with radial distortion says how much that leaves out.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from calibration.board import BOARD, Board, BoardView, draw_view, find_board
from calibration.effects import Procedure, bring, look, note
from robots.ports import BoardPlace, Intrinsics
from skills.vocabulary import Failure, FailureKind, Outcome

__all__ = ["CameraSettings", "IntrinsicsCalibration", "calibrate_camera", "fit_intrinsics"]

PINHOLE = cv2.CALIB_FIX_K1 | cv2.CALIB_FIX_K2 | cv2.CALIB_FIX_K3 | cv2.CALIB_ZERO_TANGENT_DIST
RADIAL = cv2.CALIB_FIX_K2 | cv2.CALIB_FIX_K3 | cv2.CALIB_ZERO_TANGENT_DIST
FEWEST_VIEWS = 5


@dataclass(frozen=True)
class CameraSettings:
    """views: pictures that show the board. tries: pictures for each of them, at most."""

    views: int = 20
    tries: float = 2.0
    fewest_corners: int = 10
    rms: float = 1.0
    """Reprojection error above which the board is not flat, not ours, or moved [px]."""
    focal_sigma: float = 0.004
    """Largest standard deviation of a focal length, as a share of it: views that lean too little, or all alike,
    leave it open,"""
    centre_sigma: float = 3.0
    """and of the centre [px];"""
    lean: float = float(np.deg2rad(8.0))
    """boards that all face the camera even make these look small: how far they have to lean, in the mean [rad]."""
    distortion: float = 2.0
    """What a radial distortion may move a picture's corner [px]."""

    def __post_init__(self) -> None:
        if self.views < FEWEST_VIEWS:
            raise ValueError(f"{self.views} views: a camera is calibrated with {FEWEST_VIEWS} or more")


@dataclass(frozen=True, eq=False)
class IntrinsicsCalibration:
    """rms: reprojection error [px]; worst_view: the largest of one view. sigma: standard deviations of fx, fy, cx,
    cy [px]. distortion: of a picture's corner, by a fit with radial distortion [px]. coverage: share of the
    picture's 8 x 6 fields in which a corner was seen."""

    intrinsics: Intrinsics
    rms: float
    worst_view: float
    sigma: tuple[float, float, float, float]
    distortion: float
    views: int
    corners: int
    coverage: float


def calibrate_camera(
    settings: CameraSettings | None = None, board: Board = BOARD
) -> Procedure[IntrinsicsCalibration]:
    """Have the board shown in one pose after the other until enough pictures show it; then fit.

    Failures: OUT_OF_VIEW (too few pictures show the board), and those of `fit_intrinsics`.
    """
    settings = settings or CameraSettings()
    views: list[BoardView] = []
    tries = round(settings.tries * settings.views)
    for k in range(tries):
        if len(views) == settings.views:
            break
        asked = yield from bring(BoardPlace.SHOWN)
        sight = yield from look()
        failure = asked.failure or sight.failure
        if failure:
            return Outcome(failure=failure)
        rgb = sight.unwrap().frame.rgb
        view = find_board(rgb, board)
        if view is None or len(view.index) < settings.fewest_corners:
            found = 0 if view is None else len(view.index)
            yield from note(f"picture {k + 1}: left out, {found} corners", rgb, f"board-{k + 1:02}-left-out")
            continue
        views.append(view)
        yield from note(
            f"view {len(views)} of {settings.views}: {len(view.index)} corners",
            draw_view(rgb, view), f"board-{k + 1:02}",
        )  # fmt: skip
    yield from bring(BoardPlace.AWAY)
    if len(views) < settings.views:
        return Outcome(
            failure=Failure(
                FailureKind.OUT_OF_VIEW,
                f"{len(views)} of {tries} pictures show the board; {settings.views} are needed",
                "hold it nearer and in the light, the whole card in the picture", {"views": len(views)},
            )
        )  # fmt: skip
    return fit_intrinsics(views, settings, board)


def fit_intrinsics(
    views: Sequence[BoardView], settings: CameraSettings | None = None, board: Board = BOARD
) -> Outcome[IntrinsicsCalibration]:
    """A pinhole through the views.

    Fails with LOW_CONFIDENCE: views too few or too much alike, not a flat board, a lens that distorts.
    """
    settings = settings or CameraSettings()
    if len(views) < FEWEST_VIEWS:
        what = f"{len(views)} views of the board do not give a camera's intrinsics"
        return _doubt(what, f"take {FEWEST_VIEWS} or more", {"views": len(views)})
    size = (views[0].width, views[0].height)
    points = [view.points(board).astype(np.float32) for view in views]
    pixels = [view.pixels.astype(np.float32) for view in views]
    try:
        rms, K, _, turns, shifts, _, _, each = cv2.calibrateCameraExtended(
            points, pixels, size, np.eye(3), np.zeros(5), flags=PINHOLE
        )
        _, _, bent, _, _, bent_sigma, _, _ = cv2.calibrateCameraExtended(
            points, pixels, size, K.copy(), np.zeros(5), flags=RADIAL | cv2.CALIB_USE_INTRINSIC_GUESS
        )
    except cv2.error as e:
        return _doubt(f"the views give no camera: {e.err}", "show the board leaning, each time another way")
    fx, fy, cx, cy = (float(v) for v in (K[0, 0], K[1, 1], K[0, 2], K[1, 2]))
    s = _deviations(K, points, pixels, turns, shifts)
    if rms > settings.rms:
        what = f"the corners miss the fit by {rms:.2f} px"
        return _doubt(what, "see that the board is flat, printed to scale and held still", {"rms_px": float(rms)})
    left_open, lean = max(s[0] / fx, s[1] / fy), _mean_lean(turns)
    sure = left_open <= settings.focal_sigma and max(s[2:]) <= settings.centre_sigma and lean >= settings.lean
    if not (sure and np.isfinite([fx, fy, cx, cy, *s]).all()):
        what = (
            f"the views are too much alike: the boards lean by {np.rad2deg(lean):.0f} degrees in the mean,"
            f" by {np.rad2deg(_mean_gap(turns)):.0f} away from one another"
        )
        return _doubt(what, "show the board leaning, each time another way, near and far", {"sigma_px": s})
    if not (0 <= cx < size[0] and 0 <= cy < size[1]):
        return _doubt(f"the fit puts the picture's centre at ({cx:.0f}, {cy:.0f})", "take more views")
    k1, k1_sigma = float(np.asarray(bent).reshape(-1)[0]), float(np.asarray(bent_sigma).reshape(-1)[4])
    moved = _corner_shift(fx, fy, cx, cy, size, k1)
    if moved > settings.distortion and abs(k1) > 5.0 * k1_sigma:
        what = f"the lens moves the picture's corners by {moved:.1f} px; the cell takes its camera for a pinhole"
        return _doubt(what, "switch on the camera's own rectification", {"distortion_px": moved})
    intrinsics = Intrinsics(size[0], size[1], fx, fy, cx, cy)
    return Outcome(
        IntrinsicsCalibration(
            intrinsics, float(rms), float(np.max(each)), s, moved, len(views),
            sum(len(v.index) for v in views), _coverage(views),
        )
    )  # fmt: skip


def _deviations(
    K: np.ndarray,
    points: Sequence[np.ndarray],
    pixels: Sequence[np.ndarray],
    turns: Sequence[np.ndarray],
    shifts: Sequence[np.ndarray],
) -> tuple[float, float, float, float]:
    """Standard deviations of fx, fy, cx, cy [px] of a fit, by what the corners tell once each board may lie anyhow
    (the Schur complement of the boards' poses).

    OpenCV's own leave out the directions of which the views tell nothing: of boards that are all parallel, which
    fit any focal length, it says 0.2 px.
    """
    told, squares, free = np.zeros((4, 4)), 0.0, -4
    for object_, seen, turn, shift in zip(points, pixels, turns, shifts, strict=True):
        expected, J = cv2.projectPoints(object_, turn, shift, K, np.zeros(5))
        misses = (np.asarray(expected).reshape(-1, 2) - seen).ravel()
        by_lens, by_pose = J[:, 6:10], J[:, :6]
        told += by_lens.T @ by_lens
        told -= by_lens.T @ by_pose @ np.linalg.pinv(by_pose.T @ by_pose) @ by_pose.T @ by_lens
        squares, free = squares + float(misses @ misses), free + len(misses) - 6
    sizes, axes = np.linalg.eigh(told)
    variance = squares / max(free, 1) * (axes**2 / np.maximum(sizes, 1e-12)).sum(axis=1)
    fx, fy, cx, cy = (float(v) for v in np.sqrt(variance))
    return fx, fy, cx, cy


def _mean_lean(turns: Sequence[np.ndarray]) -> float:
    """Of the boards away from facing the camera [rad]."""
    facing = [abs(float(cv2.Rodrigues(np.asarray(w))[0][2, 2])) for w in turns]
    return float(np.arccos(np.clip(facing, 0.0, 1.0)).mean())


def _mean_gap(turns: Sequence[np.ndarray]) -> float:
    """Of the boards from the direction in which they face together [rad]."""
    facing = np.array([cv2.Rodrigues(np.asarray(w))[0][:, 2] for w in turns])
    together = facing.sum(axis=0) / np.linalg.norm(facing.sum(axis=0))
    return float(np.arccos(np.clip(facing @ together, -1.0, 1.0)).mean())


def _corner_shift(fx: float, fy: float, cx: float, cy: float, size: tuple[int, int], k1: float) -> float:
    """How far the radial distortion 1 + k1 r^2 moves the farthest corner of the picture [px]."""
    x = np.array([(u - cx) / fx for u in (0, size[0])])
    y = np.array([(v - cy) / fy for v in (0, size[1])])
    r2 = float(np.max(x**2) + np.max(y**2))
    return float(abs(k1) * r2**1.5 * 0.5 * (fx + fy))


def _coverage(views: Sequence[BoardView]) -> float:
    fields = {
        (int(8 * u / view.width), int(6 * v / view.height)) for view in views for u, v in view.pixels.tolist()
    }
    return len(fields) / 48.0


def _doubt(what: str, hint: str, values: dict[str, object] | None = None) -> Outcome[IntrinsicsCalibration]:
    return Outcome(failure=Failure(FailureKind.LOW_CONFIDENCE, what, hint, values or {}))
