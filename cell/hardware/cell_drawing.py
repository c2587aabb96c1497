"""Draw a cell from above, from its side and as its camera sees it: the table, the camera's view, the reach of the
hands, the parked arms, and a garment if one is given."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from foldcell.cell.config.cell_settings import CellSettings
from foldcell.cell.hardware.camera import camera_calibration
from foldcell.cell.hardware.camera_place import expected_picture
from foldcell.cell.hardware.placement import Pose
from foldcell.cell.hardware.robot_check import moved_shapes, reached_places
from foldcell.cell.report.camera_pictures.projected_drawing import ProjectedDrawing
from foldcell.robots.model import RobotModel
from foldcell.robots.ports import Array, Side
from foldcell.skills.fold_plan.folding import silhouette
from foldcell.skills.fold_plan.plan import plan_folds
from foldcell.skills.garments.garment import Garment

SCALE = 420.0
"""Pixels per metre."""
PAD, HEAD = 40, 96
CAMERA_WIDTH = 640
"""Width of the camera's picture in the drawing [px]."""
_INK, _PAPER, _TABLE = (40, 44, 52), (255, 255, 255), (232, 224, 210)
_SEEN, _ARM, _CLOTH = (36, 110, 200), (150, 156, 166), (176, 208, 240)
_REACHED, _MISSED, _FOLD = (36, 140, 60), (208, 52, 44), (150, 70, 190)
_FONT = cv2.FONT_HERSHEY_SIMPLEX


def draw_cell(
    settings: CellSettings,
    model: RobotModel,
    garment: Garment | None = None,
    pose: Pose | None = None,
    lines: Sequence[str] = (),
) -> NDArray[np.uint8]:
    """Return an (H, W, 3) RGB picture: on the left the cell from above, the robot at the bottom; in the middle
    from its side, the robot on the left; on the right the picture of the camera. lines: findings, which are
    written below."""
    panels = (
        _above(settings, model, garment, pose),
        _beside(settings, model),
        _by_its_camera(settings, model, garment, pose),
    )
    height = max(panel.shape[0] for panel in panels)
    picture = np.hstack([
        cv2.copyMakeBorder(panel, 0, height - panel.shape[0], 0, 0, cv2.BORDER_CONSTANT, value=_PAPER)
        for panel in panels
    ])  # fmt: skip
    words = np.full((24 * len(lines) + 16, picture.shape[1], 3), 255, np.uint8)
    for i, line in enumerate(lines):
        colour = _MISSED if line.startswith("BAD") else _INK
        cv2.putText(words, line, (PAD, 24 + 24 * i), _FONT, 0.5, colour, 1, cv2.LINE_AA)
    return np.ascontiguousarray(np.vstack([picture, words]))


def _above(
    settings: CellSettings, model: RobotModel, garment: Garment | None, pose: Pose | None
) -> NDArray[np.uint8]:
    table = settings.table
    picture, to_pixels = _sheet((-table.y[1] - 0.2, -0.35), (-table.y[0] + 0.2, table.x[1] + 0.15))

    def pixel(xy: Array) -> NDArray[np.int32]:  # table x points up, table y to the left
        return to_pixels(-xy[..., 1], xy[..., 0])

    corners = np.array([[table.x[i], table.y[j]] for i, j in ((0, 0), (1, 0), (1, 1), (0, 1))])
    _board(picture, pixel(corners))
    for points in _arms(model, table.height):
        _hull(picture, pixel(points[:, :2]))
    seen = _seen_corners(settings)
    if seen is not None:
        cv2.polylines(picture, [pixel(seen)], True, _SEEN, 2, cv2.LINE_AA)
    for side, places in reached_places(model, table).items():
        for x, y, reached in places:
            at = tuple(int(v) for v in pixel(np.array([x, y])))
            colour, filled = _REACHED if reached else _MISSED, -1 if side is Side.LEFT else 2
            cv2.circle(picture, at, 4, colour, filled, cv2.LINE_AA)
    if garment is not None and pose is not None:
        _draw_garment(picture, pixel, garment, pose)
    camera = np.asarray(camera_calibration(settings).T_table_camera)[:2, 3]
    cv2.drawMarker(picture, tuple(int(v) for v in pixel(camera)), _SEEN, cv2.MARKER_TILTED_CROSS, 14, 2)
    _legend(picture, "the cell from above", [
        ("in the camera's picture, x: the camera", _SEEN), ("a hand reaches", _REACHED), ("it does not", _MISSED),
        ("parked arms", _ARM), *([(f"{garment.name} and its folds", _FOLD)] if garment is not None else []),
    ])  # fmt: skip
    return picture


def _draw_garment(
    picture: NDArray[np.uint8], pixel: Callable[[Array], NDArray[np.int32]], garment: Garment, pose: Pose
) -> None:
    state = garment.flat_state(*pose)
    outline = np.asarray(state.contour)
    layer = picture.copy()
    cv2.fillPoly(layer, [pixel(outline)], _CLOTH)
    cv2.addWeighted(layer, 0.7, picture, 0.3, 0.0, picture)
    cv2.polylines(picture, [pixel(outline)], True, _INK, 2, cv2.LINE_AA)
    planned = plan_folds(state, garment)
    if planned.failure is not None:
        return
    for step in planned.unwrap():
        after = silhouette((*step.earlier, step.line), outline)
        cv2.polylines(picture, [pixel(np.asarray(after))], True, _FOLD, 1, cv2.LINE_AA)
        for grasp_id, grasp in step.grasps.items():
            start, end = pixel(grasp.point), pixel(np.asarray(step.targets[grasp_id])[:2])
            cv2.arrowedLine(picture, tuple(map(int, start)), tuple(map(int, end)), _FOLD, 2, cv2.LINE_AA, 0, 0.06)


