"""Hand-eye calibration: find the camera's pose in the base frame, from images of the board in each hand in many
poses.

The camera is fixed and the board moves with the hand: T_base_tool(i) Y = X T_camera_board(i) for every image i,
with unknown X = T_base_camera and Y = T_tool_board (the robot-world / hand-eye problem). Least squares on the
reprojection error solves it. The search starts with the board as it is meant to be held, and with the camera
where the first image then shows it. Both hands share X. The zeros of the joints are wrong by about a milliradian,
which a single pose cannot show. They are estimated together with X and Y, with a prior of mean zero. So is the
scale of the printed board: the arms know how far they have moved it. A scale that the tolerance of the print does
not explain is refused.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import cv2
import numpy as np
import pinocchio as pin
from scipy.optimize import least_squares

from foldcell.calibration.board import BOARD, BoardView, draw_view, find_board
from foldcell.calibration.effects import Procedure, bring, grip, look, note, reach
from foldcell.robots.errors import ConfigurationError
from foldcell.robots.model import RobotModel
from foldcell.robots.ports import Array, BoardPlace, Intrinsics, Side, arm_slice, frozen
from foldcell.skills.motion.kinematics.ik import tool_pose
from foldcell.skills.vocabulary import CameraCalibration, Failure, FailureKind, Outcome, Table

PLACES = {Side.LEFT: BoardPlace.LEFT_HAND, Side.RIGHT: BoardPlace.RIGHT_HAND}
MIN_VIEWS = 4
"""Smallest number of views in each hand. Three poses with rotations about two axes are the minimum. A fourth view
makes an error visible."""


POSES_PER_VIEW = 4
"""The largest number of poses that are tried per hand is this number times the wanted number of views."""
MIN_CORNERS = 10
"""Smallest number of corners in a view."""
LEAN = 0.6
"""Largest angle between the board's normal and the view ray [rad]."""
TURN = (0.4, 1.6)
"""Range of the direction in which the card's lower edge points [rad]: 0 towards the robot, pi / 2 towards the side
of the hand."""
GRIP_FORCE = 15.0
CORNER_SIGMA = 0.15
"""Standard deviation of the position of one found corner [px]."""
JOINT_SIGMA = 0.0015
"""Standard deviation of the joints' zeros [rad]. It corresponds to the arms' stated accuracy of 5 mm."""
PRINT_SIGMA = 0.0005
"""Relative standard deviation of the scale of the printed board."""
GATE = 3.0
"""The scale of the board may differ from 1 by this number of standard deviations."""
LEAST_SPREAD = float(np.deg2rad(3.0))
"""Smallest standard deviation of a hand's rotations about their second axis [rad]."""
MAX_RMS = 1.5
"""Largest accepted reprojection error [px]. A larger error means that the intrinsics, the board or the arms' model
is wrong."""


@dataclass(frozen=True)
class HandEyeSettings:
    """Settings of a hand-eye calibration. views: number of views of the board in each hand. focal_sigma,
    centre_sigma: standard deviation of the focal lengths (relative) and of the principal point [px].
    position_sigma [m], angle_sigma [rad]: largest accepted standard deviations of the camera's pose. Raises
    ConfigurationError for too few views."""

    views: int = 12
    focal_sigma: float = 0.002
    centre_sigma: float = 0.7
    position_sigma: float = 0.004
    angle_sigma: float = float(np.deg2rad(0.3))

    @classmethod
    def with_lens_of_data_sheet(cls, views: int) -> HandEyeSettings:
        """Return settings for intrinsics from a data sheet, which states a field of view in whole degrees and a
        principal point near the middle. The fitted pose then absorbs the error of the intrinsics and is less
        certain."""
        return cls(
            views, focal_sigma=0.01, centre_sigma=5.0, position_sigma=0.020, angle_sigma=float(np.deg2rad(1.5))
        )

    def __post_init__(self) -> None:
        if self.views < MIN_VIEWS:
            raise ConfigurationError(
                f"{self.views} views: a hand-eye calibration needs {MIN_VIEWS} or more in each hand",
                "see foldcell calibrate --help",
            )


