"""A robot as a position-controlled body in a PyBullet world.

Self-collision is on, except for the pairs of links that the description disables and for links of the same rigid
group. If these pairs could collide, PyBullet would push neighbouring links apart and make the arms unstable.
Fingers do not collide with anything, because another simulation computes the cloth that they touch.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from foldcell.robots.bullet import base_pose, joint_map, pb, suppress_output
from foldcell.robots.ports import Array, Side
from foldcell.robots.urdf.description import RobotDescription
from foldcell.robots.urdf.elements import neighbours

HEAD_EFFORT, FINGER_EFFORT = 50.0, 20.0
"""Motor torque of the head [Nm], and force of each finger joint [N] or torque [Nm]."""
POSITION_GAIN, VELOCITY_GAIN = 0.2, 1.0
"""Gains of PyBullet's motor. With these gains the largest error is 0.9 mrad at 0.3 rad/s and 240 Hz."""


class BulletBody:
    """Both arms, head and fingers in the PyBullet world `client`, with the base at the origin. Not thread-safe.
    Vectors (n,) have the order of `joint_names`. urdf: collision shapes and inertias, without visuals and without
    `package://` paths."""

    def __init__(self, client: int, urdf: Path, description: RobotDescription) -> None:
        self._client, self._gripper = client, description.gripper
        self._fingers = [link for side in Side for link in description.fingers[side]]
        flags = pb.URDF_USE_INERTIA_FROM_FILE | pb.URDF_USE_SELF_COLLISION
        with suppress_output():  # PyBullet warns of links without mass; these are only frames
            self._body = pb.loadURDF(str(urdf), useFixedBase=True, flags=flags, physicsClientId=client)
        joints = joint_map(self._body, client)
        self._arms = [joints[name] for name in description.joint_names]
        head = description.camera.head_joint
        self._head = [joints[head]] if head is not None else []
        fingers = [joints[name] for side in Side for name, _ in description.gripper.finger_joints[side]]
        self._driven = [*self._arms, *self._head, *fingers]
        self._forces = [
            *description.efforts,
            *description.efforts,
            *[HEAD_EFFORT] * len(self._head),
            *[FINGER_EFFORT] * len(fingers),
        ]
        self._links = self._link_map()
        self._tool = {side: self._links[description.tool_links[side]] for side in Side}
        self._filter_collisions(neighbours(description.urdf()) | description.disabled_pairs())

    def _link_map(self) -> dict[str, int]:
        n = pb.getNumJoints(self._body, physicsClientId=self._client)
        links = {pb.getJointInfo(self._body, i, physicsClientId=self._client)[12].decode(): i for i in range(n)}
        base = pb.getBodyInfo(self._body, physicsClientId=self._client)[0].decode()
        return {base: -1, **links}

    def _rigid_group(self, link: int) -> int:
        """Return the moving link to which `link` is fixed."""
        while link >= 0:
            info = pb.getJointInfo(self._body, link, physicsClientId=self._client)
            if info[2] != pb.JOINT_FIXED:
                break
            link = info[16]
        return link

    def _filter_collisions(self, disabled: frozenset[frozenset[str]]) -> None:
        """Disable collisions of the pairs of links `disabled`, and of the fingers."""
        names = [
            name
            for name, link in self._links.items()
            if pb.getCollisionShapeData(self._body, link, physicsClientId=self._client)
        ]
        group = {name: self._rigid_group(self._links[name]) for name in names}
        for i, first in enumerate(names):
            for second in names[:i]:
                collide = (
                    frozenset((first, second)) not in disabled
                    and group[first] != group[second]
                    and first not in self._fingers
                    and second not in self._fingers
                )
                pb.setCollisionFilterPair(
                    self._body,
                    self._body,
                    self._links[first],
                    self._links[second],
                    int(collide),
                    physicsClientId=self._client,
                )

    def let_fingers_through(self, other: int) -> None:
        """Disable collisions between the fingers and body `other`."""
        for name in self._fingers:
            pb.setCollisionFilterPair(self._body, other, self._links[name], -1, 0, physicsClientId=self._client)

    def place(self, q: Array, head_pan: float, opening: Mapping[Side, float]) -> None:
        """Set the state at rest: q (n,), head_pan [rad], openings [m]. For initial states, not for motions."""
        for joint, position in zip(self._driven, self._targets(q, head_pan, opening), strict=True):
            pb.resetJointState(self._body, joint, position, 0.0, physicsClientId=self._client)

    def drive(self, q: Array, qd: Array, head_pan: float, opening: Mapping[Side, float]) -> None:
        """Set the motor targets for the next step: q, qd (n,) [rad], [rad/s]; head [rad]; openings [m]."""
        pb.setJointMotorControlArray(
            self._body,
            self._driven,
            pb.POSITION_CONTROL,
            targetPositions=self._targets(q, head_pan, opening),
            targetVelocities=[*qd.tolist(), *[0.0] * (len(self._driven) - len(self._arms))],
            forces=self._forces,
            positionGains=[POSITION_GAIN] * len(self._driven),
            velocityGains=[VELOCITY_GAIN] * len(self._driven),
            physicsClientId=self._client,
        )

    def _targets(self, q: Array, head_pan: float, opening: Mapping[Side, float]) -> list[float]:
        fingers = [p for side in Side for p in self._gripper.finger_positions(side, opening[side]).values()]
        return [*q.tolist(), *[head_pan] * len(self._head), *fingers]

    def read(self) -> tuple[Array, Array, Array, float]:
        """Return the true q, qd, effort (n,) [rad], [rad/s], [Nm] and head_pan [rad], without sensor errors."""
        states = pb.getJointStates(self._body, [*self._arms, *self._head], physicsClientId=self._client)
        q, qd, _, effort = zip(*states, strict=True)
        n = len(self._arms)
        return np.array(q[:n]), np.array(qd[:n]), np.array(effort[:n]), float(q[n]) if self._head else 0.0

    def tool_pose(self, side: Side) -> tuple[Array, Array]:
        """Return T_base_tool as position (3,) [m] and rotation (3, 3). robots.ports defines the tool's axes."""
        return base_pose(self._body, self._tool[side], self._client)
