"""PyBullet, without the output of its C code, and the joints and links of a body in one of its worlds.

PyBullet writes directly to the file descriptors. The standard output of this program contains its results and must
contain no other text.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np

from foldcell.robots.ports import Array

__all__ = ["base_pose", "joint_map", "pb", "suppress_output"]


@contextmanager
def suppress_output() -> Iterator[None]:
    """Discard standard output and standard error inside the context. Python's buffers are flushed first."""
    for stream in (sys.stdout, sys.stderr):
        if stream is not None:
            stream.flush()
    saved = [(fd, os.dup(fd)) for fd in (1, 2)]
    null = os.open(os.devnull, os.O_WRONLY)
    try:
        for fd, _ in saved:
            os.dup2(null, fd)
        yield
    finally:
        for fd, copy in saved:
            os.dup2(copy, fd)
            os.close(copy)
        os.close(null)


with suppress_output():  # PyBullet prints its build date
    import pybullet as pb


def joint_map(body: int, client: int) -> dict[str, int]:
    """Return the PyBullet indices of the moving joints by name."""
    count = pb.getNumJoints(body, physicsClientId=client)
    infos = [pb.getJointInfo(body, i, physicsClientId=client) for i in range(count)]
    return {info[1].decode(): info[0] for info in infos if info[2] != pb.JOINT_FIXED}


def base_pose(body: int, link: int, client: int) -> tuple[Array, Array]:
    """Return position (3,) and rotation (3, 3) of a link's frame in the world."""
    state = pb.getLinkState(body, link, computeForwardKinematics=1, physicsClientId=client)
    return np.array(state[4]), np.array(pb.getMatrixFromQuaternion(state[5])).reshape(3, 3)
