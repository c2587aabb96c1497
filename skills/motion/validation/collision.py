"""Checks collisions between the arms, the robot's body and the table (coal, Pinocchio).

The table is a solid block from its top to the floor. `body_margin` applies between parts of the robot,
`table_margin` between the arms and the table. The fingertips may touch the table in a grasp (`allow_fingertips`);
otherwise they keep `fingertip_margin`.
"""

from __future__ import annotations

from dataclasses import dataclass

import coal
import numpy as np
import pinocchio as pin

from foldcell.robots.model import RobotModel
from foldcell.robots.ports import Array, Side
from foldcell.skills.vocabulary import Table

BODY_MARGIN = 0.01
"""Minimum distance between an arm and any other part of the robot [m]. It covers errors of tracking and model."""
TABLE_MARGIN = 0.015
"""Minimum distance between the table and any part of an arm except its fingers [m]."""
FINGERTIP_MARGIN = 0.02
"""Minimum distance between the table and the fingers while the arms move freely [m]. It is larger than the height
of folded cloth."""
ROUNDING = 1e-4
"""A decrease of a distance by no more than this is ignored [m]."""


@dataclass(frozen=True)
class Contact:
    """The names of two objects that are nearer than allowed. index: of the pose in a path (0 for a single
    pose)."""

    first: str
    second: str
    index: int = 0

    def __str__(self) -> str:
        return f"{self.first} - {self.second}"


class CollisionChecker:
    """Checks poses of the robot. It is not thread-safe: create one per thread. The margins [m] are fixed at
    construction."""

    def __init__(
        self,
        model: RobotModel,
        table: Table,
        *,
        body_margin: float = BODY_MARGIN,
        table_margin: float = TABLE_MARGIN,
        fingertip_margin: float = FINGERTIP_MARGIN,
    ) -> None:
        self.model = model
        self.table = table
        self._geometry = pin.GeometryModel(model.collision_model)
        self._fingers = {name for side in Side for name in model.fingertips[side]}
        self._drop_rigid_pairs()
        self._add_table()
        shapes = self._geometry.geometryObjects
        self._names = [(shapes[p.first].name, shapes[p.second].name) for p in self._geometry.collisionPairs]
        self._margins = np.array(
            [self._margin(pair, body_margin, table_margin, fingertip_margin) for pair in self._names]
        )
        self._finger_pairs = [i for i, (a, b) in enumerate(self._names) if b == "table" and a in self._fingers]
        self._data = model.pin_model.createData()
        self._free = self._geometry.createData()
        self._grasp = self._geometry.createData()
        for data in (self._free, self._grasp):
            for i, margin in enumerate(self._margins):
                data.collisionRequests[i].security_margin = float(margin)
        for i in self._finger_pairs:
            self._grasp.deactivateCollisionPair(i)

    def _add_table(self) -> None:
        table, floor = self.table, self.model.floor
        size = np.array([table.x[1] - table.x[0], table.y[1] - table.y[0], table.height - floor])
        centre = np.array([sum(table.x) / 2, sum(table.y) / 2, (table.height + floor) / 2])
        box = pin.GeometryObject("table", 0, pin.SE3(np.eye(3), centre), coal.Box(*size))
        index = self._geometry.addGeometryObject(box)
        for i, shape in enumerate(self._geometry.geometryObjects):
            if self._arm_joint(shape.parentJoint) != 0:
                self._geometry.addCollisionPair(pin.CollisionPair(i, index))

    def _drop_rigid_pairs(self) -> None:
        """Remove pairs that no arm joint moves relative to each other, such as the fingers of one hand."""
        shapes, moving_joint = self._geometry.geometryObjects, self._arm_joint
        kept = [
            pin.CollisionPair(pair.first, pair.second)
            for pair in self._geometry.collisionPairs
            if moving_joint(shapes[pair.first].parentJoint) != moving_joint(shapes[pair.second].parentJoint)
        ]
        self._geometry.removeAllCollisionPairs()
        for pair in kept:
            self._geometry.addCollisionPair(pair)

    def _arm_joint(self, joint: int) -> int:
        """Return the arm joint that moves a joint of the model, 0 if none does."""
        arm, pin_model = {self.model.pin_model.getJointId(n) for n in self.model.joint_names}, self.model.pin_model
        while joint != 0 and joint not in arm:
            joint = pin_model.parents[joint]
        return int(joint)

    def _margin(self, pair: tuple[str, str], body: float, table: float, fingertip: float) -> float:
        if pair[1] != "table":
            return body
        return fingertip if pair[0] in self._fingers else table

    def in_collision(self, q: Array, *, allow_fingertips: bool = False) -> bool:
        """Whether any pair is nearer than its margin at q (joints,)."""
        data = self._grasp if allow_fingertips else self._free
        return bool(
            pin.computeCollisions(
                self.model.pin_model, self._data, self._geometry, data, self.model.configuration(q), True
            )
        )

    def contact(self, q: Array, *, allow_fingertips: bool = False, index: int = 0) -> Contact | None:
        """Return the first pair that is nearer than its margin at q (joints,), or None."""
        if not self.in_collision(q, allow_fingertips=allow_fingertips):
            return None
        data = self._grasp if allow_fingertips else self._free
        for i, (a, b) in enumerate(self._names):
            if data.activeCollisionPairs[i] and data.collisionResults[i].isCollision():
                return Contact(a, b, index)
        return Contact("unknown", "unknown", index)

    def first_collision(self, path: Array, *, allow_fingertips: bool = False) -> Contact | None:
        """Return the first contact along joint vectors (n, joints), with its index, or None."""
        for i, q in enumerate(path):
            contact = self.contact(q, allow_fingertips=allow_fingertips, index=i)
            if contact is not None:
                return contact
        return None

    def first_contact_after_parting(self, path: Array, *, allow_fingertips: bool = False) -> Contact | None:
        """Return the first contact along joint vectors (n, joints) that begin in contact, or None.

        A pair that is too near at the start does not count as a contact while its distance does not shrink from
        one vector to the next. It counts if it is still too near at the end.
        """
        near = self._near(path[0], allow_fingertips)
        for i, q in enumerate(path):
            last, near = near, self._near(q, allow_fingertips)
            for pair, distance in near.items():
                if pair not in last or distance < last[pair] - ROUNDING:
                    return Contact(*self._names[pair], i)
        return Contact(*self._names[next(iter(near))], len(path) - 1) if near else None

    def _near(self, q: Array, allow_fingertips: bool) -> dict[int, float]:
        """Return the distance of each pair that is nearer than its margin at q (joints,) [m]; it is negative where
        the pair overlaps."""
        data = self._grasp if allow_fingertips else self._free
        pin.computeCollisions(
            self.model.pin_model, self._data, self._geometry, data, self.model.configuration(q), False
        )
        return {
            i: float(pin.computeDistance(self._geometry, data, i).min_distance)
            for i in range(len(self._names))
            if data.activeCollisionPairs[i] and data.collisionResults[i].isCollision()
        }

    def edge_free(self, q0: Array, q1: Array, *, resolution: float = 0.05) -> bool:
        """Whether the straight line from q0 (joints,) to q1 (joints,) is free, checked every `resolution`
        [rad]."""
        n = max(1, int(np.ceil(np.abs(q1 - q0).max() / resolution)))
        # Indices divisible by high powers of two come first, because widely spaced poses find most collisions
        # early.
        order = sorted(range(1, n + 1), key=lambda i: (i & -i) * -1)
        return not any(self.in_collision(q0 + (i / n) * (q1 - q0)) for i in order)