@dataclass(frozen=True, eq=False)
class HandView:
    """One image of the board in a hand. q: (arm,) joints of that arm [rad]; view: the found corners."""

    side: Side
    q: Array
    view: BoardView


@dataclass(frozen=True, eq=False)
class HandEyeCalibration:
    """Result of a hand-eye calibration. T_base_camera: (4, 4). T_tool_board: hand -> (4, 4). rms: reprojection
    error [px]. scale: size of the printed board relative to its drawing. position [m], angle [rad]: root mean
    square difference between the board's pose from the arm and from the camera.

    position_sigma [m], angle_sigma [rad]: standard deviation of the camera's pose along its worst axis. It
    includes the errors of the corners, the joints' zeros, the intrinsics and the print, and the scatter of the
    views.
    """

    T_base_camera: Array
    T_tool_board: Mapping[Side, Array]
    rms: float
    scale: float
    position: float
    angle: float
    position_sigma: float
    angle_sigma: float
    views: int


def calibrate_hand_eye(
    robot: RobotModel,
    camera: CameraCalibration,
    table: Table,
    settings: HandEyeSettings,
) -> Procedure[HandEyeCalibration]:
    """Show the board in each hand to the camera in many poses, then fit the camera's pose.

    camera: present calibration, from which the intrinsics and the poses of the board are taken. Failures:
    UNREACHABLE (no pose in which a hand can take the board), OUT_OF_VIEW (too few images show the board), and
    those of `fit_hand_eye`.
    """
    T_base_camera = table.T_base_table @ camera.T_table_camera
    views: list[HandView] = []
    for side in Side:
        views += (yield from _views_in(side, T_base_camera, settings)).unwrap()
    return fit_hand_eye(robot, camera.intrinsics, views, settings)


def _views_in(side: Side, T_base_camera: Array, settings: HandEyeSettings) -> Procedure[tuple[HandView, ...]]:
    """Take the board in one hand, show it to the camera in many poses, and give it back."""
    poses = board_poses(side, T_base_camera, settings)
    views: list[HandView] = []
    holding = False
    for T_base_board in poses:
        if len(views) == settings.views:
            break
        reached = yield from reach(side, T_base_board @ np.linalg.inv(BOARD.T_tool_board))
        if reached.failure:  # planning failed, so nothing moved: try the next pose
            continue
        if not holding:
            yield from grip(side, 0.02, GRIP_FORCE)
            yield from bring(PLACES[side])
            yield from grip(side, 0.0, GRIP_FORCE)
            holding = True
        sight = yield from look()
        rgb, q, n = sight.frame.rgb, sight.q, len(views) + 1
        view = find_board(rgb)
        if view is None or len(view.index) < MIN_CORNERS:
            yield from note(f"{side} hand: pose rejected, {0 if view is None else len(view.index)} corners")
            continue
        views.append(HandView(side, frozen(q[arm_slice(side, len(q))]), view))
        yield from note(
            f"{side} hand, view {n} of {settings.views}: {len(view.index)} corners",
            draw_view(rgb, view), f"board-{side}-{n:02}",
        )  # fmt: skip
    if not holding:
        what = f"the {side} hand reaches none of the {len(poses)} poses in front of the camera"
        return Outcome(failure=Failure(FailureKind.UNREACHABLE, what, "clear the table's surroundings"))
    yield from bring(BoardPlace.AWAY)  # before the hand opens, so that the board does not fall
    yield from grip(side, 0.02, GRIP_FORCE)
    if len(views) < settings.views:
        what = f"the board was seen in {len(views)} poses of the {side} hand; {settings.views} are needed"
        hint = "check that the printed side faces the camera and is lit, or ask for fewer views with --views"
        return Outcome(failure=Failure(FailureKind.OUT_OF_VIEW, what, hint, {"views": len(views)}))
    return Outcome(tuple(views))


