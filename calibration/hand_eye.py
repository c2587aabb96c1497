"""Where the camera hangs in the base frame, from pictures of the board in each hand in many poses.

The camera stands still and the board moves with the hand: T_base_tool(i) Y = X T_camera_board(i) for every picture
i, with X = T_base_camera and Y = T_tool_board unknown (the robot-world / hand-eye problem). A closed form starts
it (rotations by singular values of the Kronecker product, after Shah, J. Mech. Robot. 5(3), 2013; then
translations by linear least squares); Gauss-Newton on the corners' reprojection finishes it. Both hands share X.
The joints' zeros are off by a milliradian or so, which no picture of one pose can tell: they are estimated
beside X and Y, held to zero by a prior.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import cv2
import numpy as np
import pinocchio as pin
from scipy.optimize import least_squares

from calibration.board import BOARD, Board, BoardView, draw_view, find_board
from calibration.effects import Procedure, bring, grip, look, note, reach
from robots.model import RobotModel
from robots.ports import Array, BoardPlace, Intrinsics, Side, arm_slice, frozen
from skills.motion.kinematics.ik import tool_pose
from skills.vocabulary import CameraCalibration, Failure, FailureKind, Outcome, Table

__all__ = [
    "HandEyeCalibration",
    "HandEyeSettings",
    "HandView",
    "board_poses",
    "calibrate_hand_eye",
    "closed_form",
    "fit_hand_eye",
]

PLACES = {Side.LEFT: BoardPlace.LEFT_HAND, Side.RIGHT: BoardPlace.RIGHT_HAND}
FEWEST_VIEWS = 4
"""In each hand: three motions about two axes are the least; one more shows an error."""


@dataclass(frozen=True)
class HandEyeSettings:
    """views: in each hand. tries: poses for each of them, at most. Lengths [m], angles [rad]."""

    views: int = 12
    tries: float = 4.0
    fewest_corners: int = 10
    lean: float = 0.6
    """Of the board away from facing the camera."""
    turn: tuple[float, float] = (0.4, 1.6)
    """Of the card's lower edge from towards the robot (0) to towards the hand's side (pi / 2)."""
    grip_force: float = 15.0
    corner_sigma: float = 0.15
    """Of one found corner [px]."""
    joint_sigma: float = 0.0015
    """Of the joints' zeros: what the arms' stated accuracy of 5 mm comes to."""
    focal_sigma: float = 0.002
    """How well the intrinsics are known: focal lengths, as a share,"""
    centre_sigma: float = 0.7
    """and the centre [px];"""
    print_sigma: float = 0.0005
    """and the board's print, as a share."""
    rms: float = 1.5
    """Reprojection error above which intrinsics, board or arms are not what they are taken for [px]."""
    position_sigma: float = 0.004
    angle_sigma: float = float(np.deg2rad(0.3))

    @classmethod
    def with_lens_of_data_sheet(cls, views: int) -> HandEyeSettings:
        """For intrinsics that nobody measured: a field of view in whole degrees, the centre anywhere near the
        middle. The pose then takes up the lens's error and is that much less sure."""
        return cls(
            views, focal_sigma=0.01, centre_sigma=5.0, position_sigma=0.020, angle_sigma=float(np.deg2rad(1.5))
        )

    def __post_init__(self) -> None:
        if self.views < FEWEST_VIEWS:
            raise ValueError(f"{self.views} views: hand-eye takes {FEWEST_VIEWS} or more in each hand")


@dataclass(frozen=True, eq=False)
class HandView:
    """One picture of the board in a hand. q: (7,) of that arm [rad]."""

    side: Side
    q: Array
    view: BoardView


