"""PyBullet, and the joints and links of a body in one of its worlds."""

from __future__ import annotations

import numpy as np

from foldcell.robots.bullet.suppress_output import suppress_output
from foldcell.robots.ports import Array

with suppress_output():  # PyBullet prints its build date
    import pybullet as pb

__all__ = ["base_pose", "joint_map", "pb"]


def joint_map(body: int, client: int) -> dict[str, int]:
    """Return the PyBullet indices of the moving joints by name."""
    count = pb.getNumJoints(body, physicsClientId=client)
    infos = [pb.getJointInfo(body, i, physicsClientId=client) for i in range(count)]
    return {info[1].decode(): info[0] for info in infos if info[2] != pb.JOINT_FIXED}


def base_pose(body: int, link: int, client: int) -> tuple[Array, Array]:
    """Return position (3,) and rotation (3, 3) of a link's frame in the world."""
    state = pb.getLinkState(body, link, computeForwardKinematics=1, physicsClientId=client)
    return np.array(state[4]), np.array(pb.getMatrixFromQuaternion(state[5])).reshape(3, 3)
