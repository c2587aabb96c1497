"""Check before anything moves that the parts of a cell fit each other: table, parked arms, camera and reach."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from foldcell.cell.config.cell_settings import CellSettings
from foldcell.cell.config.deciding_setting import overriding_file
from foldcell.cell.hardware.camera import camera_calibration, camera_mount
from foldcell.cell.hardware.camera_place import (
    AREA_X,
    AREA_Y,
    LEAST_SEEN,
    LEAST_VIEW_MARGIN,
    area_seen,
    hidden_by_robot,
    place_in_words,
    place_that_fits,
)
from foldcell.cell.hardware.robot_check import reached_places, view_margins
from foldcell.cell.hardware.robot_model import load_robot
from foldcell.robots.camera_mount import CameraMount
from foldcell.robots.errors import ConfigurationError
from foldcell.robots.model import RobotModel
from foldcell.robots.ports import Side
from foldcell.robots.registry import find_robot
from foldcell.robots.robot import Robot
from foldcell.skills.motion.validation.collision import CollisionChecker
from foldcell.skills.vocabulary import Table, frozen

LEAST_REACHED = 0.9
"""Share of the places where garments lie. Each arm has to reach at least this share."""
LEAST_COVERED = 0.4
"""Share of this area's length and width that the table has to cover."""
HEIGHT_STEP, LOWEST_HEIGHT = 0.01, -0.6
"""Table heights are tried in these steps down to the lowest allowed one [m]."""


@dataclass(frozen=True)
class Finding:
    """The result of one check. key: the key of `cell.yaml` to change; empty if the robot's model has to change."""

    name: str
    good: bool
    found: str
    key: str = ""


def robot_findings(
    robot: Robot, model: RobotModel, mount: CameraMount, table: Table, stated: tuple[Side, ...] = ()
) -> Iterator[Finding]:
    """Check a robot's model at a table, with a camera. stated: the arms whose parked posture the settings state. A
    fault of such a posture is reported with its key."""
    inside = (model.q_park >= model.planning.lower) & (model.q_park <= model.planning.upper)
    outside = [name for name, good in zip(model.joint_names, inside, strict=True) if not good]
    yield Finding("model", True, f"{len(model.joint_names) // 2} joints an arm, {robot.model_file()}")
    found = f"outside their limits: {', '.join(outside)}" if outside else "within limits"
    yield Finding("parked joints", not outside, found, _park_key(stated, outside[0]) if outside else "")
    yield _parked_arms(model, table, stated)
    margins = view_margins(model, mount, model.q_park)
    shape, margin = min(margins.items(), key=lambda item: item[1])
    where = "out of the picture" if margin >= 0.0 else "inside the picture, where it hides the table"
    found = f"{shape} is {abs(1000 * margin):.0f} mm {where}"
    yield Finding(
        "parked arms in the picture",
        margin >= LEAST_VIEW_MARGIN,
        found,
        _park_key(stated, shape, "camera.position"),
    )
    for side, places in reached_places(model, table).items():
        missed = [f"({x:.2f}, {y:.2f})" for x, y, reached in places if not reached]
        share = 1.0 - len(missed) / len(places)
        found = f"{share:.0%} of {len(places)} places" + (f", not {', '.join(missed[:4])}" if missed else "")
        yield Finding(f"{side} arm's reach", share >= LEAST_REACHED, found, "table.height")


def cell_findings(settings: CellSettings) -> Iterator[Finding]:
    """Check the cell that the settings describe: the robot's model, and what the camera sees of the table. Each
    finding names the key in force: that of a calibration file where it overrides the key of the part."""
    robot, model, told = find_robot(settings.robot), load_robot(settings), False
    for finding in _findings(settings, robot, model):
        key, found = finding.key, finding.found
        if key and overriding_file(key, settings) is not None:
            key = f"{key.split('.')[0]}.calibration"
        if not finding.good and not told and key.startswith("camera."):
            found = f"{found}; {place_that_fits(settings, model)}"
        told = told or (not finding.good and key.startswith(("camera.", "table.")))
        yield replace(finding, key=key, found=found)


def _findings(settings: CellSettings, robot: Robot, model: RobotModel) -> Iterator[Finding]:
    area = f"{AREA_X[0]:.2f} to {AREA_X[1]:.2f} m before the robot, {AREA_Y[1]:.2f} m to both sides"
    covered = {
        f"table.{axis}": max(_overlap(span, wanted), 0.0) / (wanted[1] - wanted[0])
        for axis, span, wanted in (("x", settings.table.x, AREA_X), ("y", settings.table.y, AREA_Y))
    }
    key, share = min(covered.items(), key=lambda item: item[1])
    found = f"{share:.0%} of the length where garments lie ({area})"
    yield Finding("table before the robot", share >= LEAST_COVERED, found, key)
    yield Finding("camera", True, place_in_words(settings), "camera.position")
    seen = work_area_seen(settings)
    found = f"{seen:.0%} of the table where garments lie ({area}){_if_inverted(settings, seen)}"
    stated = [name for name in ("target", "view_deg", "width") if getattr(settings.camera, name) is not None]
    yield Finding("camera's view of the table", seen >= LEAST_SEEN, found, f"camera.{(stated or ['target'])[0]}")
    yield from _gripper(settings)
    parked = tuple(side for side in Side if getattr(settings.park, side.value) is not None)
    yield from robot_findings(robot, model, camera_mount(settings), settings.table, parked)
    hidden = hidden_by_robot(settings, model, camera_calibration(settings))
    found = "no part of the robot" if hidden is None else hidden.what
    key = "camera.calibration" if settings.camera.calibration is not None else "camera.position"
    yield Finding("robot in the camera's picture", hidden is None, found, key)


