"""Baxter as a position-controlled body in a PyBullet world.

Self-collision is on, except for the pairs of links that the SRDF disables and for links of the same rigid group.
If these pairs could collide, PyBullet would push neighbouring links apart and make the arms unstable. Fingers do
not collide with anything, because another simulation computes the cloth that they touch.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from robots.baxter.model import FINGER_JOINTS, JOINT_NAMES
from robots.baxter.pybullet_files import moving_urdf, srdf_disabled_pairs
from robots.baxter.suppress_output import suppress_output
from robots.ports import Array, Side

with suppress_output():  # PyBullet prints its build date
    import pybullet as pb

__all__ = ["MAX_OPENING", "PAD_THICKNESS", "BaxterBody", "base_pose", "joint_map", "pb"]

ARM_EFFORT = 150.0
"""Motor torque of the arm joints [Nm]. The URDF has 50 Nm, without the springs at S1 that support the upper arm.
With 50 Nm the arm would sag by 0.23 rad."""
FINGER_STROKE = 0.0208
"""Stroke of one finger [m]."""
MAX_OPENING = 2 * FINGER_STROKE
PAD_THICKNESS = 0.008
"""Thickness of each tactile pad [m]. The pads fill the gap of 16 mm between the URDF's closed bare fingertips."""
POSITION_GAIN, VELOCITY_GAIN = 0.2, 1.0
"""Gains of PyBullet's motor. With these gains the largest error is 0.9 mrad at 0.3 rad/s and 240 Hz."""


def joint_map(body: int, client: int) -> dict[str, int]:
    """Return the PyBullet indices of the moving joints by name."""
    count = pb.getNumJoints(body, physicsClientId=client)
    infos = [pb.getJointInfo(body, i, physicsClientId=client) for i in range(count)]
    return {info[1].decode(): info[0] for info in infos if info[2] != pb.JOINT_FIXED}


def base_pose(body: int, link: int, client: int) -> tuple[Array, Array]:
    """Return position (3,) and rotation (3, 3) of a link's frame in the world."""
    state = pb.getLinkState(body, link, computeForwardKinematics=1, physicsClientId=client)
    return np.array(state[4]), np.array(pb.getMatrixFromQuaternion(state[5])).reshape(3, 3)


class BaxterBody:
    """Both arms, head and fingers in the PyBullet world `client`, with the base at the origin. Not thread-safe."""

    def __init__(self, client: int) -> None:
        self._client = client
        flags = pb.URDF_USE_INERTIA_FROM_FILE | pb.URDF_USE_SELF_COLLISION
        with suppress_output():  # PyBullet warns of links without mass; these are only frames
            self._body = pb.loadURDF(str(moving_urdf()), useFixedBase=True, flags=flags, physicsClientId=client)
        joints = joint_map(self._body, client)
        self._arms = [joints[name] for name in JOINT_NAMES]
        self._fingers = {side: tuple(joints[name] for name in FINGER_JOINTS[side]) for side in Side}
        self._head = joints["head_pan"]
        self._driven = [*self._arms, self._head, *(i for side in Side for i in self._fingers[side])]
        self._forces = [ARM_EFFORT] * 14 + [50.0] + [20.0] * 4
        self._links = self._link_map()
        self._tool = {side: self._links[f"{side}_gripper"] for side in Side}
        self._filter_collisions()

    def _link_map(self) -> dict[str, int]:
        n = pb.getNumJoints(self._body, physicsClientId=self._client)
        links = {pb.getJointInfo(self._body, i, physicsClientId=self._client)[12].decode(): i for i in range(n)}
        return {"base": -1, **links}

    def _rigid_group(self, link: int) -> int:
        """Return the moving link to which `link` is fixed."""
        while link >= 0:
            info = pb.getJointInfo(self._body, link, physicsClientId=self._client)
            if info[2] != pb.JOINT_FIXED:
                break
            link = info[16]
        return link

    def _filter_collisions(self) -> None:
        disabled = srdf_disabled_pairs()
        names = list(self._links)
        group = {name: self._rigid_group(self._links[name]) for name in names}
        for i, first in enumerate(names):
            for second in names[:i]:
                collide = (
                    frozenset((first, second)) not in disabled
                    and group[first] != group[second]
                    and "finger" not in first + second
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
        for name, link in self._links.items():
            if "finger" in name:
                pb.setCollisionFilterPair(self._body, other, link, -1, 0, physicsClientId=self._client)

    def place(self, q: Array, head_pan: float, opening: Mapping[Side, float]) -> None:
        """Set the state at rest: q (14,), head_pan [rad], openings [m]. For initial states, not for motions."""
        for joint, position in zip(self._driven, self._targets(q, head_pan, opening), strict=True):
            pb.resetJointState(self._body, joint, position, 0.0, physicsClientId=self._client)

    def drive(self, q: Array, qd: Array, head_pan: float, opening: Mapping[Side, float]) -> None:
        """Set the motor targets for the next step: q, qd (14,) [rad], [rad/s]; head [rad]; openings [m]."""
        pb.setJointMotorControlArray(
            self._body,
            self._driven,
            pb.POSITION_CONTROL,
            targetPositions=self._targets(q, head_pan, opening),
            targetVelocities=[*qd.tolist(), 0.0, 0.0, 0.0, 0.0, 0.0],
            forces=self._forces,
            positionGains=[POSITION_GAIN] * 19,
            velocityGains=[VELOCITY_GAIN] * 19,
            physicsClientId=self._client,
        )

    @staticmethod
    def _targets(q: Array, head_pan: float, opening: Mapping[Side, float]) -> list[float]:
        fingers = [sign * 0.5 * opening[side] for side in Side for sign in (1.0, -1.0)]
        return [*q.tolist(), head_pan, *fingers]

    def read(self) -> tuple[Array, Array, Array, float]:
        """Return the true q, qd, effort (14,) [rad], [rad/s], [Nm] and head_pan [rad], without sensor errors."""
        states = pb.getJointStates(self._body, [*self._arms, self._head], physicsClientId=self._client)
        q, qd, _, effort = zip(*states, strict=True)
        return np.array(q[:14]), np.array(qd[:14]), np.array(effort[:14]), float(q[14])

    def tool_pose(self, side: Side) -> tuple[Array, Array]:
        """Return T_base_tool as position (3,) [m] and rotation (3, 3). robots.ports defines the tool's axes."""
        return base_pose(self._body, self._tool[side], self._client)

    def touches(self, other: int | None = None) -> tuple[tuple[str, str], ...]:
        """Return the pairs of names of links in contact with each other, or with body `other` (the second name is
        '')."""
        target = self._body if other is None else other
        found = pb.getContactPoints(self._body, target, physicsClientId=self._client) or ()
        name = {index: name for name, index in self._links.items()}
        return tuple(sorted({(name[c[3]], name[c[4]] if other is None else "") for c in found}))
