"""Compares the inverse kinematics of single poses with peers, on the same poses and in the same process.

A pose is solved if Pinocchio's forward kinematics puts the tool within 1 mm and 0.5 degrees of it, and every joint
is within its limits. The poses are those of random joint vectors, so each can be reached. Times are CPU times.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import numpy as np
import pinocchio as pin
from scipy.optimize import least_squares

from benchmarks.motion.peers import jacobian
from foldcell.robots.baxter.names import JOINT_NAMES
from foldcell.robots.baxter.robot import DESCRIPTION
from foldcell.robots.bullet import joint_map, pb, suppress_output
from foldcell.robots.model import RobotModel
from foldcell.robots.ports import Array, Side, arm_slice
from foldcell.robots.urdf.converted import moving_urdf
from foldcell.skills.motion.kinematics import ik

POSITION, ANGLE = 0.001, np.deg2rad(0.5)
STARTS = 60
"""Number of random starts of our solver, besides the parked pose. They are the same for all poses."""
PEER_STARTS = 10
"""Maximum number of starts for each peer. They are the first starts of our solver. With this number, a peer takes
tens of milliseconds at most."""

Solver = Callable[[Side, Array], Array | None]
"""Function from arm and T_base_tool (4, 4) to joints (7,), or None."""


def measure_kinematics(
    tell: Callable[[str], None], model: RobotModel, poses: int, peer_poses: int
) -> dict[str, Any]:
    """Measure success rates and times of all solvers. poses: number of poses for our solver. peer_poses: how many
    of the same poses the peers, which are slower, have to solve."""
    rng = np.random.default_rng(11)
    judge = _Judge(model)
    wanted = [_pose(judge, model, rng, tuple(Side)[k % 2]) for k in range(poses)]
    starts = {side: _starts(model, side, np.random.default_rng(5)) for side in Side}
    solvers: dict[str, tuple[Solver, int]] = {
        "ik": (_ours(model, starts), poses),
        "pybullet_ik": (_PyBullet(model, starts), peer_poses),
        "scipy_ik": (_scipy(model, starts), peer_poses),
    }
    figures: dict[str, Any] = {"ik_poses": poses, "ik_peer_poses": peer_poses, "ik_peer_starts": PEER_STARTS}
    for name, (solve, count) in solvers.items():
        tell(f"{name}: {count} poses")
        figures |= _race(name, solve, wanted[:count], judge)
    return figures


def _race(name: str, solve: Solver, wanted: list[tuple[Side, Array]], judge: _Judge) -> dict[str, float]:
    solve(*wanted[0])  # the first call compiles or loads code; it is not timed
    took, good = [], 0
    for side, T in wanted:
        start = time.thread_time()
        q = solve(side, T)
        took.append(1e3 * (time.thread_time() - start))
        good += q is not None and judge.solved(side, q, T)
    return {
        f"{name}_success_rate": good / len(wanted),
        f"{name}_ms_median": float(np.median(took)),
        f"{name}_ms_p99": float(np.percentile(took, 99)),
    }


class _Judge:
    """Checks solutions by Pinocchio's forward kinematics and the joint limits."""

    def __init__(self, model: RobotModel) -> None:
        self.model = model
        self.data = model.pin_model.createData()

    def pose(self, side: Side, q: Array) -> Array:
        both = np.array(self.model.q_park)
        both[arm_slice(side, 14)] = q
        pin.framesForwardKinematics(self.model.pin_model, self.data, self.model.configuration(both))
        T: Array = self.data.oMf[self.model.pin_model.getFrameId(self.model.tool_frame[side])].homogeneous
        return T.copy()

    def solved(self, side: Side, q: Array, T: Array) -> bool:
        reached = self.pose(side, q)
        cut = arm_slice(side, 14)
        lower, upper = self.model.planning.lower[cut], self.model.planning.upper[cut]
        turn = np.arccos(np.clip((np.trace(reached[:3, :3].T @ T[:3, :3]) - 1.0) / 2.0, -1.0, 1.0))
        inside = np.all(q >= lower - 1e-9) and np.all(q <= upper + 1e-9)
        return bool(inside and np.linalg.norm(reached[:3, 3] - T[:3, 3]) <= POSITION and turn <= ANGLE)


