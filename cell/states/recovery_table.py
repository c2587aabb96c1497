"""The recovery table: (failure kind, number of failures so far) -> what to try next.

Every failure kind has a row. Its recoveries are tried in order, counted per fold step and failure kind (per fold
step alone for the verdicts of an inspection). CARRY_ON comes before all others and has no limit: a fold that is
good enough once is good enough again. SPREAD has no limit of its own in a row either: it comes at its place among
the others, as long as a pull may spread the garment further (`recovery.pulls`). The last entry of a row asks the
operator, or gives up if there is no operator; it states why the cell does not go on by itself.

A verdict that would end a fold or a run is never taken from one look: rows of seeing and judging look again first,
after a dwell. Together the dwells of a row outlast a disturbance of 3 s.

Before a recovery is chosen, the cell lays down the cloth that the hands still hold (LAYING) and moves the hands
away, twice if need be (CLEARING_DWELL_S).
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace
from enum import StrEnum

from cell.states.transition_table import Event
from robots.errors import FailureKind
from robots.ports import Side

__all__ = [
    "CLEARING_DWELL_S",
    "GOOD_ENOUGH_M",
    "LAYING",
    "LAYING_DWELL_S",
    "LAYING_TRIES",
    "PREPARING_DWELLS_S",
    "RECOVERIES",
    "VERDICTS",
    "Adjustment",
    "Laying",
    "LayingRule",
    "Recovery",
    "choose_laying",
    "choose_recovery",
    "transient",
]

GOOD_ENOUGH_M = 0.030
"""Largest deviation of the outline from the prediction, and largest length of cloth that was left behind, on which
the next fold may build [m]. Later folds do not bring an edge back: what is off now is off at the end. The score
allows 30 mm between edges that belong together, so a run with more cannot pass, whatever follows."""


class Adjustment(StrEnum):
    """How the next attempt differs from the failed one."""

    NONE = "none"
    LOWER = "lower"  # press the tips deeper into the garment
    HIGHER = "higher"  # leave more of the layers below: a hand held too many
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
    observed and predicted shape for which the recovery is allowed; max_deviation: largest deviation of the outline
    or length of cloth left behind for which it is allowed [m]. reason: why the operator is asked, as the operator
    reads it (ASK only).
    """

    event: Event
    adjust: Adjustment = Adjustment.NONE
    dwell_s: float = 0.0
    between_folds: bool = False
    min_overlap: float = 0.0
    max_deviation: float = math.inf
    reason: str = ""


K, A = FailureKind, Adjustment

_LOOK_TWICE = (Recovery(Event.LOOK_AGAIN, dwell_s=1.0), Recovery(Event.LOOK_AGAIN, dwell_s=3.0))
_WAIT_AND_LOOK = (*_LOOK_TWICE, Recovery(Event.LOOK_AGAIN, dwell_s=5.0))
_LOOK_ONCE_MORE = (Recovery(Event.LOOK_AGAIN, dwell_s=1.0),)
_GRASP_AGAIN = (
    Recovery(Event.GRASP_AGAIN, A.LOWER),
    Recovery(Event.GRASP_AGAIN, A.INWARD),
    Recovery(Event.LOOK_AGAIN),
)
_MOVE_AGAIN = (Recovery(Event.GRASP_AGAIN, dwell_s=0.5),)
_MOVE_TWICE = (*_MOVE_AGAIN, Recovery(Event.GRASP_AGAIN, dwell_s=3.0))
_OTHER_WAY = (
    Recovery(Event.GRASP_AGAIN, A.OTHER_SEARCH),
    Recovery(Event.GRASP_AGAIN, A.INWARD),
    Recovery(Event.PLAN_AGAIN, A.OTHER_VARIANT),
)
_HOLD_BETTER = (Recovery(Event.LOOK_AGAIN, A.STRONGER), Recovery(Event.LOOK_AGAIN, A.INWARD))
_GOOD_ENOUGH = (
    Recovery(Event.CARRY_ON, between_folds=True, min_overlap=0.85, max_deviation=GOOD_ENOUGH_M),
    Recovery(Event.LOOK_AGAIN, dwell_s=1.0),
)


def _repair(adjust: Adjustment) -> tuple[Recovery, ...]:
    """Complete the fold from where its edge lies, or undo it and make it anew with this change: twice at most."""
    return Recovery(Event.REPAIR, adjust), Recovery(Event.REPAIR, adjust)


_SPREAD = (Recovery(Event.SPREAD),)
"""Pull the heap apart. For the rows of recognition it is allowed only after a pull, when the garment is still not
flat."""
_REFUSED = (_LOOK_TWICE[0], *_SPREAD, _LOOK_TWICE[1])


def _ask(reason: str) -> tuple[Recovery]:
    return (Recovery(Event.ASK, reason=reason),)