@dataclass(frozen=True, eq=False)
class HandEyeCalibration:
    """T_base_camera (4, 4); T_tool_board (4, 4) by hand. rms: reprojection error [px]. position, angle: how far
    the board stood in each view from where arm and camera together have it, root of mean squares [m], [rad].
    position_sigma [m], angle_sigma [rad]: standard deviation of the camera's pose, its worst axis: from the
    corners, the joints' zeros, how well the intrinsics and the board's print are known, how well the views agree.
    joint_offsets: (7,) by hand, that the fit took from the joints' readings [rad]."""

    T_base_camera: Array
    T_tool_board: Mapping[Side, Array]
    rms: float
    position: float
    angle: float
    position_sigma: float
    angle_sigma: float
    joint_offsets: Mapping[Side, Array]
    views: int


def calibrate_hand_eye(
    robot: RobotModel,
    camera: CameraCalibration,
    table: Table,
    settings: HandEyeSettings | None = None,
    board: Board = BOARD,
) -> Procedure[HandEyeCalibration]:
    """Show the camera the board in each hand in many poses; then solve.

    camera: as believed now: it says where to hold the board, and gives the intrinsics. Failures: UNREACHABLE (no
    pose to take the board in), OUT_OF_VIEW (too few pictures show it), and those of `fit_hand_eye`.
    """
    settings = settings or HandEyeSettings()
    T_base_camera = table.T_base_table @ camera.T_table_camera
    views: list[HandView] = []
    for side in Side:
        found = yield from _views_in(side, T_base_camera, settings, board)
        if found.failure:
            return Outcome(failure=found.failure)
        views += found.unwrap()
    return fit_hand_eye(robot, camera.intrinsics, views, settings, board)


def _views_in(
    side: Side, T_base_camera: Array, settings: HandEyeSettings, board: Board
) -> Procedure[tuple[HandView, ...]]:
    """Take the board in one hand, hold it before the camera in many poses, give it back."""
    poses = board_poses(side, T_base_camera, settings)
    views: list[HandView] = []
    holding = False
    for T_base_board in poses:
        if len(views) == settings.views:
            break
        reached = yield from reach(side, T_base_board @ np.linalg.inv(board.T_tool_board))
        if reached.failure:  # nothing has moved: another pose
            continue
        if not holding:
            yield from grip(side, 0.02, settings.grip_force)
            asked = yield from bring(PLACES[side])
            if asked.failure:
                return Outcome(failure=asked.failure)
            yield from grip(side, 0.0, settings.grip_force)
            holding = True
        sight = yield from look()
        if sight.failure:
            return Outcome(failure=sight.failure)
        rgb, n = sight.unwrap().frame.rgb, len(views) + 1
        view = find_board(rgb, board)
        if view is None or len(view.index) < settings.fewest_corners:
            yield from note(f"{side} hand: a pose left out, {0 if view is None else len(view.index)} corners")
            continue
        views.append(HandView(side, frozen(sight.unwrap().q[arm_slice(side)]), view))
        yield from note(
            f"{side} hand, view {n} of {settings.views}: {len(view.index)} corners",
            draw_view(rgb, view), f"board-{side}-{n:02}",
        )  # fmt: skip
    if not holding:
        what = f"the {side} hand reaches none of {len(poses)} poses before the camera"
        return Outcome(failure=Failure(FailureKind.UNREACHABLE, what, "clear the table's surroundings"))
    taken = yield from bring(BoardPlace.AWAY)  # before the hand lets go: it would fall
    if taken.failure:
        return Outcome(failure=taken.failure)
    yield from grip(side, 0.02, settings.grip_force)
    if len(views) < settings.views:
        what = f"the board was seen in {len(views)} poses of the {side} hand; {settings.views} are needed"
        hint = "see that the whole card is printed side up and lit; or ask for fewer with --views"
        return Outcome(failure=Failure(FailureKind.OUT_OF_VIEW, what, hint, {"views": len(views)}))
    return Outcome(tuple(views))