def _pose(judge: _Judge, model: RobotModel, rng: np.random.Generator, side: Side) -> tuple[Side, Array]:
    cut = arm_slice(side, 14)
    return side, judge.pose(side, rng.uniform(model.planning.lower[cut], model.planning.upper[cut]))


def _starts(model: RobotModel, side: Side, rng: np.random.Generator) -> Array:
    cut = arm_slice(side, 14)
    spread = rng.uniform(model.planning.lower[cut], model.planning.upper[cut], (STARTS, 7))
    return np.vstack([model.park(side), spread])


def _ours(model: RobotModel, starts: dict[Side, Array]) -> Solver:
    def solve(side: Side, T: Array) -> Array | None:
        found = (ik.solve_pose(model, side, T, q0, gain=0.02) for q0 in starts[side])
        return next((q for q in found if q is not None), None)

    return solve


def _scipy(model: RobotModel, starts: dict[Side, Array]) -> Solver:
    """Create a solver: SciPy's trust-region least squares of the pose error, with our Jacobian. It tries one start
    after the other until one succeeds."""

    def solve(side: Side, T: Array) -> Array | None:
        chain, cut = model.chains[side], arm_slice(side, 14)

        def error(q: Array) -> Array:
            here = ik.tool_pose(chain, q)
            turn = pin.log3(T[:3, :3] @ here[:3, :3].T)
            return np.concatenate([T[:3, 3] - here[:3, 3], turn])

        bounds = (model.planning.lower[cut], model.planning.upper[cut])
        for q0 in starts[side][:PEER_STARTS]:
            end = least_squares(
                error, np.clip(q0, *bounds), lambda q: -jacobian(chain, q), bounds=bounds, method="trf",
                max_nfev=100,
            )  # fmt: skip
            if np.linalg.norm(end.fun) < 1e-4:
                return np.asarray(end.x)
        return None

    return solve


class _PyBullet:
    """PyBullet's `calculateInverseKinematics` (damped least squares). It tries one start after the other until a
    solution is within the limits.

    PyBullet's variant with limits and a rest pose solves only 7 % of these poses, fewer than this variant.
    """

    def __init__(self, model: RobotModel, starts: dict[Side, Array]) -> None:
        self.model, self.starts = model, starts
        self.client = pb.connect(pb.DIRECT)
        with suppress_output():
            self.body = pb.loadURDF(str(moving_urdf(DESCRIPTION)), useFixedBase=True, physicsClientId=self.client)
        joints = joint_map(self.body, self.client)
        self.arms = [joints[name] for name in JOINT_NAMES]
        order = sorted(joints.values())
        self.column = [order.index(j) for j in self.arms]
        links = range(pb.getNumJoints(self.body, physicsClientId=self.client))
        names = {pb.getJointInfo(self.body, i, physicsClientId=self.client)[12].decode(): i for i in links}
        self.tool = {side: names[f"{side}_gripper"] for side in Side}

    def __call__(self, side: Side, T: Array) -> Array | None:
        cut = arm_slice(side, 14)
        quaternion = pin.Quaternion(T[:3, :3]).coeffs()
        for q0 in self.starts[side][:PEER_STARTS]:
            both = np.array(self.model.q_park)
            both[cut] = q0
            for joint, value in zip(self.arms, both, strict=True):
                pb.resetJointState(self.body, joint, value, physicsClientId=self.client)
            found = pb.calculateInverseKinematics(
                self.body, self.tool[side], T[:3, 3].tolist(), quaternion.tolist(), maxNumIterations=200,
                residualThreshold=1e-5, physicsClientId=self.client,
            )  # fmt: skip
            q = np.array(found)[self.column][cut]
            if self._reached(side, q, T):
                return q
        return None

    def _reached(self, side: Side, q: Array, T: Array) -> bool:
        cut = arm_slice(side, 14)
        if np.any(q < self.model.planning.lower[cut]) or np.any(q > self.model.planning.upper[cut]):
            return False
        here = ik.tool_pose(self.model.chains[side], q)
        return bool(
            np.linalg.norm(here[:3, 3] - T[:3, 3]) <= POSITION
            and np.trace(here[:3, :3].T @ T[:3, :3]) >= 1.0 + 2.0 * np.cos(ANGLE)
        )