def _beside(settings: CellSettings, model: RobotModel) -> NDArray[np.uint8]:
    table = settings.table
    T = np.asarray(camera_calibration(settings).T_table_camera)
    picture, to_pixels = _sheet((-0.35, -0.35), (table.x[1] + 0.15, max(float(T[2, 3]) + 0.15, 1.0)))

    def pixel(xz: Array) -> NDArray[np.int32]:
        return to_pixels(xz[..., 0], xz[..., 1])

    board = np.array([[table.x[0], 0.0], [table.x[1], 0.0], [table.x[1], -0.03], [table.x[0], -0.03]])
    for points in _arms(model, table.height):
        _hull(picture, pixel(points[:, [0, 2]]))
    _board(picture, pixel(board))
    camera = T[[0, 2], 3]
    seen = _seen_corners(settings)
    if seen is not None:
        for x in (seen[:, 0].min(), seen[:, 0].max()):
            end = pixel(np.array([x, 0.0]))
            cv2.line(picture, tuple(map(int, pixel(camera))), tuple(map(int, end)), _SEEN, 2, cv2.LINE_AA)
    cv2.drawMarker(picture, tuple(map(int, pixel(camera))), _SEEN, cv2.MARKER_TILTED_CROSS, 14, 2)
    _legend(picture, f"from its side, table {table.height:+.2f} m from the robot's base", [
        ("in the camera's picture, x: the camera", _SEEN), ("parked arms", _ARM),
    ])  # fmt: skip
    return picture


def _by_its_camera(
    settings: CellSettings, model: RobotModel, garment: Garment | None, pose: Pose | None
) -> NDArray[np.uint8]:
    calibration = camera_calibration(settings)
    frame = expected_picture(settings, model, calibration)
    drawing = ProjectedDrawing(frame, calibration, CAMERA_WIDTH / calibration.intrinsics.width)
    if garment is not None and pose is not None:
        drawing.line(np.asarray(garment.flat_state(*pose).contour), _CLOTH, closed=True)
    edges = HEAD, PAD, PAD, PAD
    picture = cv2.copyMakeBorder(drawing.picture, *edges, cv2.BORDER_CONSTANT, value=_PAPER)
    framed = np.ascontiguousarray(picture, dtype=np.uint8)
    _legend(framed, "by its camera", [("parked arms, head and table, without the camera's errors", _ARM)])
    return framed


def _sheet(
    low: tuple[float, float], high: tuple[float, float]
) -> tuple[NDArray[np.uint8], Callable[[Array, Array], NDArray[np.int32]]]:
    """Return a white picture of what lies between two corners, to the right and up [m], and the function from such
    coordinates to its pixels."""
    width, height = (round((b - a) * SCALE) for a, b in zip(low, high, strict=True))
    picture = np.full((height + PAD + HEAD, width + 2 * PAD, 3), 255, np.uint8)

    def to_pixels(right: Array, up: Array) -> NDArray[np.int32]:
        at = np.stack([PAD + (right - low[0]) * SCALE, HEAD + (high[1] - up) * SCALE], -1)
        return np.round(at).astype(np.int32)

    return picture, to_pixels


def _board(picture: NDArray[np.uint8], corners: NDArray[np.int32]) -> None:
    cv2.fillPoly(picture, [corners], _TABLE)
    cv2.polylines(picture, [corners], True, _INK, 1, cv2.LINE_AA)


def _arms(model: RobotModel, table_height: float) -> list[Array]:
    """Return the points (n, 3) of each shape of the parked arms in the table frame [m]."""
    shapes = moved_shapes(model, model.q_park)
    return [points - (0.0, 0.0, table_height) for points in shapes.values()]


def _hull(picture: NDArray[np.uint8], points: NDArray[np.int32]) -> None:
    hull = cv2.convexHull(points)
    cv2.fillPoly(picture, [hull], _ARM)
    cv2.polylines(picture, [hull], True, _PAPER, 1, cv2.LINE_AA)


def _seen_corners(settings: CellSettings) -> Array | None:
    """Return where the lines of sight of the picture's corners meet the table (4, 2) [m]; None if one does not."""
    calibration = camera_calibration(settings)
    k, T = calibration.intrinsics, np.asarray(calibration.T_table_camera)
    corners = np.array([[0, 0], [k.width - 1, 0], [k.width - 1, k.height - 1], [0, k.height - 1]], dtype=float)
    rays = np.column_stack([(corners - (k.cx, k.cy)) / (k.fx, k.fy), np.ones(4)]) @ T[:3, :3].T
    if (rays[:, 2] > -1e-3).any():
        return None
    return np.asarray(T[:2, 3] - rays[:, :2] * (T[2, 3] / rays[:, 2])[:, None])


def _legend(picture: NDArray[np.uint8], title: str, entries: Sequence[tuple[str, tuple[int, int, int]]]) -> None:
    cv2.putText(picture, title, (PAD, 26), _FONT, 0.6, _INK, 1, cv2.LINE_AA)
    x, y = PAD, 50
    for text, colour in entries:
        width = cv2.getTextSize(text, _FONT, 0.42, 1)[0][0] + 40
        if x + width > picture.shape[1] and x > PAD:
            x, y = PAD, y + 20
        cv2.rectangle(picture, (x, y - 8), (x + 12, y + 2), colour, -1)
        cv2.putText(picture, text, (x + 18, y + 2), _FONT, 0.42, _INK, 1, cv2.LINE_AA)
        x += width