_TABLE = _ask("only a person can change what lies on the table, or name another garment")
_CAMERA = _ask("the cell moves no hand onto a garment that it cannot see")
_ARMS = _ask("the arms do not follow or do not answer, and the cause may be an obstacle or a broken part")
_WAY = _ask("the arms reach this fold in none of the ways that the garment file allows")
_GRIP = _ask("another grasp of the same kind would fail again and drag the garment")
_SHAPE = _ask("the next folds do not mend what is off now, and the fold is not the one that was planned")
_LIES = _ask("the garment lies neither as before nor as after the fold, and no grasp of the plan fits it")
_PERSON = "a person ended the motion, and only a person begins it again"

RECOVERIES: Mapping[FailureKind, tuple[Recovery, ...]] = {
    # seeing
    K.NO_GARMENT: (*_LOOK_TWICE, *_TABLE),
    K.UNKNOWN_GARMENT: (*_REFUSED, *_TABLE),
    K.CATEGORY_MISMATCH: (*_REFUSED, *_TABLE),
    K.OUT_OF_VIEW: (*_LOOK_TWICE, *_TABLE),
    K.VIEW_OBSTRUCTED: (*_WAIT_AND_LOOK, *_ask("the hand or the object that hides the view has not gone away")),
    K.NOT_FLAT: (*_REFUSED, *_TABLE),
    K.LOW_CONFIDENCE: (*_REFUSED, *_TABLE),
    K.CAMERA_FAULT: (*_LOOK_TWICE, *_CAMERA),
    K.GARMENT_MOVED: (*((Recovery(Event.LOOK_AGAIN, dwell_s=1.0),) * 3), *_ask("something keeps moving it")),
    # planning
    K.OPTIMISER_FAILED: (Recovery(Event.OPTIMISE_AGAIN, A.PLAIN_ARC), *_ask("no arc for this fold was found")),
    K.PREDICTION_POOR: (
        Recovery(Event.OPTIMISE_AGAIN, A.OPTIMISE),
        Recovery(Event.OPTIMISE_AGAIN, A.PLAIN_ARC),
        *_ask("every arc is predicted to fold the garment badly"),
    ),
    K.UNREACHABLE: (*_OTHER_WAY, *_WAY),
    K.IN_COLLISION: (*_OTHER_WAY, *_WAY),
    K.LIMIT_EXCEEDED: (*_MOVE_AGAIN, *_ARMS),
    # moving
    K.START_MISMATCH: (*_MOVE_AGAIN, *_ARMS),
    K.TRACKING_ERROR: (*_MOVE_AGAIN, *_ARMS),
    K.STALE_STATE: (*_MOVE_TWICE, *_ARMS),
    # gripping
    K.NO_CONTACT: (*_GRASP_AGAIN, *_GRIP),
    K.MISSED_GRASP: (*_GRASP_AGAIN, *_GRIP),
    K.SLIPPED: (*_HOLD_BETTER, *_GRIP),
    K.STUCK_ON_FINGER: (Recovery(Event.LOOK_AGAIN), *_ask("only a person can free the finger")),
    K.TACTILE_FAULT: (
        Recovery(Event.GRASP_AGAIN, dwell_s=1.0),
        Recovery(Event.GRASP_AGAIN, dwell_s=3.0),
        *_ask("without its pads a hand feels neither the table nor the cloth"),
    ),
    K.GRIPPER_FAULT: (
        Recovery(Event.GRASP_AGAIN, dwell_s=1.0),
        Recovery(Event.GRASP_AGAIN, dwell_s=3.0),
        *_ask("the gripper does not do as it is told"),
    ),
    # the fold itself
    K.DRIFT: (Recovery(Event.CARRY_ON), *_SHAPE),  # the shape is right but displaced: the plan is moved to it
    K.OFF_TARGET: (*_GOOD_ENOUGH, *_repair(A.NONE), *_SHAPE),
    K.PILING: (*_GOOD_ENOUGH, *_repair(A.OPTIMISE), *_SHAPE),
    # the last fold stands higher than its fabric explains, and pressing has not helped: it is folded anew
    K.TOO_HIGH: (*_GOOD_ENOUGH, *_repair(A.OPTIMISE), *_SHAPE),
    K.SAG: (*_GOOD_ENOUGH, *_repair(A.OPTIMISE), *_SHAPE),
    K.DROPPED_CORNER: (*_GOOD_ENOUGH, *_repair(A.STRONGER), *_SHAPE),
    K.MISSED_LAYER: (*_GOOD_ENOUGH, *_repair(A.LOWER), *_SHAPE),
    # the garment lies neither as before nor as after the fold: the estimate must be the same twice
    K.HALF_FOLDED: (*_LOOK_ONCE_MORE, *_repair(A.NONE), *_SPREAD, *_LIES),
    K.HEAPED: (*_LOOK_ONCE_MORE, *_SPREAD, *_LIES),
    # the cell itself
    K.STOPPED: _ask(_PERSON),
    K.ABORTED: _ask(_PERSON),
    K.HARDWARE_FAULT: _ask("the robot reports a fault: a person looks at it before it moves again"),
    K.SKILL_CRASHED: _ask("the program has a bug, and doing the same again would end in the same way"),
    K.UNRECORDED: _ask("nothing may move that the journal cannot record"),
}