def board_poses(side: Side, T_base_camera: Array, settings: HandEyeSettings) -> tuple[Array, ...]:
    """(4, 4) poses of the board in the base frame that a hand may hold it in, always the same ones.

    Spread over the view, the front to the camera give or take the lean; the card's lower edge, by which it is
    held, towards the hand's side of the cell: where the arm has room behind it.
    """
    rng = np.random.default_rng(11)
    sign = 1.0 if side is Side.LEFT else -1.0
    poses = []
    for _ in range(round(settings.tries * settings.views)):
        centre = np.array([rng.uniform(0.42, 0.76), sign * rng.uniform(-0.02, 0.26), rng.uniform(0.10, 0.42)])
        towards = rng.uniform(*settings.turn)
        lean = settings.lean * np.sqrt(rng.random())
        about = rng.uniform(0.0, 2 * np.pi)
        into = centre - T_base_camera[:3, 3]
        z = into / np.linalg.norm(into)
        y = np.array([-np.cos(towards), sign * np.sin(towards), 0.0])  # down the card
        y -= (y @ z) * z
        y /= np.linalg.norm(y)
        T = np.eye(4)
        T[:3, :3] = np.column_stack((np.cross(y, z), y, z))
        T[:3, :3] = T[:3, :3] @ _rotation(lean * np.array([np.cos(about), np.sin(about), 0.0]))
        T[:3, 3] = centre
        poses.append(frozen(T))
    return tuple(poses)


def closed_form(A: Sequence[Array], B: Sequence[Array]) -> tuple[Array, Array]:
    """X, Y (4, 4) with A_i Y = X B_i for poses A, B (n, 4, 4), n >= 3, about two axes or more.

    R_A Y_R = X_R R_B: (R_B kron R_A) vec(Y_R) = vec(X_R), so sum_i R_B kron R_A has vec(Y_R), vec(X_R) as its
    first singular vectors (Shah 2013); then R_A t_Y - t_X = X_R t_B - t_A is linear.
    """
    K = np.sum([np.kron(b[:3, :3], a[:3, :3]) for a, b in zip(A, B, strict=True)], axis=0)
    U, _, Vt = np.linalg.svd(K)
    X, Y = np.eye(4), np.eye(4)
    X[:3, :3], Y[:3, :3] = (_nearest_rotation(v.reshape(3, 3, order="F")) for v in (U[:, 0], Vt[0]))
    M = np.vstack([np.hstack((-np.eye(3), a[:3, :3])) for a in A])
    rhs = np.concatenate([X[:3, :3] @ b[:3, 3] - a[:3, 3] for a, b in zip(A, B, strict=True)])
    t = np.linalg.lstsq(M, rhs, rcond=None)[0]
    X[:3, 3], Y[:3, 3] = t[:3], t[3:]
    return X, Y


def fit_hand_eye(
    robot: RobotModel,
    intrinsics: Intrinsics,
    views: Sequence[HandView],
    settings: HandEyeSettings | None = None,
    board: Board = BOARD,
) -> Outcome[HandEyeCalibration]:
    """The camera's pose from the views of one or both hands.

    Fails with LOW_CONFIDENCE: too few views, poses too much alike, corners that no camera pose explains.
    """
    settings = settings or HandEyeSettings()
    sides = tuple(side for side in Side if any(v.side is side for v in views))
    if not sides or min(sum(v.side is side for v in views) for side in sides) < FEWEST_VIEWS:
        return _doubt(
            f"{len(views)} views do not give the camera's pose", "take more views", {"views": len(views)}
        )
    seen = [_board_pose(intrinsics, v.view, board) for v in views]
    starts = {}
    for side in sides:
        A = [tool_pose(robot.chains[side], v.q) for v in views if v.side is side]
        B = [T for v, T in zip(views, seen, strict=True) if v.side is side]
        if _axes(A) < np.deg2rad(3.0):
            what = f"the {side} hand's poses turn about one axis only"
            return _doubt(what, "hold the board leaning, each time another way")
        starts[side] = closed_form(A, B)
    X = next(iter(starts.values()))[0]
    Y = {side: start[1] for side, start in starts.items()}
    problem = _Problem(robot, intrinsics, tuple(views), sides, X, Y, settings, board)
    fit = least_squares(problem.residuals, np.zeros(problem.size), method="lm")
    return problem.judged(fit.x, fit.jac, seen)


