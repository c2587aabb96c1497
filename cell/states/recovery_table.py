"""The recovery table: (failure kind, number of failures so far) -> what to try next.

The recoveries of a row are tried in order, counted per fold step and failure kind. After the last one the cell
asks the operator, or gives up if there is no operator. CARRY_ON has no limit: a fold that is good enough once is
good enough again.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum

from cell.states.transition_table import Event
from robots.errors import FailureKind

__all__ = ["RECOVERIES", "Adjustment", "Recovery", "choose_recovery"]


class Adjustment(StrEnum):
    """How the next attempt differs from the failed one."""

    NONE = "none"
    LOWER = "lower"  # press the tips deeper into the garment
    INWARD = "inward"  # grasp further inside the edge
    STRONGER = "stronger"  # grip with more force
    OPTIMISE = "optimise"  # optimise, even if the library has a trajectory
    PLAIN_ARC = "plain_arc"  # use the paper's initial arc, without optimisation
    OTHER_SEARCH = "other_search"  # another random seed for the motion planner, other hand postures
    OTHER_VARIANT = "other_variant"  # the next fold variant in the garment file, without adjustments


@dataclass(frozen=True)
class Recovery:
    """One recovery. event: the event that leaves RECOVERING; adjust: the change to the next attempt; dwell_s: cell
    time to wait before the event [s].

    between_folds: the recovery is allowed only if another fold follows. It is not allowed after the last fold,
    because the result of the last fold is the result of the run. min_overlap: smallest IoU of
    observed and predicted shape for which the recovery is allowed.
    """

    event: Event
    adjust: Adjustment = Adjustment.NONE
    dwell_s: float = 0.0
    between_folds: bool = False
    min_overlap: float = 0.0


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
_GOOD_ENOUGH = (Recovery(Event.CARRY_ON, between_folds=True, min_overlap=0.85),)

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
    K.DRIFT: (Recovery(Event.CARRY_ON),),  # the shape is right but displaced: the plan is moved to it
    K.OFF_TARGET: _GOOD_ENOUGH,
    K.PILING: _GOOD_ENOUGH,
    K.TOO_HIGH: _GOOD_ENOUGH,
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
    several_variants: bool = True,
) -> Recovery:
    """Return the recovery after failure number `attempt` (from 1) of this kind in this step.

    overlap: IoU of observed and predicted shape, if an inspection failed. several_variants: whether the garment
    file has more than one variant of this step. A kind without a row (a stop, a hardware fault, an unexpected
    garment) has no automatic recovery: the operator is asked, or the run gives up.
    """
    row = RECOVERIES.get(kind, ())
    if row and (attempt <= len(row) or row[-1].event is Event.CARRY_ON):
        recovery = row[min(attempt, len(row)) - 1]
        possible = several_variants or recovery.adjust is not Adjustment.OTHER_VARIANT
        if possible and overlap >= recovery.min_overlap and not (last_fold and recovery.between_folds):
            return recovery
    return Recovery(Event.ASK if attended else Event.GIVE_UP)