VERDICTS = frozenset({K.OFF_TARGET, K.PILING, K.TOO_HIGH, K.SAG, K.DROPPED_CORNER, K.MISSED_LAYER})
"""Kinds with which an inspection refuses a fold. A second look may name another of them, so they are counted
together."""


CLEARING_DWELL_S = 2.0
"""After a failure of CLEARING, the cell waits for this time before CLEARING_AGAIN [s]. It is longer than most
transients, such as an arm that hangs for a moment."""


PREPARING_DWELLS_S = (1.0, 3.0)
"""PREPARING and RESUMING are tried again after each of these times [s], if the kind of failure is transient."""


def transient(kind: FailureKind) -> bool:
    """Whether the cell tries again after a failure of this kind. The others need a person at once."""
    return len(RECOVERIES[kind]) > 1


class Laying(StrEnum):
    """What the hands do with the cloth that they carry when a fold has to end."""

    BACK = "back"  # return along the checked arc, release at its start
    ONWARD = "onward"  # go on along the checked arc, release at the target
    RELEASE = "release"  # open the hands where they are: they hold nothing


@dataclass(frozen=True)
class LayingRule:
    """From which share of the path, lift and arc, the hands go on to the target instead of returning.

    all_hold: if every hand still holds its cloth; some_hold: if one hand lost it. NEVER: the hands always return.
    """

    all_hold: float = 0.5
    some_hold: float = 0.8


NEVER = 2.0

LAYING: Mapping[FailureKind, LayingRule] = {
    # something may stand in the way, and the way back was free; near the target, one hand alone would drag the
    # whole fold back into a heap
    K.TRACKING_ERROR: LayingRule(all_hold=0.9, some_hold=0.9),
    K.IN_COLLISION: LayingRule(NEVER, NEVER),
}
"""Failure kind -> rule. Kinds without an entry, the operator's abort among them, have the rule `LayingRule()`: the
hands take the shorter way, but with a lost corner they return, unless the fold is nearly done."""

LAYING_TRIES = 3
"""Number of times that the hands try to follow the path. Each time the arms come to rest first."""
LAYING_DWELL_S = 0.8
"""Pause between two of these tries [s]."""


def choose_laying(kind: FailureKind, progress: float, held: Collection[Side], holding: Collection[Side]) -> Laying:
    """Choose what to do with the cloth in the hands after a failure of this kind.

    progress: share of the path, lift and arc, that the hands have come; held: the hands that took cloth; holding:
    those of them that still hold it.
    """
    if not holding:
        return Laying.RELEASE
    rule = LAYING.get(kind, LayingRule())
    onward_from = rule.all_hold if set(holding) == set(held) else rule.some_hold
    return Laying.ONWARD if progress >= onward_from else Laying.BACK


def choose_recovery(
    kind: FailureKind,
    attempt: int,
    attended: bool,
    last_fold: bool = False,
    overlap: float = 1.0,
    other_variant: bool = True,
    deviation: float = 0.0,
    carried: bool = True,
    repairable: bool = False,
    spreadable: bool = False,
) -> Recovery:
    """Return the recovery after failure number `attempt` (from 1) of this kind in this step.

    overlap: IoU of observed and predicted shape, and deviation: the larger of the outline's deviation and the
    length of cloth left behind [m], if an inspection failed. other_variant: whether the garment file has a variant
    of this step that was not tried. carried: whether the hands completed the fold; otherwise it cannot be carried
    on from. repairable: whether it is known well enough how the garment lies to repair the fold. spreadable:
    whether a pull may spread the garment.
    """

    def allowed(recovery: Recovery) -> bool:
        good_enough = overlap >= recovery.min_overlap and deviation <= recovery.max_deviation
        in_place = not (last_fold and recovery.between_folds)
        return (
            good_enough
            and in_place
            and (carried or recovery.event is not Event.CARRY_ON)
            and (other_variant or recovery.adjust is not Adjustment.OTHER_VARIANT)
        )

    *recoveries, ask = RECOVERIES[kind]
    for recovery in recoveries:
        if recovery.event is Event.CARRY_ON and allowed(recovery):
            return recovery
    possible = {Event.REPAIR: repairable, Event.SPREAD: spreadable, Event.CARRY_ON: False}
    tries = [r for r in recoveries if possible.get(r.event, True)]
    for place, recovery in enumerate(tries):
        if recovery.event is Event.SPREAD and attempt > place:
            return recovery
    if attempt <= len(tries) and allowed(tries[attempt - 1]):
        return tries[attempt - 1]
    return ask if attended else replace(ask, event=Event.GIVE_UP)