def _gripper(settings: CellSettings) -> Iterator[Finding]:
    """Check the pads and the force thresholds. The thresholds come from the settings or from the tactile
    calibration."""
    gripper, largest = settings.gripper, find_robot(settings.robot).gripper.max_opening
    found = (
        f"{1e3 * gripper.pad_width:.0f} mm wide, hold cloth up to {1e3 * gripper.pad_depth:.0f} mm over the tips, "
        f"friction {gripper.pad_friction:g}; open {1e3 * gripper.opening:.0f} of {1e3 * largest:.0f} mm to grasp, "
        f"{1e3 * gripper.closed_opening:.1f} mm closed"
    )
    yield Finding("pads", gripper.closed_opening < gripper.opening <= largest, found, "gripper.opening")
    if not settings.grasp.tactile:
        return
    forces, file = settings.grasp.calibrated(), settings.grasp.calibration
    source = "" if file is None else f" ({file.name})"
    for name, limit in (("contact_force", "press_force"), ("held_force", "grip_force")):
        reached, largest = getattr(forces, name), getattr(forces, limit)
        found = f"{reached:.2f} N{source}, {limit.replace('_', ' ')} {largest:.1f} N"
        yield Finding(name.replace("_", " "), reached < largest, found, f"grasp.{name}")


def refuse_unfit_cell(settings: CellSettings) -> None:
    """Raise ConfigurationError with the key and value of the first part of the cell that does not fit."""
    for finding in cell_findings(settings):
        if not finding.good and finding.key:
            raise ConfigurationError(
                f"{finding.key} = {_value(settings, finding.key)}: {finding.name}: {finding.found}",
                "`foldcell cell check --cell FILE --draw .` shows what fits and what does not",
            )


def work_area_seen(settings: CellSettings) -> float:
    """Return the share (0..1) of the area where garments lie that the camera sees as table; 0 if no table is
    there."""
    table = settings.table
    if min(_overlap(table.x, AREA_X), _overlap(table.y, AREA_Y)) <= 0.0:
        return 0.0
    return area_seen(camera_calibration(settings), table)


def _if_inverted(settings: CellSettings, seen: float) -> str:
    """Return a note if the calibrated camera sees too little, and would see enough with its pose inverted."""
    if settings.camera.calibration is None or seen >= LEAST_SEEN:
        return ""
    calibration = camera_calibration(settings)
    inverse = replace(calibration, T_table_camera=frozen(np.linalg.inv(calibration.T_table_camera)))
    if area_seen(inverse, settings.table) < LEAST_SEEN:
        return ""
    return "; T_table_camera looks inverted: it has to transform from the camera to the table"


def _overlap(a: tuple[float, float], b: tuple[float, float]) -> float:
    return min(a[1], b[1]) - max(a[0], b[0])


def _park_key(stated: tuple[Side, ...], part: str, otherwise: str = "") -> str:
    """Return the settings key of an arm's parked posture, if the settings state it, else `otherwise`. part: name
    of a joint or shape; it begins with the arm's side."""
    return next((f"park.{side.value}" for side in stated if part.startswith(side.value)), otherwise)


def _parked_arms(model: RobotModel, table: Table, stated: tuple[Side, ...]) -> Finding:
    contact = CollisionChecker(model, table).contact(model.q_park)
    if contact is None:
        return Finding("parked arms", True, "touch nothing", "table.height")
    key = _park_key(stated, str(contact))
    if key:
        return Finding("parked arms", False, f"{contact} are too near to each other", key)
    lower = (Table(z, table.x, table.y) for z in _lower(table.height))
    free = next((t.height for t in lower if CollisionChecker(model, t).contact(model.q_park) is None), None)
    below = f"; heights up to {free:.2f} are free" if free is not None else ""
    return Finding("parked arms", False, f"{contact} are too near to each other{below}", "table.height")


def _lower(height: float) -> Iterator[float]:
    steps = int((height - LOWEST_HEIGHT) / HEIGHT_STEP)
    return (round(height - HEIGHT_STEP * (k + 1), 2) for k in range(steps))


def _value(settings: CellSettings, key: str) -> str:
    group, name = key.split(".")
    value = settings.model_dump(mode="json", by_alias=True)[group][name]
    return "null (the robot's own)" if value is None else str(value)