def board_poses(side: Side, T_base_camera: Array, settings: HandEyeSettings) -> tuple[Array, ...]:
    """Return board poses (4, 4) in the base frame for one hand. The sequence is the same in every call.

    The poses are spread over the camera's view, and the board faces the camera to within the angle `lean`. The
    card's lower edge, which the hand holds, points to the hand's side of the cell, where the arm has room.
    """
    rng = np.random.default_rng(11)
    sign = 1.0 if side is Side.LEFT else -1.0
    poses = []
    for _ in range(POSES_PER_VIEW * settings.views):
        centre = np.array([rng.uniform(0.42, 0.76), sign * rng.uniform(-0.02, 0.26), rng.uniform(0.10, 0.42)])
        towards = rng.uniform(*TURN)
        lean = LEAN * np.sqrt(rng.random())
        about = rng.uniform(0.0, 2 * np.pi)
        ray = centre - T_base_camera[:3, 3]
        z = ray / np.linalg.norm(ray)
        y = np.array([-np.cos(towards), sign * np.sin(towards), 0.0])  # down the card
        y -= (y @ z) * z
        y /= np.linalg.norm(y)
        T = np.eye(4)
        T[:3, :3] = np.column_stack((np.cross(y, z), y, z))
        T[:3, :3] = T[:3, :3] @ _rotation(lean * np.array([np.cos(about), np.sin(about), 0.0]))
        T[:3, 3] = centre
        poses.append(frozen(T))
    return tuple(poses)


def fit_hand_eye(
    robot: RobotModel,
    intrinsics: Intrinsics,
    views: Sequence[HandView],
    settings: HandEyeSettings,
) -> Outcome[HandEyeCalibration]:
    """Fit the camera's pose to the views of one or both hands.

    Fails with LOW_CONFIDENCE for poses that are too similar, a board of another size, and corners that fit no
    camera pose.
    """
    sides = tuple(side for side in Side if any(v.side is side for v in views))
    for side in sides:
        if (
            _second_axis_spread([tool_pose(robot.chains[side], v.q) for v in views if v.side is side])
            < LEAST_SPREAD
        ):
            what = f"the poses of the {side} hand rotate about one axis only"
            return _low_confidence(what, "tilt the board, each time in another direction")
    seen = [_board_pose(intrinsics, v.view) for v in views]
    first = tool_pose(robot.chains[views[0].side], views[0].q)
    X, Y = first @ BOARD.T_tool_board @ np.linalg.inv(seen[0]), {side: BOARD.T_tool_board for side in sides}
    problem = _Problem(robot, intrinsics, tuple(views), sides, X, Y, settings)
    fit = least_squares(problem.residuals, np.zeros(problem.size), method="lm")
    return problem.result(fit.x, fit.jac, seen)


