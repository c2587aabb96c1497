"""Detection of the board in projected pictures, and the camera fitted to it."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from foldcell.calibration.board import BOARD, BoardView, find_board
from foldcell.calibration.camera import calibrate_camera, fit_intrinsics
from foldcell.calibration.effects import Bring, Look, Note, Sight
from foldcell.robots.errors import FailureKind
from foldcell.robots.ports import BoardPlace, CameraFrame, Intrinsics
from foldcell.skills.vocabulary import Outcome
from tests.unit.calibration.conftest import run

K = Intrinsics(640, 480, 571.0, 583.0, 316.2, 243.9)


def pose(rng: np.random.Generator, lean: float = 0.8) -> np.ndarray:
    """(4, 4) pose of the board in the camera frame, in view."""
    T = np.eye(4)
    T[:3, 3] = rng.uniform(0.45, 0.75) * np.array([rng.uniform(-0.2, 0.2), rng.uniform(-0.14, 0.14), 1.0])
    about = rng.uniform(0, 2 * np.pi)
    T[:3, :3] = cv2.Rodrigues(lean * np.sqrt(rng.random()) * np.array([np.cos(about), np.sin(about), 0.0]))[0]
    return T


def projected(T: np.ndarray, noise: float, rng: np.random.Generator, radial: float = 0.0) -> BoardView:
    p = BOARD.corners @ T[:3, :3].T + T[:3, 3]
    xy = p[:, :2] / p[:, 2:]
    xy = xy * (1.0 + radial * (xy**2).sum(axis=1, keepdims=True))
    uv = xy * [K.fx, K.fy] + [K.cx, K.cy] + noise * rng.standard_normal((len(p), 2))
    seen = ((uv >= 0) & (uv < [K.width, K.height])).all(axis=1)
    return BoardView(np.flatnonzero(seen), uv[seen], K.width, K.height)


def painted(T: np.ndarray) -> np.ndarray:
    """(480, 640, 3) picture of the board through a pinhole camera. OpenCV's pixel centres have integer
    coordinates."""
    scale, fine = 4000, 3
    card = BOARD.image(scale)
    w, h = BOARD.size
    to_metres = np.array([[1 / scale, 0, 0.5 / scale - w / 2], [0, 1 / scale, 0.5 / scale - h / 2], [0, 0, 1]])
    to_fine = np.array([[fine, 0, 0.5 * fine - 0.5], [0, fine, 0.5 * fine - 0.5], [0, 0, 1]])
    H = to_fine @ K.matrix @ np.column_stack((T[:3, 0], T[:3, 1], T[:3, 3])) @ to_metres
    big = cv2.warpPerspective(card, H, (fine * K.width, fine * K.height), borderValue=110, flags=cv2.INTER_AREA)
    return cv2.cvtColor(cv2.resize(big, (K.width, K.height), interpolation=cv2.INTER_AREA), cv2.COLOR_GRAY2RGB)


def test_corners_are_found_where_a_pinhole_projects_them() -> None:
    for seed in range(6):
        T = pose(np.random.default_rng(seed))
        view = find_board(painted(T))
        assert view is not None and len(view.index) >= 20
        expected = projected(T, 0.0, np.random.default_rng(0))
        where = dict(zip(expected.index.tolist(), expected.pixels, strict=True))
        off = np.array([p - where[k] for k, p in zip(view.index.tolist(), view.pixels, strict=True)])
        assert np.sqrt((off**2).sum(axis=1).mean()) < 0.15 and np.abs(off.mean(axis=0)).max() < 0.06


def test_a_partly_visible_board_is_identified_by_its_markers() -> None:
    T = pose(np.random.default_rng(1), lean=0.2)
    T[0, 3] += 0.17
    view = find_board(painted(T))
    assert view is not None and 6 <= len(view.index) < 24
    expected = projected(T, 0.0, np.random.default_rng(0))
    assert set(view.index.tolist()) <= set(expected.index.tolist())


@pytest.mark.parametrize("shade", [0, 110, 255])
def test_a_picture_without_a_board_gives_no_view(shade: int) -> None:
    assert find_board(np.full((480, 640, 3), shade, np.uint8)) is None


def test_the_board_in_the_hand_faces_along_minus_y_below_the_tips() -> None:
    T = BOARD.T_tool_board
    assert np.allclose(T[:3, :3] @ T[:3, :3].T, np.eye(3)) and np.linalg.det(T[:3, :3]) == pytest.approx(1.0)
    assert T[:3, :3] @ [0, 0, -1] == pytest.approx([0, -1, 0])  # the front of the board
    lower_edge = T @ [0.0, BOARD.size[1] / 2, 0.0, 1.0]
    assert lower_edge[:3] == pytest.approx([0.0, 0.0, BOARD.tab])


def views(count: int, noise: float, seed: int = 0, lean: float = 0.8, radial: float = 0.0) -> list[BoardView]:
    rng = np.random.default_rng(seed)
    return [projected(pose(rng, lean), noise, rng, radial) for _ in range(count)]


def test_the_camera_is_found_within_its_own_standard_deviations() -> None:
    off = []
    for seed in range(8):
        c = fit_intrinsics(views(20, 0.1, seed)).unwrap()
        i = c.intrinsics
        off += [(i.fx - K.fx) / c.sigma[0], (i.fy - K.fy) / c.sigma[1], (i.cx - K.cx) / c.sigma[2]]
        assert c.rms == pytest.approx(0.1 * np.sqrt(2), rel=0.2) and abs(i.fx - K.fx) < 4.0
    assert 0.5 < np.sqrt(np.mean(np.square(off))) < 1.6


@pytest.mark.parametrize(
    ("shown", "word"),
    [
        (lambda: views(20, 0.1, lean=0.02), "alike"),
        (lambda: views(20, 2.0), "miss"),
        (lambda: views(20, 0.1, radial=-0.08), "pinhole"),
    ],
)
def test_views_that_give_no_camera_are_refused(shown, word: str) -> None:
    refused = fit_intrinsics(shown()).failure
    assert refused and refused.kind is FailureKind.LOW_CONFIDENCE and word in refused.what and refused.hint


def parallel(count: int, lean: float, seed: int, moved: bool = True) -> list[BoardView]:
    """Views of boards that all have the same orientation, at one place or at different places."""
    rng = np.random.default_rng(seed)
    turned = pose(rng)
    about = rng.uniform(0, 2 * np.pi)
    turned[:3, :3] = cv2.Rodrigues(lean * np.array([np.cos(about), np.sin(about), 0.0]))[0]
    out = []
    for _ in range(count):
        T = turned.copy()
        T[:3, 3] = pose(rng)[:3, 3] if moved else T[:3, 3]
        out.append(projected(T, 0.1, rng))
    return out


@pytest.mark.parametrize("seed", range(2))
@pytest.mark.parametrize(("lean", "moved"), [(0.2, True), (0.4, True), (0.7, True), (0.5, False)])
def test_boards_with_equal_orientations_give_no_camera(lean: float, moved: bool, seed: int) -> None:
    refused = fit_intrinsics(parallel(20, lean, seed, moved)).failure
    assert refused and refused.kind is FailureKind.LOW_CONFIDENCE and "alike" in refused.what
    # every focal length fits these views, so the standard deviation must be large
    assert max(refused.values["sigma_px"]) > 30.0


def sight(picture: np.ndarray) -> Outcome:
    frame = CameraFrame(0.0, 1, picture, np.ones((480, 640), np.float32), K)
    return Outcome(Sight(frame, np.zeros(14)))


def test_the_procedure_asks_for_the_board_until_it_has_its_views() -> None:
    pictures = [painted(pose(np.random.default_rng(k))) for k in range(7)]
    pictures[2] = np.zeros_like(pictures[0])
    stack = iter(pictures)
    outcome, asked = run(calibrate_camera(6), {Look: lambda _: sight(next(stack))})
    c = outcome.unwrap()
    assert c.views == 6 and abs(c.intrinsics.fx - K.fx) < 4 * c.sigma[0] + 1.0
    places = [e.place for e in asked if isinstance(e, Bring)]
    assert places == [BoardPlace.SHOWN] * 7 + [BoardPlace.AWAY]
    assert sum(isinstance(e, Note) and e.picture is not None for e in asked) == 7


def test_a_board_that_is_never_seen_ends_the_calibration_as_out_of_view() -> None:
    dark = sight(np.zeros((480, 640, 3), np.uint8))
    outcome, asked = run(calibrate_camera(5), {Look: lambda _: dark})
    assert outcome.failure and outcome.failure.kind is FailureKind.OUT_OF_VIEW and outcome.failure.hint
    assert sum(isinstance(e, Look) for e in asked) == 10
