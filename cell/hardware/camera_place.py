"""The place of the camera: the picture that it would take of the empty table, and the nearest place from which it
sees the table without the robot."""

from __future__ import annotations

from dataclasses import replace
from itertools import product
from typing import Any

import numpy as np
from pydantic import ValidationError

from foldcell.cell.config.cell_settings import CameraConfig, CellSettings
from foldcell.cell.hardware.camera import camera_calibration, nominal_calibration
from foldcell.cell.hardware.robot_check import PLACES_X, PLACES_Y, view_margins
from foldcell.cell.report.pictures.bare_cell import Surroundings, robot_mesh
from foldcell.cell.report.pictures.mesh_raster import Lens
from foldcell.robots.camera_mount import CameraMount, look_at
from foldcell.robots.model import RobotModel
from foldcell.robots.ports import Array, CameraFrame
from foldcell.robots.registry import find_robot
from foldcell.skills.perception.rectification.table_view import TableView
from foldcell.skills.perception.segmentation.obstruction import obstructed
from foldcell.skills.perception.settings import VIEW_PIXEL
from foldcell.skills.vocabulary import CameraCalibration, Failure, Table, frozen

AREA_X, AREA_Y = (float(PLACES_X[0]), float(PLACES_X[-1])), (-float(PLACES_Y[-1]), float(PLACES_Y[-1]))
"""Area in which garments lie, in the table frame [m]."""
LEAST_SEEN = 0.8
"""Share of the table in this area that the camera has to see."""
LEAST_VIEW_MARGIN = 0.01
"""Distance by which the parked arms have to be out of the camera's picture [m]."""
NEAREST = 0.02
"""Parts of the robot that are nearer to the camera are not drawn [m]."""
TOLERANCE = 0.08
"""Share by which the picture of a camera that is not calibrated may reach further. It covers three standard
deviations of focal length (0.8 %), centre of the picture (4 pixels), and place (2 mm and 0.15 degrees)."""
TABLE_RGB, FLOOR_RGB = (178, 172, 160), (112, 114, 118)
STEP, STEPS = 0.05, 10
"""Other places of the camera are tried in these steps [m], up to this number in each direction."""
_DIRECTIONS = (("back", "forward"), ("to the right", "to the left"), ("down", "up"))
"""Names of the directions along minus and plus x, y and z of the table."""


def expected_picture(settings: CellSettings, model: RobotModel, calibration: CameraCalibration) -> CameraFrame:
    """Return the picture of the empty table by a camera of this place and lens, with the arms parked: without
    noise, shadows and the error of the calibration."""
    robot, k, table = find_robot(settings.robot), calibration.intrinsics, settings.table
    lens = Lens((k.fx, k.fy), (k.cx, k.cy), NEAREST, 0.6, 0.4)
    above = np.array([0.0, 0.0, 1.0])
    texture = np.array([[TABLE_RGB]], np.uint8)
    surroundings = Surroundings(table, texture, model.floor, FLOOR_RGB, (k.height, k.width), lens, above)
    T_base_camera = table.T_base_table @ calibration.T_table_camera
    T_camera_base = np.ascontiguousarray(np.linalg.inv(T_base_camera))
    canvas = surroundings.draw(T_base_camera)
    joints = dict(zip(model.joint_names, map(float, model.q_park), strict=True))
    if robot.camera.head_joint is not None:
        joints[robot.camera.head_joint] = calibration.head_pan
    mesh = robot_mesh(str(robot.simulation.seen_urdf()))
    mesh.draw(canvas, T_camera_base, joints, lens, T_camera_base[:3, :3] @ above)
    return CameraFrame(0.0, 0, frozen(canvas.rgb), frozen(np.float32(1.0) / canvas.nearest), k)


def hidden_by_robot(settings: CellSettings, model: RobotModel, calibration: CameraCalibration) -> Failure | None:
    """Return the failure with which a run would refuse the picture, because head or arms reach into it; None if it
    would not. The place and lens of a camera that is not calibrated may differ by `TOLERANCE`."""
    if settings.camera.calibration is None:
        k = calibration.intrinsics
        wider = replace(k, fx=k.fx * (1.0 - TOLERANCE), fy=k.fy * (1.0 - TOLERANCE))
        calibration = replace(calibration, intrinsics=wider)
    view = TableView(calibration, settings.table, VIEW_PIXEL)
    seen = view.rectify(expected_picture(settings, model, calibration))
    return obstructed(view, seen, None, "a part of the robot")