class _Problem:
    """The least-squares problem. Its unknowns form one vector: a twist on X, then for each hand a twist on Y and
    joint offsets in units of JOINT_SIGMA, and last the board's scale - 1 in units of PRINT_SIGMA."""

    def __init__(
        self,
        robot: RobotModel,
        intrinsics: Intrinsics,
        views: tuple[HandView, ...],
        sides: tuple[Side, ...],
        X: Array,
        Y: Mapping[Side, Array],
        settings: HandEyeSettings,
    ) -> None:
        self._robot, self._k, self._views, self._sides = robot, intrinsics, views, sides
        self._X, self._Y, self._settings = X, Y, settings
        self._hand = 6 + len(views[0].q)
        """Number of unknowns of one hand."""
        self.size = 6 + self._hand * len(sides) + 1

    def _parts(self, x: Array) -> tuple[Array, dict[Side, Array], dict[Side, Array]]:
        Y, offsets = {}, {}
        for side, part in zip(self._sides, x[6:-1].reshape(-1, self._hand), strict=True):
            Y[side] = self._Y[side] @ _exp(part[:6])
            offsets[side] = part[6:] * JOINT_SIGMA
        return self._X @ _exp(x[:6]), Y, offsets

    def _reprojection(self, x: Array, lens: Array | None = None) -> Array:
        """Return the found minus the expected corners (m, 2) of all views [px]. lens: (4,) assumed errors of the
        focal lengths (relative) and the principal point [px]; None: no errors."""
        fx, fy, cx, cy = np.zeros(4) if lens is None else lens
        X, Y, offsets = self._parts(x)
        T_camera_base = np.linalg.inv(X)
        out = []
        for v in self._views:
            T = T_camera_base @ tool_pose(self._robot.chains[v.side], v.q - offsets[v.side]) @ Y[v.side]
            p = _scale(x) * v.view.points(BOARD) @ T[:3, :3].T + T[:3, 3]
            k = self._k
            scale = [(1.0 + fx) * k.fx, (1.0 + fy) * k.fy]
            uv = p[:, :2] / np.maximum(p[:, 2:], 1e-3) * scale + [k.cx + cx, k.cy + cy]
            out.append(v.view.pixels - uv)
        return np.vstack(out)

    def residuals(self, x: Array) -> Array:
        """Return the reprojection errors, joint offsets and the board's scale - 1, each divided by its standard
        deviation."""
        corners = self._reprojection(x).ravel() / CORNER_SIGMA
        offsets = x[6:-1].reshape(-1, self._hand)[:, 6:].ravel()
        return np.concatenate([corners, offsets, x[-1:]])

    def _lens_influence(self, x: Array, gain: Array) -> Array:
        """Return the influence of the lens on the unknowns, (size, 4). Column i is the change that an error
        of one standard deviation in parameter i causes. `_reprojection` lists the parameters."""
        s, columns = self._settings, []
        for i, sigma in enumerate((s.focal_sigma, s.focal_sigma, s.centre_sigma, s.centre_sigma)):
            lens = np.zeros(4)
            lens[i] = sigma
            change = (self._reprojection(x, lens) - self._reprojection(x)).ravel() / CORNER_SIGMA
            columns.append(gain[:, : len(change)] @ change)
        return np.column_stack(columns)

    def _view_influence(self, x: Array, J: Array, inverse: Array) -> Array:
        """Return the influence of the views on the unknowns, (size, views). Column i belongs to view i.

        The errors of all corners of a view are correlated, for example by a joint reading or a slip of the board.
        The independent observations are therefore the views and not the corners (cluster-robust covariance: Liang
        and Zeger, Biometrika 73(1), 1986).
        """
        residuals = self.residuals(x)
        ends = np.cumsum([2 * len(v.view.index) for v in self._views])
        parts = (slice(a, b) for a, b in zip([0, *ends[:-1]], ends, strict=True))
        influence = np.column_stack([inverse @ (J[part].T @ residuals[part]) for part in parts])
        return np.asarray(influence * np.sqrt(len(ends) / (len(ends) - 1.0)))

    def result(self, x: Array, J: Array, seen: Sequence[Array]) -> Outcome[HandEyeCalibration]:
        """Return the calibration at the solution x, or a failure if its errors are too large."""
        s = self._settings
        rms = float(np.sqrt((self._reprojection(x) ** 2).sum(axis=1).mean()))
        if rms > MAX_RMS:
            what = f"the corners miss the fit by {rms:.2f} px"
            hint = (
                "calibrate the intrinsics first (calibrate camera); check that the board cannot slip in the hand"
            )
            return _low_confidence(what, hint, {"rms_px": rms})
        X, Y, offsets = self._parts(x)
        # Three errors that the model does not contain increase the variance: a reprojection error above
        # CORNER_SIGMA; errors of the lens; errors that all corners of a view share.
        inverse = np.asarray(np.linalg.pinv(J.T @ J), dtype=np.float64)
        by_lens = self._lens_influence(x, inverse @ J.T)
        by_view = self._view_influence(x, J, inverse)
        variance = inverse * max(1.0, (rms / CORNER_SIGMA) ** 2 / 2) + by_lens @ by_lens.T + by_view @ by_view.T
        scale, scale_sigma = _scale(x), PRINT_SIGMA * float(np.sqrt(1.0 + variance[-1, -1]))
        if abs(scale - 1.0) > GATE * scale_sigma:
            scale = 1.0 + (scale - 1.0) / (1.0 - float(inverse[-1, -1]))  # without the pull of the prior
            what = (
                f"by the arms' motion, the printed board has {scale:.1%} of its size; "
                f"its print and this measurement explain {GATE * scale_sigma:.1%}"
            )
            hint = "print it again at 100 % (not 'fit to page'), and measure the pattern (docs/do/calibrate.md)"
            return _low_confidence(what, hint, {"scale": scale, "scale_sigma": scale_sigma})
        position, angle = (
            float(np.sqrt(np.linalg.eigvalsh(variance[c, c])[-1])) for c in (slice(0, 3), slice(3, 6))
        )
        if position > s.position_sigma or angle > s.angle_sigma:
            what = f"the camera's pose is uncertain by {1e3 * position:.1f} mm and {np.rad2deg(angle):.2f} degrees"
            hint = "take more views; hold the board firmly and tilt it each time in another direction"
            values: dict[str, object] = {"position_sigma_m": position, "angle_sigma_rad": angle}
            return _low_confidence(what, hint, values)
        errors = []
        for v, T_camera_board in zip(self._views, seen, strict=True):
            T = tool_pose(self._robot.chains[v.side], v.q - offsets[v.side]) @ Y[v.side]
            gap = np.linalg.inv(X @ T_camera_board) @ T
            errors.append((np.linalg.norm(gap[:3, 3]), np.linalg.norm(pin.log3(gap[:3, :3]))))
        distance, rotation = np.sqrt((np.array(errors) ** 2).mean(axis=0))
        return Outcome(
            HandEyeCalibration(
                frozen(X), {k: frozen(v) for k, v in Y.items()}, rms, scale,
                float(distance), float(rotation), position, angle, len(self._views),
            )
        )  # fmt: skip


