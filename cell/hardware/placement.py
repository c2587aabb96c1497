"""Check before anything moves whether a garment fits on the cell's table, in the camera's picture and in the reach
of the arms, and find a pose or size that fits. Write the file of a user's garment with fitting poses."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from itertools import product
from pathlib import Path

import numpy as np

from foldcell.cell.config.cell_settings import CellSettings
from foldcell.cell.config.garments.garment_file import load_garment
from foldcell.cell.config.garments.new_garment import new_garment_text
from foldcell.cell.hardware.camera import camera_calibration
from foldcell.cell.hardware.cell_check import refuse_unfit_cell
from foldcell.cell.hardware.robot_model import load_robot
from foldcell.cell.planning.fold_planning import motion_rng, reach_height
from foldcell.cell.support.files.whole_file import write_whole
from foldcell.robots.errors import ConfigurationError
from foldcell.robots.model import RobotModel
from foldcell.robots.ports import Array
from foldcell.skills.fold_plan.plan import plan_folds
from foldcell.skills.garments.garment import Garment, PoseRange
from foldcell.skills.garments.picture_measure import fitted_template
from foldcell.skills.motion.moves.fold import plan_hands_motion
from foldcell.skills.motion.validation.collision import CollisionChecker
from foldcell.skills.perception.rectification.table_view import TableView
from foldcell.skills.perception.settings import VIEW_BORDER
from foldcell.skills.trajectory.search.optimise import plain_paths

Pose = tuple[float, float, float]
"""x, y [m] and angle [rad] of a garment in the table frame."""

TURNS = (0.0, np.pi / 2)
SHIFTS = tuple(float(s) for s in np.arange(-0.15, 0.151, 0.03))
TRIES = 10
"""The search for a pose plans the folds at most at this number of poses."""


@dataclass(frozen=True)
class PlacedFold:
    """One fold at one pose. variant: the first variant for which the arms have a path; empty if none has. why: the
    reason why the preferred variant has none."""

    name: str
    variant: str
    why: str


def refuse_unfit_folds(garments: Iterable[str], settings: CellSettings) -> None:
    """Raise ConfigurationError if no run can begin: the parts of the cell do not fit each other, or a garment fits
    nowhere on its table. garments: names or files, or auto."""
    refuse_unfit_cell(settings)
    for garment in garments:
        if garment != "auto":
            refuse_too_large(load_garment(garment, settings.surface), settings)


def refuse_too_large(garment: Garment, settings: CellSettings) -> None:
    """Raise ConfigurationError if no pose puts the whole garment on the table and in the camera's picture."""
    if fitting_pose(garment, settings) is not None:
        return
    scale = _fitting_scale(garment, settings)
    size = "{:.2f} x {:.2f} m".format(*garment.size_m)
    fits = f"a garment of this shape fits at {scale:.0%} of this size" if scale else "no size of this shape fits"
    raise ConfigurationError(
        f"garment {garment.name}, {size}: lies nowhere wholly on the table and in the camera's picture",
        f"{fits}; correct `keypoints` in its file, or `table` and `camera` in cell.yaml",
    )


def fitting_pose(garment: Garment, settings: CellSettings, scale: float = 1.0) -> Pose | None:
    """Return the pose nearest to the garment's own at which it lies on the table and in the picture, or None."""
    outline = scale * np.asarray(garment.template, dtype=float)
    seen = _Seen(settings)
    return next((pose for pose in _poses(garment, settings) if seen.wholly(_at(outline, pose))), None)


def placed_folds(garment: Garment, settings: CellSettings, model: RobotModel, pose: Pose) -> list[PlacedFold]:
    """Plan each fold of the garment at a pose along its plain arc, with the first variant for which the arms have
    a path. The later folds are planned with the variants found for the earlier ones."""
    checker = CollisionChecker(model, settings.table)
    chosen: dict[str, str] = {}
    placed: list[PlacedFold] = []
    for index, planned in enumerate(garment.plan):
        why, found = "", ""
        for variant in planned.variants:
            chosen[planned.name] = variant.name
            steps = plan_folds(garment.flat_state(*pose), garment, chosen, pads=settings.gripper.pads)
            if steps.failure is not None:
                why = why or steps.failure.what
                continue
            step = steps.unwrap()[index]
            motion = plan_hands_motion(
                model, checker, settings.table, plain_paths(step, garment), model.q_park,
                limits=model.limits(settings.motion.accelerations, settings.motion.velocity_scale),
                tool_speed=min(garment.max_tool_speed, settings.motion.tool_speed),
                approach_height=settings.motion.approach_height, reach_height=reach_height(settings),
                rng=motion_rng(),
            )  # fmt: skip
            if motion.failure is None:
                found = variant.name
                break
            why = why or motion.failure.what
        placed.append(PlacedFold(planned.name, found, why))
    return placed


