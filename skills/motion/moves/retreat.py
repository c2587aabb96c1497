"""Plans the retreat after a fold or a failure: the hands move straight up, then both arms to the parked pose."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from foldcell.robots.errors import Failure
from foldcell.robots.model import JointLimits, RobotModel
from foldcell.robots.ports import ArmTrajectory, Array, Side
from foldcell.skills.motion.moves.free_motion import plan_free_motion
from foldcell.skills.motion.moves.lift import plan_lift
from foldcell.skills.motion.validation.collision import CollisionChecker
from foldcell.skills.vocabulary import Outcome

RETREAT_HEIGHT = 0.10
"""Height by which the hands rise after a fold [m]."""
HEIGHT_SHARES = (1.0, 0.7, 0.5, 0.35)
"""Shares of the retreat's height that are tried in turn. Even the smallest, 35 mm of 100 mm, clears every
stack."""


@dataclass(frozen=True, eq=False)
class Retreat:
    """The two parts of a retreat. retreat: straight up. park: from there to the parked pose."""

    retreat: ArmTrajectory
    park: ArmTrajectory


def plan_retreat(
    model: RobotModel,
    checker: CollisionChecker,
    q_now: Array,
    sides: tuple[Side, ...] = tuple(Side),
    *,
    limits: JointLimits | None = None,
    rng: np.random.Generator | None = None,
) -> Outcome[Retreat]:
    """Plan a straight lift by RETREAT_HEIGHT from q_now (joints,), at rest, then both arms to the parked pose.

    If the retreat by the full height fails, smaller heights are tried (HEIGHT_SHARES). Failures: those of
    `plan_lift` and `plan_free_motion`, for the full height.
    """
    limits = limits or model.planning
    first_failure: Failure | None = None
    for share in HEIGHT_SHARES:
        retreat = plan_lift(model, checker, q_now, sides, share * RETREAT_HEIGHT, limits=limits)
        if retreat.ok:
            park = plan_free_motion(model, checker, retreat.unwrap().q[-1], model.q_park, limits=limits, rng=rng)
            if park.ok:
                return Outcome(Retreat(retreat.unwrap(), park.unwrap()))
        first_failure = first_failure or retreat.failure or park.failure
    return Outcome(failure=first_failure)
