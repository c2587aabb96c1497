"""Makes the same fold with PyBullet's soft body, a net of springs.

The stretching springs have the stiffness of our edges. The bending springs correspond to no laboratory quantity
and have the default stiffness. A hand is a small body to which the nearest vertex is anchored. The friction
coefficient of a contact is the product of the two bodies' coefficients.
"""

from __future__ import annotations

import tempfile
import time
from importlib import metadata
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.cloth import Tell
from benchmarks.cloth.scenes import RELEASE, SETTLE, SharedFold, plain_fold
from foldcell.robots.bullet.body import pb
from foldcell.robots.ports import Array
from foldcell.skills.cloth.elasticity import GRAVITY, membrane_modulus

STEP = 1.0 / 240.0
SUBSTEPS = (1, 4)
"""PyBullet's numbers of substeps per step that are compared: its default, and a larger one."""
SPRING = np.sqrt(3.0) / 2.0
"""Ratio of the stiffness of an edge, in a mesh of equilateral triangles, to the membrane's Young modulus."""


def folded(fold: SharedFold, substeps: int) -> tuple[Array, float]:
    """Make the fold in PyBullet. Return the vertices (n, 3) at its end, and the speed of one thread relative to
    real time."""
    client = pb.connect(pb.DIRECT)
    try:
        pb.resetSimulation(pb.RESET_USE_DEFORMABLE_WORLD, physicsClientId=client)
        pb.setGravity(0.0, 0.0, -GRAVITY, physicsClientId=client)
        pb.setPhysicsEngineParameter(fixedTimeStep=STEP, numSubSteps=substeps, physicsClientId=client)
        return _run(fold, client)
    finally:
        pb.disconnect(physicsClientId=client)


def _run(fold: SharedFold, client: int) -> tuple[Array, float]:
    material = fold.material
    box = pb.createCollisionShape(pb.GEOM_BOX, halfExtents=[2.0, 2.0, 0.1], physicsClientId=client)
    table = pb.createMultiBody(0.0, box, -1, [0.0, 0.0, -0.1], physicsClientId=client)
    mu = float(np.sqrt(material.friction_static))
    pb.changeDynamics(table, -1, lateralFriction=mu, physicsClientId=client)
    cloth = _cloth(fold, mu, client)
    order = _order(fold.start, _nodes(cloth, client))
    start, hands = time.thread_time(), []
    for path in fold.paths.values():
        body = pb.createMultiBody(0.05, -1, -1, path.position[0].tolist(), physicsClientId=client)
        hold = pb.createConstraint(
            body,
            -1,
            -1,
            -1,
            pb.JOINT_FIXED,
            [0, 0, 0],
            [0, 0, 0],
            path.position[0].tolist(),
            physicsClientId=client,
        )
        near = int(np.argmin(np.linalg.norm(fold.mesh.rest - path.position[0, :2], axis=1)))
        anchor = pb.createSoftBodyAnchor(cloth, int(order[near]), body, -1, physicsClientId=client)
        hands.append((path, hold, anchor))
    for k in range(round((fold.seconds - RELEASE - SETTLE) / STEP)):
        for path, hold, _ in hands:
            at = [float(np.interp(k * STEP, path.t, path.position[:, c])) for c in range(3)]
            pb.changeConstraint(hold, at, maxForce=100.0, physicsClientId=client)
        pb.stepSimulation(physicsClientId=client)
    for _, _, anchor in hands:
        pb.removeConstraint(anchor, physicsClientId=client)
    for _ in range(round((RELEASE + SETTLE) / STEP)):
        pb.stepSimulation(physicsClientId=client)
    seconds = time.thread_time() - start
    return _nodes(cloth, client)[order], fold.seconds / seconds


def _cloth(fold: SharedFold, mu: float, client: int) -> int:
    material, mesh = fold.material, fold.mesh
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "cloth.obj"
        lines = [f"v {x} {y} {z}" for x, y, z in fold.start]
        lines += [f"f {a + 1} {b + 1} {c + 1}" for a, b, c in mesh.triangles]
        path.write_text("\n".join(lines) + "\n", encoding="utf-8")
        return int(
            pb.loadSoftBody(
                str(path), mass=material.areal_mass * float(mesh.area.sum()), useMassSpring=1, useBendingSprings=1,
                springElasticStiffness=float(SPRING * membrane_modulus(material)),
                springDampingStiffness=0.05, springBendingStiffness=0.1, useSelfCollision=1, useFaceContact=1,
                frictionCoeff=mu, collisionMargin=0.5 * material.thickness, physicsClientId=client,
            )
        )  # fmt: skip


def _nodes(cloth: int, client: int) -> Array:
    _, points = pb.getMeshData(cloth, -1, flags=pb.MESH_DATA_SIMULATION_MESH, physicsClientId=client)
    return np.array(points)


def _order(start: Array, nodes: Array) -> np.ndarray:
    """Find the index of PyBullet's node for each of our vertices."""
    return np.array([int(np.argmin(np.linalg.norm(nodes - p, axis=1))) for p in start])


def measure(quick: bool, tell: Tell) -> dict[str, Any]:
    fold, rows = plain_fold(), []
    for substeps in SUBSTEPS[: 1 if quick else None]:
        end, speed = folded(fold, substeps)
        lost = not np.isfinite(end).all() or bool(np.abs(end).max() > 2.0)
        rows.append({"substeps": substeps, "x_realtime": speed, "lost": lost,
                     "error_mm": None if lost else 1e3 * fold.error(end)})  # fmt: skip
    return {
        "pybullet_folds": rows,
        "pybullet_towel_x_realtime": rows[0]["x_realtime"],
        "pybullet_towel_error_mm": rows[0]["error_mm"],
        "pybullet_version": metadata.version("pybullet"),
    }
