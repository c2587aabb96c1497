"""The fallback table as data: what failed, and how often by now -> what to try next. No code but the look-up.

The tries of a row are taken one after the other, counted per fold step and failure kind; after the last
one the cell asks the operator, or gives up when nobody attends. To carry on is no try that could be used up: what
is good enough once is so when it is looked at again.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum

from cell.states.transition_table import Event
from robots.errors import FailureKind

__all__ = ["RECOVERIES", "Adjustment", "Recovery", "choose_recovery"]


class Adjustment(StrEnum):
    """How the next try differs from the one that failed."""

    NONE = "none"
    LOWER = "lower"  # press the tips deeper into the garment
    INWARD = "inward"  # take hold further inside the edge
    STRONGER = "stronger"  # squeeze harder
    OPTIMISE = "optimise"  # do not take the library's trajectory
    PLAIN_ARC = "plain_arc"  # the paper's initial arc instead of an optimised one
    OTHER_SEARCH = "other_search"  # another draw of the motion planner
    OTHER_VARIANT = "other_variant"  # the plan's next way to make the fold, which begins anew


@dataclass(frozen=True)
class Recovery:
    """The event that leads on from RECOVERING, what to change, how long to wait before [s of cell time].

    between_folds: not for the last fold, whose result is the run's. least_overlap: with the predicted shape,
    below which it is not tried.
    """

    event: Event
    adjust: Adjustment = Adjustment.NONE
    dwell_s: float = 0.0
    between_folds: bool = False
    least_overlap: float = 0.0


K, A = FailureKind, Adjustment

_LOOK_TWICE = (Recovery(Event.LOOK_AGAIN, dwell_s=1.0), Recovery(Event.LOOK_AGAIN, dwell_s=3.0))
_GRASP_AGAIN = (
    Recovery(Event.GRASP_AGAIN, A.LOWER),
    Recovery(Event.GRASP_AGAIN, A.INWARD),
    Recovery(Event.LOOK_AGAIN),
)
_MOVE_AGAIN = (Recovery(Event.GRASP_AGAIN, dwell_s=0.5),)
_OTHER_WAY = (
    Recovery(Event.GRASP_AGAIN, A.OTHER_SEARCH),
    Recovery(Event.GRASP_AGAIN, A.INWARD),
    Recovery(Event.PLAN_AGAIN, A.OTHER_VARIANT),
)
_HOLD_BETTER = (Recovery(Event.LOOK_AGAIN, A.STRONGER), Recovery(Event.LOOK_AGAIN, A.INWARD))
_GOOD_ENOUGH = (Recovery(Event.CARRY_ON, between_folds=True, least_overlap=0.85),)

RECOVERIES: Mapping[FailureKind, tuple[Recovery, ...]] = {
    # seeing
    K.NO_GARMENT: _LOOK_TWICE,
    K.LOW_CONFIDENCE: _LOOK_TWICE,
    K.NOT_FLAT: _LOOK_TWICE,
    K.CAMERA_FAULT: _LOOK_TWICE,
    # planning
    K.OPTIMISER_FAILED: (Recovery(Event.OPTIMISE_AGAIN, A.PLAIN_ARC),),
    K.PREDICTION_POOR: (
        Recovery(Event.OPTIMISE_AGAIN, A.OPTIMISE),
        Recovery(Event.OPTIMISE_AGAIN, A.PLAIN_ARC),
    ),
    K.UNREACHABLE: _OTHER_WAY,
    K.IN_COLLISION: _OTHER_WAY,
    # moving
    K.START_MISMATCH: _MOVE_AGAIN,
    K.TRACKING_ERROR: _MOVE_AGAIN,
    K.STALE_STATE: _MOVE_AGAIN,
    # gripping
    K.NO_CONTACT: _GRASP_AGAIN,
    K.MISSED_GRASP: _GRASP_AGAIN,
    K.SLIPPED: _HOLD_BETTER,
    K.STUCK_ON_FINGER: (Recovery(Event.LOOK_AGAIN),),
    # the fold itself
    K.DRIFT: (Recovery(Event.CARRY_ON),),  # the right shape in another place, which the plan follows: folded
    K.OFF_TARGET: _GOOD_ENOUGH,
    K.PILING: _GOOD_ENOUGH,
    K.SAG: _GOOD_ENOUGH,
    K.DROPPED_CORNER: _GOOD_ENOUGH,
    K.MISSED_LAYER: _GOOD_ENOUGH,
}


def choose_recovery(
    kind: FailureKind,
    attempt: int,
    attended: bool,
    last_fold: bool = False,
    overlap: float = 1.0,
    several_ways: bool = True,
) -> Recovery:
    """What to do after the `attempt`-th failure (from 1) of this kind in this step.

    overlap: of the observed with the predicted shape, where an inspection failed. several_ways: whether the plan
    has more than one for this step.

    What stands in no row (a stop, a hardware fault, a garment that is not the one expected) is never
    retried by itself.
    """
    tries = RECOVERIES.get(kind, ())
    if tries and (attempt <= len(tries) or tries[-1].event is Event.CARRY_ON):
        recovery = tries[min(attempt, len(tries)) - 1]
        possible = several_ways or recovery.adjust is not Adjustment.OTHER_VARIANT
        if possible and overlap >= recovery.least_overlap and not (last_fold and recovery.between_folds):
            return recovery
    return Recovery(Event.ASK if attended else Event.GIVE_UP)