def _scale(x: Array) -> float:
    """Return the size of the printed board relative to its drawing."""
    return float(1.0 + PRINT_SIGMA * x[-1])


def _board_pose(k: Intrinsics, view: BoardView) -> Array:
    """Compute T_camera_board (4, 4) from one image."""
    _, w, t = cv2.solvePnP(view.points(BOARD), view.pixels, k.matrix, None, flags=cv2.SOLVEPNP_IPPE)
    _, w, t = cv2.solvePnP(view.points(BOARD), view.pixels, k.matrix, None, w, t, True, cv2.SOLVEPNP_ITERATIVE)
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = _rotation(np.asarray(w, dtype=float).reshape(3)), np.asarray(t).reshape(3)
    return T


def _second_axis_spread(poses: Sequence[Array]) -> float:
    """Return the standard deviation of the poses' rotations about their second principal axis [rad] (middle
    singular value). It is near zero if the poses rotate about one axis only."""
    rotations = np.array([pin.log3(poses[0][:3, :3].T @ T[:3, :3]) for T in poses])
    s = np.linalg.svd(rotations - rotations.mean(axis=0), compute_uv=False)
    return float(s[1] / np.sqrt(len(poses)))


def _exp(twist: Array) -> Array:
    """Return the transform (4, 4) of a twist: translation twist[:3] [m] and rotation vector twist[3:] [rad], in
    the moved frame."""
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = _rotation(twist[3:]), twist[:3]
    return T


def _rotation(w: Array) -> Array:
    return np.asarray(pin.exp3(np.asarray(w, dtype=float)))


def _low_confidence(what: str, hint: str, values: dict[str, object] | None = None) -> Outcome[HandEyeCalibration]:
    return Outcome(failure=Failure(FailureKind.LOW_CONFIDENCE, what, hint, values or {}))