class _Problem:
    """The unknowns as one vector: a twist on X, then for each hand a twist on Y and seven joint offsets."""

    def __init__(
        self,
        robot: RobotModel,
        intrinsics: Intrinsics,
        views: tuple[HandView, ...],
        sides: tuple[Side, ...],
        X: Array,
        Y: Mapping[Side, Array],
        settings: HandEyeSettings,
        board: Board,
    ) -> None:
        self._robot, self._k, self._views, self._sides = robot, intrinsics, views, sides
        self._X, self._Y, self._settings, self._board = X, Y, settings, board
        self.size = 6 + 13 * len(sides)

    def _parts(self, x: Array) -> tuple[Array, dict[Side, Array], dict[Side, Array]]:
        Y, offsets = {}, {}
        for i, side in enumerate(self._sides):
            part = x[6 + 13 * i : 19 + 13 * i]
            Y[side] = self._Y[side] @ _exp(part[:6])
            offsets[side] = part[6:] * self._settings.joint_sigma
        return self._X @ _exp(x[:6]), Y, offsets

    def _misses(self, x: Array, lens: Array | None = None) -> Array:
        """(m, 2) found less expected corner [px], all views. lens: (5,) what camera and board are more than they
        are taken for: focal lengths (shares), centre [px], print (share)."""
        fx, fy, cx, cy, size = np.zeros(5) if lens is None else lens
        X, Y, offsets = self._parts(x)
        T_camera_base = np.linalg.inv(X)
        out = []
        for v in self._views:
            T = T_camera_base @ tool_pose(self._robot.chains[v.side], v.q - offsets[v.side]) @ Y[v.side]
            p = (1.0 + size) * v.view.points(self._board) @ T[:3, :3].T + T[:3, 3]
            k = self._k
            scale = [(1.0 + fx) * k.fx, (1.0 + fy) * k.fy]
            uv = p[:, :2] / np.maximum(p[:, 2:], 1e-3) * scale + [k.cx + cx, k.cy + cy]
            out.append(v.view.pixels - uv)
        return np.vstack(out)

    def residuals(self, x: Array) -> Array:
        misses = self._misses(x).ravel() / self._settings.corner_sigma
        offsets = np.concatenate([x[12 + 13 * i : 19 + 13 * i] for i in range(len(self._sides))])
        return np.concatenate([misses, offsets])

    def _drawn_along(self, x: Array, gain: Array) -> Array:
        """(size, 5) how far a standard deviation of each figure of lens and print draws the unknowns along."""
        s, columns = self._settings, []
        for i, sigma in enumerate((s.focal_sigma, s.focal_sigma, s.centre_sigma, s.centre_sigma, s.print_sigma)):
            lens = np.zeros(5)
            lens[i] = sigma
            change = (self._misses(x, lens) - self._misses(x)).ravel() / s.corner_sigma
            columns.append(gain[:, : len(change)] @ change)
        return np.column_stack(columns)

    def _drawn_by_views(self, x: Array, J: Array, inverse: Array) -> Array:
        """(size, views) how far each view draws the unknowns along. All corners of a view err together, by a joint
        that was read wrongly or a board that slipped in the hand: the views, not the corners, are the independent
        looks (Liang and Zeger, Biometrika 73(1), 1986)."""
        misses = self.residuals(x)
        ends = np.cumsum([2 * len(v.view.index) for v in self._views])
        parts = (slice(a, b) for a, b in zip([0, *ends[:-1]], ends, strict=True))
        drawn = np.column_stack([inverse @ (J[part].T @ misses[part]) for part in parts])
        return np.asarray(drawn * np.sqrt(len(ends) / (len(ends) - 1.0)))

    def judged(self, x: Array, J: Array, seen: Sequence[Array]) -> Outcome[HandEyeCalibration]:
        s = self._settings
        rms = float(np.sqrt((self._misses(x) ** 2).sum(axis=1).mean()))
        if rms > s.rms:
            what = f"the corners miss the fit by {rms:.2f} px"
            hint = "calibrate the camera's intrinsics first (calibrate camera); see that the board is held fast"
            return _doubt(what, hint, {"rms_px": rms})
        X, Y, offsets = self._parts(x)
        # What the model leaves out widens the figure: by how much more the corners miss than they should, and by
        # what single views draw the fit along.
        inverse = np.asarray(np.linalg.pinv(J.T @ J), dtype=np.float64)
        taken = self._drawn_along(x, inverse @ J.T)
        drawn = self._drawn_by_views(x, J, inverse)
        variance = inverse * max(1.0, (rms / s.corner_sigma) ** 2 / 2) + taken @ taken.T + drawn @ drawn.T
        position, angle = (
            float(np.sqrt(np.linalg.eigvalsh(variance[c, c])[-1])) for c in (slice(0, 3), slice(3, 6))
        )
        if position > s.position_sigma or angle > s.angle_sigma:
            what = f"the poses leave the camera open by {1e3 * position:.1f} mm, {np.rad2deg(angle):.2f} degrees"
            values: dict[str, object] = {"position_sigma_m": position, "angle_sigma_rad": angle}
            return _doubt(what, "take more views, the board held fast and leaning each time another way", values)
        off = []
        for v, T_camera_board in zip(self._views, seen, strict=True):
            T = tool_pose(self._robot.chains[v.side], v.q - offsets[v.side]) @ Y[v.side]
            gap = np.linalg.inv(X @ T_camera_board) @ T
            off.append((np.linalg.norm(gap[:3, 3]), np.linalg.norm(pin.log3(gap[:3, :3]))))
        mm, rad = np.sqrt((np.array(off) ** 2).mean(axis=0))
        return Outcome(
            HandEyeCalibration(
                frozen(X), {k: frozen(v) for k, v in Y.items()}, rms, float(mm), float(rad), position, angle,
                {k: frozen(v) for k, v in offsets.items()}, len(self._views),
            )
        )  # fmt: skip