def pose_that_folds(garment: Garment, settings: CellSettings, model: RobotModel) -> Pose | None:
    """Return a pose of the garment on the table at which the camera sees all of it and the arms have a path for
    every fold. Return None if none is found. The search begins near the garment's own pose."""
    outline, seen, tries = np.asarray(garment.template, dtype=float), _Seen(settings), 0
    for pose in _poses(garment, settings):
        if not seen.wholly(_at(outline, pose)):
            continue
        if all(fold.variant for fold in placed_folds(garment, settings, model, pose)):
            return pose
        tries += 1
        if tries >= TRIES:
            break
    return None


def fitting_poses(garment: Garment, settings: CellSettings, model: RobotModel) -> PoseRange | None:
    """Return the garment's range of poses, moved so that the arms have a path for every fold from its middle, and
    narrowed until the garment stays on the table and in the picture. None if no such pose is found."""
    pose = pose_that_folds(garment, settings, model)
    if pose is None:
        return None
    own, outline, seen = garment.poses, np.asarray(garment.template, dtype=float), _Seen(settings)
    for part in (1.0, 0.5):
        x, y, angle = (
            (middle - 0.5 * part * (high - low), middle + 0.5 * part * (high - low))
            for middle, (low, high) in zip(pose, (own.x, own.y, own.angle), strict=True)
        )
        if all(seen.wholly(_at(outline, at)) for at in product(x, y, angle)):
            return PoseRange(x, y, angle)
    x, y, angle = ((middle, middle) for middle in pose)
    return PoseRange(x, y, angle)


def write_own_garment(
    path: Path,
    like: str,
    title: str,
    points: Array,
    measured: tuple[int, int] | None,
    length: float | None,
    origin: str,
    settings: CellSettings,
) -> Array:
    """Write the file of a garment with the folds and the fabric of the garment `like`, and with poses at which
    this cell can fold it. Returns its template (k, 2) [m].

    points: (k, 2) observed key points in the laid pose, in the order of `like`, in any unit. measured: indices of
    the two key points that lie `length` [m] apart; None if the points are in metres. origin: a line that states
    the origin of the outline. Raises ConfigurationError if the folds cannot be planned on this outline,
    StorageError if the file cannot be written.
    """
    model = load_robot(settings)
    template = fitted_template(points, load_garment(like, settings.surface).template, measured, length)
    text = new_garment_text(
        like, path.stem, title, template, origin, settings.surface,
        lambda garment: fitting_poses(garment, settings, model),
    )  # fmt: skip
    write_whole(path, text)
    return template


def _poses(garment: Garment, settings: CellSettings) -> Iterator[Pose]:
    """Yield poses: the garment's own first, then poses around it, then poses around the middle of the table, both
    in order of distance. The same follows with the garment turned."""
    x, y, angle = garment.poses.middle
    yield x, y, angle
    table = settings.table
    middle = 0.5 * (table.x[0] + table.x[1]), 0.5 * (table.y[0] + table.y[1])
    for turn in TURNS:
        for centre in ((x, y), middle):
            shifts = sorted(((a, b) for a in SHIFTS for b in SHIFTS), key=lambda s: (np.hypot(*s), s))
            yield from ((centre[0] + a, centre[1] + b, angle + turn) for a, b in shifts)


def _at(outline: Array, pose: Pose) -> Array:
    c, s = np.cos(pose[2]), np.sin(pose[2])
    return outline @ np.array([[c, s], [-s, c]]) + pose[:2]


class _Seen:
    """The part of the table that the camera sees, without the border that a garment must not touch."""

    def __init__(self, settings: CellSettings) -> None:
        self._view = TableView(camera_calibration(settings), settings.table, pixel=0.004)
        self._margin = VIEW_BORDER + 0.01

    def wholly(self, outline: Array) -> bool:
        """Whether an outline (n, 2) [m] and a border around it are on the table and in the picture."""
        middle = outline.mean(axis=0)
        away = outline - middle
        wider = outline + self._margin * away / np.maximum(np.linalg.norm(away, axis=1, keepdims=True), 1e-9)
        at = np.round(self._view.to_pixel(wider)).astype(int)
        rows, columns = self._view.valid.shape
        if (at < 0).any() or (at >= (columns, rows)).any():
            return False
        return bool(self._view.valid[at[:, 1], at[:, 0]].all())


def _fitting_scale(garment: Garment, settings: CellSettings) -> float:
    """Return the largest scale, in steps of 5 %, at which the garment fits; 0 if none fits."""
    scales = np.arange(0.95, 0.04, -0.05)
    return next((float(s) for s in scales if fitting_pose(garment, settings, float(s)) is not None), 0.0)
