"""Hands away from what they have done: straight up, then both arms to the parked pose. Also the way to safety."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from robots.errors import Failure
from robots.model import JointLimits, RobotModel
from robots.ports import ArmTrajectory, Array, Side
from skills.motion.moves.free_motion import plan_free_motion
from skills.motion.moves.lift import plan_lift
from skills.motion.validation.collision import CollisionChecker
from skills.vocabulary import Outcome

__all__ = ["RETREAT_HEIGHT", "Retreat", "plan_retreat"]

RETREAT_HEIGHT = 0.10
"""By which the hands rise after a fold [m]."""
SHARES = (1.0, 0.7, 0.5, 0.35)
"""Of a height that cannot be reached, tried in turn: 35 mm clear every stack."""


@dataclass(frozen=True, eq=False)
class Retreat:
    """retreat: straight up. park: on to the parked pose."""

    retreat: ArmTrajectory
    park: ArmTrajectory


def plan_retreat(
    model: RobotModel,
    checker: CollisionChecker,
    q_now: Array,
    sides: tuple[Side, ...] = tuple(Side),
    *,
    height: float = RETREAT_HEIGHT,
    limits: JointLimits | None = None,
    rng: np.random.Generator | None = None,
) -> Outcome[Retreat]:
    """Hands straight up by `height` [m] as they are, then both arms to the parked pose, from q_now (14,), at rest.

    Where the arms cannot go so high, they go as high as they can, but no less than clears a stack.
    Failures: those of `plan_lift` and `plan_free_motion`, of the first try.
    """
    limits = limits or model.planning
    why: Failure | None = None
    for share in SHARES:
        retreat = plan_lift(model, checker, q_now, sides, share * height, limits=limits)
        if retreat.ok:
            way = plan_free_motion(model, checker, retreat.unwrap().q[-1], model.q_park, limits=limits, rng=rng)
            if way.ok:
                return Outcome(Retreat(retreat.unwrap(), way.unwrap()))
        why = why or retreat.failure or way.failure
    return Outcome(failure=why)