def _board_pose(k: Intrinsics, view: BoardView, board: Board) -> Array:
    """T_camera_board (4, 4) from one picture."""
    _, w, t = cv2.solvePnP(view.points(board), view.pixels, k.matrix, None, flags=cv2.SOLVEPNP_IPPE)
    _, w, t = cv2.solvePnP(view.points(board), view.pixels, k.matrix, None, w, t, True, cv2.SOLVEPNP_ITERATIVE)
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = _rotation(np.asarray(w, dtype=float).reshape(3)), np.asarray(t).reshape(3)
    return T


def _axes(poses: Sequence[Array]) -> float:
    """How far poses turn about a second axis [rad]: of their turns' singular values the middle one, as a
    standard deviation."""
    turns = np.array([pin.log3(poses[0][:3, :3].T @ T[:3, :3]) for T in poses])
    s = np.linalg.svd(turns - turns.mean(axis=0), compute_uv=False)
    return float(s[1] / np.sqrt(len(poses)))


def _exp(twist: Array) -> Array:
    """(4, 4): shift twist[:3] [m] and turn twist[3:] [rad], in the moved frame's own axes."""
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = _rotation(twist[3:]), twist[:3]
    return T


def _rotation(w: Array) -> Array:
    return np.asarray(pin.exp3(np.asarray(w, dtype=float)))


def _nearest_rotation(M: Array) -> Array:
    """Of a matrix that is a rotation but for a factor of either sign."""
    M = M * np.sign(np.linalg.det(M))
    U, _, Vt = np.linalg.svd(M)
    return np.asarray(U @ np.diag([1.0, 1.0, np.linalg.det(U @ Vt)]) @ Vt)


def _doubt(what: str, hint: str, values: dict[str, object] | None = None) -> Outcome[HandEyeCalibration]:
    return Outcome(failure=Failure(FailureKind.LOW_CONFIDENCE, what, hint, values or {}))
