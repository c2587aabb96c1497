"""Compute the figures by which a robot's model is checked at a cell: whether its parked arms are out of the
camera's view, and whether the arms reach the table."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import lru_cache

import coal
import numpy as np
import pinocchio as pin

from foldcell.robots.camera_mount import CameraMount
from foldcell.robots.model import RobotModel
from foldcell.robots.ports import Array, Side
from foldcell.skills.motion.kinematics import ik
from foldcell.skills.motion.validation.collision import CollisionChecker
from foldcell.skills.vocabulary import Table, tool_rotation

PLACES_X, PLACES_Y = np.arange(0.35, 0.86, 0.10), np.arange(0.05, 0.36, 0.10)
"""Places where garments lie: distance from the base, and to the arm's own side, in the table frame [m]."""
HAND_HEIGHT = 0.01
"""Height of the tool above the table [m]."""
SEEDS = 40
SIDES = 24
"""Number of sides of the prism around a cylinder."""


def view_margins(model: RobotModel, mount: CameraMount, q: Array) -> dict[str, float]:
    """Return how far each shape that an arm moves is out of the camera's picture at joints q (joints,): name ->
    distance [m], which is negative for a shape inside the picture."""
    T_camera_base = np.linalg.inv(mount.T_base_camera(model.head_pan))
    k = mount.intrinsics
    # inward normals of the four side planes of the view pyramid, from the edges of the picture
    planes = np.array(
        [
            [k.fx, 0.0, k.cx + 0.5],
            [-k.fx, 0.0, k.width - 0.5 - k.cx],
            [0.0, k.fy, k.cy + 0.5],
            [0.0, -k.fy, k.height - 0.5 - k.cy],
        ]
    )
    planes /= np.linalg.norm(planes, axis=1, keepdims=True)
    margins: dict[str, float] = {}
    for name, base in moved_shapes(model, q).items():
        seen = base @ T_camera_base[:3, :3].T + T_camera_base[:3, 3]
        margins[name] = float((-(seen @ planes.T)).min(axis=0).max())
    return margins


def moved_shapes(model: RobotModel, q: Array) -> dict[str, Array]:
    """Return points around each collision shape that an arm moves, at joints q (joints,): name -> (n, 3) [m] in
    the base frame. The convex hull of the points contains the shape."""
    data, placed = model.pin_model.createData(), model.collision_model.createData()
    pin.updateGeometryPlacements(model.pin_model, data, model.collision_model, placed, model.configuration(q))
    return {
        shape.name: _corners(shape.geometry) @ T.rotation.T + T.translation
        for shape, T in zip(model.collision_model.geometryObjects, placed.oMg, strict=True)
        if _is_moved(model, shape.parentJoint)
    }


def _is_moved(model: RobotModel, joint: int) -> bool:
    arm = {model.pin_model.getJointId(name) for name in model.joint_names}
    while joint != 0 and joint not in arm:
        joint = model.pin_model.parents[joint]
    return joint != 0


def _corners(shape: coal.CollisionGeometry) -> Array:
    """Return points (n, 3) whose convex hull contains the shape: its vertices, those of a prism around a cylinder,
    or the corners of the bounding box."""
    if isinstance(shape, coal.ConvexBase):
        return np.asarray(shape.points())
    if isinstance(shape, coal.Cylinder):
        angle = np.linspace(0.0, 2.0 * np.pi, SIDES, endpoint=False)
        radius = shape.radius / np.cos(np.pi / SIDES)
        ring = np.stack([radius * np.cos(angle), radius * np.sin(angle), np.full(SIDES, shape.halfLength)], axis=1)
        return np.vstack([ring, ring * [1.0, 1.0, -1.0]])
    shape.computeLocalAABB()
    low, high = shape.aabb_local.min_, shape.aabb_local.max_
    return np.array([[(low, high)[k >> j & 1][j] for j in range(3)] for k in range(8)])


@lru_cache(maxsize=8)
def reached_places(model: RobotModel, table: Table) -> Mapping[Side, Sequence[tuple[float, float, bool]]]:
    """Return for each arm the places where garments lie, as (x, y, reached), in the table frame [m]. A place is
    reached if the arm can bring its hand there without collision. The hand points down and the other arm is
    parked."""
    checker = CollisionChecker(model, table)
    rng = np.random.default_rng(1)
    places: dict[Side, list[tuple[float, float, bool]]] = {side: [] for side in Side}
    for side in Side:
        cut, sign = model.arm(side), 1.0 if side is Side.LEFT else -1.0
        lower, upper = model.planning.lower[cut], model.planning.upper[cut]
        seeds = np.vstack([model.park(side), rng.uniform(lower, upper, (SEEDS, len(lower)))])
        for x in PLACES_X:
            for y in sign * PLACES_Y:
                places[side].append((float(x), float(y), _reaches(model, checker, table, side, (x, y), seeds)))
    return places


def _reaches(
    model: RobotModel, checker: CollisionChecker, table: Table, side: Side, xy: tuple[float, float], seeds: Array
) -> bool:
    T, q = np.eye(4), np.array(model.q_park)
    T[:3, :3] = tool_rotation(np.array([np.pi / 2]), np.zeros(1), np.zeros(1))[0]
    T[:3, 3] = (*xy, table.height + HAND_HEIGHT)
    for half_turn in (np.eye(3), np.diag([-1.0, -1.0, 1.0])):
        turned = T.copy()
        turned[:3, :3] = T[:3, :3] @ half_turn
        for solution in ik.solve_seeds(model, side, turned, seeds):
            q[model.arm(side)] = solution
            if not checker.in_collision(q, allow_fingertips=True):
                return True
    return False
