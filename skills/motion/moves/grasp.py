"""Plans the approach to poses above the grasps, and straight descents to the grasps and a little deeper."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from foldcell.robots.model import JointLimits, RobotModel
from foldcell.robots.ports import ArmTrajectory, Array, Side, arm_slice, frozen
from foldcell.skills.motion.kinematics import ik
from foldcell.skills.motion.kinematics.posture import Posture, in_base
from foldcell.skills.motion.moves.free_motion import plan_free_motion
from foldcell.skills.motion.validation.collision import CollisionChecker
from foldcell.skills.motion.validation.failures import (
    out_of_reach,
    too_near,
    validate_height,
    validate_paths,
    validate_state,
)
from foldcell.skills.vocabulary import Failed, GraspId, Outcome, Table, ToolPath, refuse, skill

APPROACH_HEIGHT = 0.08
"""Height above a grasp at which the straight descent begins [m]."""
OVERTRAVEL = 0.015
"""If a descent meets no contact, it continues to this depth below the planned grasp [m]."""
PUSHED = 0.006
"""A hand must be able to go so far below its grasp [m], because it is pushed onto the cloth before it closes."""
STEP = 0.002
"""Distance between the joint samples of a descent [m]."""
LARGEST_TURN = 0.05
"""Largest step of a joint between two samples [rad]. A descent is streamed by its depth, at up to 60 mm/s: near
the end of an arm's reach, a joint would otherwise be told to jump."""


@dataclass(frozen=True, eq=False)
class Descent:
    """One arm's straight descent.

    depth: (m,) distance below the start of the descent, which lies above the grasp [m]. q: (m, arm) joints at
    these depths. grasp_depth: depth of the planned grasp [m]. The descent continues below it by the overtravel, or
    as far as the arm reaches, but by `PUSHED` at least.
    """

    q: Array
    depth: Array
    grasp_depth: float

    def at(self, depth: float) -> Array:
        """Return the joints (arm,) at a depth [m], which is limited to the range of `depth`."""
        return np.array([np.interp(depth, self.depth, self.q[:, k]) for k in range(self.q.shape[1])])


@dataclass(frozen=True, eq=False)
class GraspMotion:
    """Motion to the grasps. approach: of both arms, to poses above the grasps. descend: the straight descent of
    each arm in use, by arm."""

    approach: ArmTrajectory
    descend: Mapping[Side, Descent]

    @property
    def q_above(self) -> Array:
        return self.approach.q[-1]

    @property
    def q_grasp(self) -> Array:
        """Joints (joints,) with every hand at its planned grasp."""
        q = np.array(self.q_above)
        for side, descent in self.descend.items():
            q[arm_slice(side, len(q))] = descent.at(descent.grasp_depth)
        return frozen(q)


@skill
def plan_grasp(
    model: RobotModel,
    checker: CollisionChecker,
    table: Table,
    paths: Mapping[GraspId, ToolPath],
    postures: Mapping[Side, Posture],
    q_now: Array,
    *,
    limits: JointLimits | None = None,
    approach_height: float = APPROACH_HEIGHT,
    overtravel: float = OVERTRAVEL,
    q_hint: Mapping[Side, Array] | None = None,
    rng: np.random.Generator | None = None,
) -> Outcome[GraspMotion]:
    """Plan the approach to `approach_height` [m] above the start of each path, and each arm's straight descent.

    postures: by arm. paths: as for `plan_hands_motion`; to try a grasp at another place, pass shifted paths.
    q_hint: joints (arm,) near those at the start of the descent, by arm; None: the arms' present joints. Failures:
    STALE_STATE (q_now is not a valid state), LIMIT_EXCEEDED (a height is negative, too large or not finite),
    UNREACHABLE, IN_COLLISION, those of `plan_free_motion`.
    """
    limits = limits or model.planning
    refuse(
        validate_state(model, q_now)
        or validate_paths(paths)
        or validate_height(approach_height)
        or validate_height(overtravel)
    )
    q_above = np.array(q_now)
    descend: dict[Side, Descent] = {}
    for side, posture in postures.items():
        seed = q_hint[side] if q_hint else q_now[model.arm(side)]
        descend[side] = _plan_descent(
            model, table, side, posture, paths[posture.path], seed, approach_height, overtravel
        )
        q_above[model.arm(side)] = descend[side].q[0]
    contact = checker.first_collision(_simultaneous_descents(q_above, descend), allow_fingertips=True)
    if contact is not None:
        return Outcome(failure=too_near("the descent", str(contact)))
    approach = plan_free_motion(model, checker, q_now, q_above, limits=limits, rng=rng).unwrap()
    return Outcome(GraspMotion(approach, descend))


def _plan_descent(
    model: RobotModel,
    table: Table,
    side: Side,
    posture: Posture,
    path: ToolPath,
    seed: Array,
    above: float,
    overtravel: float,
) -> Descent:
    """Plan the descent of one arm. Raises Failed: UNREACHABLE."""
    to_grasp = np.linspace(0.0, above, int(np.ceil(above / STEP)) + 1)
    beyond = np.linspace(0.0, overtravel, int(np.ceil(overtravel / STEP)) + 1)
    depth = np.concatenate([to_grasp, above + beyond[1:]])
    n = len(depth) - 1
    position = np.tile(in_base(table, path.position[:1])[0], (n + 1, 1))
    position[:, 2] += above - depth
    rotation = np.tile(posture.rotation(path)[:1], (n + 1, 1, 1))
    start = np.eye(4)
    start[:3, :3], start[:3, 3] = rotation[0], position[0]
    q0 = ik.solve_pose(model, side, start, seed, gain=0.0)
    if q0 is None:
        raise Failed(out_of_reach(table, side, "the point above the grasp", position[0]))
    q = ik.follow_path(model, side, rotation, position, q0, max_step=LARGEST_TURN)
    reached = len(q)
    if reached < len(to_grasp) + np.count_nonzero(beyond[1:] <= PUSHED):
        raise Failed(out_of_reach(table, side, "the descent", position[reached]))
    return Descent(frozen(q), frozen(depth[:reached]), above)


def _simultaneous_descents(q_above: Array, descend: Mapping[Side, Descent]) -> Array:
    """Sample the joints (12, joints) while all hands descend simultaneously to their planned grasps."""
    q = np.tile(q_above, (12, 1))
    for i, share in enumerate(np.linspace(0.0, 1.0, len(q))):
        for side, descent in descend.items():
            q[i, arm_slice(side, q.shape[1])] = descent.at(share * descent.grasp_depth)
    return q