def area_seen(calibration: CameraCalibration, table: Table) -> float:
    """Return the share (0..1) of the area where garments lie that the camera sees as table."""
    view = TableView(calibration, table, pixel=0.01)
    low, high = view.to_pixel(np.array([[AREA_X[0], AREA_Y[0]], [AREA_X[1], AREA_Y[1]]]))
    rows = slice(max(round(high[1]), 0), max(round(low[1]), 0) + 1)
    columns = slice(max(round(high[0]), 0), max(round(low[0]), 0) + 1)
    return float(np.mean(view.valid[rows, columns]))


def place_in_words(settings: CellSettings) -> str:
    """Return the place of the camera, that of the robot's own camera as drawn, and the height of the table."""
    own = nominal_calibration(find_robot(settings.robot).camera, settings.drawn_table)
    here, drawn = (
        f"{_point(T[:3, 3])}, looking at {_point(_target(T))}"
        for T in (camera_calibration(settings).T_table_camera, own.T_table_camera)
    )
    base = f"the table is {settings.table.height:+.2f} m from the robot's base"
    return f"at {here}; {base}" if here == drawn else f"at {here}; the robot's own: at {drawn}; {base}"


def place_that_fits(settings: CellSettings, model: RobotModel) -> str:
    """Return in words where the camera has to move, looking at the same point, to see the table without the robot.
    The place is the nearest that was tried."""
    calibration = camera_calibration(settings)
    eye, target = np.asarray(calibration.T_table_camera)[:3, 3], _target(calibration.T_table_camera)
    for move in _moves():
        place = eye + move
        if _may_be_stated(place, target) and _fits(settings, model, _looking(calibration, place, target)):
            words = (
                f"{abs(by):.2f} m {_DIRECTIONS[axis][int(by > 0.0)]}" for axis, by in enumerate(move) if by != 0.0
            )
            return f"the camera fits {' and '.join(words)}, at {_point(place)}, looking at {_point(target)}"
    return f"no place within {STEP * STEPS:.2f} m fits that looks at {_point(target)}"


def _may_be_stated(place: Array, target: Array) -> bool:
    """Whether the settings take this place: advice that they refuse helps nobody."""
    stated: dict[str, Any] = {
        key: tuple(np.round(p, 2).tolist()) for key, p in (("position", place), ("target", target))
    }
    unstated = dict.fromkeys(CameraConfig.model_fields)
    try:
        CameraConfig.model_validate({**unstated, "reference": "none", **stated})
    except ValidationError:
        return False
    return True


def _moves() -> list[Array]:
    """Return moves (3,) [m] along x and z and along y, the shortest first."""
    steps = STEP * np.arange(-STEPS, STEPS + 1)
    moves = [np.array([x, 0.0, z]) for x, z in product(steps, steps)] + [np.array([0.0, y, 0.0]) for y in steps]
    return sorted((move for move in moves if move.any()), key=lambda move: float(np.linalg.norm(move)))


def _fits(settings: CellSettings, model: RobotModel, calibration: CameraCalibration) -> bool:
    if area_seen(calibration, settings.table) < LEAST_SEEN:
        return False
    mount = CameraMount(calibration.intrinsics, settings.table.T_base_table @ calibration.T_table_camera)
    if min(view_margins(model, mount, model.q_park).values()) < LEAST_VIEW_MARGIN:
        return False
    return hidden_by_robot(settings, model, calibration) is None


def _looking(calibration: CameraCalibration, eye: Array, target: Array) -> CameraCalibration:
    there, at = (tuple(map(float, point)) for point in (eye, target))
    return replace(calibration, T_table_camera=frozen(look_at(there, at)))  # type: ignore[arg-type]


def _target(T_table_camera: Array) -> Array:
    """Return the point of the table in the middle of the picture (3,) [m]; the middle of the area where garments
    lie if the camera does not look down."""
    eye, axis = T_table_camera[:3, 3], T_table_camera[:3, 2]
    if eye[2] > 0.0 and axis[2] < -0.1:
        return np.asarray(eye - axis * eye[2] / axis[2])
    return np.array([np.mean(AREA_X), np.mean(AREA_Y), 0.0])


def _point(point: Array) -> str:
    return "[" + ", ".join(f"{round(float(c), 2) + 0.0:.2f}" for c in point) + "]"
