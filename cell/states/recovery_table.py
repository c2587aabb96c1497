"""The recovery table: what the cell does after a failure.

Every failure kind has rows. The first row that answers in the situation after the failure (situation.py) decides:
its conditions hold, and the kind has not failed more often in this fold than the row allows (`until`). The
verdicts of inspections count together. The last row of a kind has no condition: it asks the operator, and states
why the cell does not go on by itself.

Then `SUBSTITUTES` applies to all kinds, in order: the limits on the number of tries, recoveries that cannot begin
where they usually do, and the operator who is not there.

A verdict that would end a fold or a run is never taken from one look: rows of seeing look again for
`recovery.patience`, because looking moves nothing; rows of judging look again first, after a dwell.

Before a recovery is chosen, the cell lays down the cloth that the hands still hold (`LAYING`) and moves the hands
away. `python -m benchmarks.reference` writes the table into docs/look_up/recoveries.md.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace
from enum import StrEnum

from foldcell.cell.states.situation import (
    Condition,
    Situation,
    another_variant,
    carried,
    cloth_taken,
    edits_impossible,
    fold_tries_used_up,
    good_enough,
    lies_as_before,
    near_enough,
    no_trajectory,
    not_failed_alike,
    not_planned,
    not_recognised,
    patient,
    repairable,
    repairing,
    run_tries_used_up,
    spreadable,
    stood_low,
    table_unseen,
    too_many_layers,
    unattended,
)
from foldcell.cell.states.transition_table import Event
from foldcell.robots.errors import FailureKind
from foldcell.robots.ports import Side


class Adjustment(StrEnum):
    """How the next attempt differs from the failed one."""

    NONE = "none"
    LOWER = "lower"  # push the tips deeper into the garment
    HIGHER = "higher"  # leave more of the layers below: a hand held too many
    INWARD = "inward"  # grasp further inside the edge
    UPRIGHT = "upright"  # with hands that do not lean at the grasp, if they reach it so
    STRONGER = "stronger"  # grip with more force
    OPTIMISE = "optimise"  # optimise, even if the library has a trajectory
    PLAIN_ARC = "plain_arc"  # use the paper's initial arc, without optimisation
    OTHER_SEARCH = "other_search"  # another random seed for the motion planner, other hand postures
    OTHER_VARIANT = "other_variant"  # the next fold variant in the garment file, without adjustments
    NO_EDITS = "without the operator's edits"


@dataclass(frozen=True)
class Recovery:
    """One row. event: the event that leaves RECOVERING; when: conditions that all must hold; until: the row
    answers as long as this kind has failed at most so many times in the present fold.

    adjust: the change to the next attempt; dwell_s: cell time to wait before the event [s]; for a row that is
    `patient`, situation.wait_before_look says how long. not_made: whether the
    cell treats the fold, from now on, as not completed by the hands. reason: why the operator is asked, as the
    operator reads it (ASK only). limit: setting that `reason` names, GROUP.NAME.
    """

    event: Event
    adjust: Adjustment = Adjustment.NONE
    dwell_s: float = 0.0
    until: float = math.inf
    when: tuple[Condition, ...] = ()
    not_made: bool = False
    reason: str = ""
    limit: str = ""

    @property
    def looks_only(self) -> bool:
        """Whether the cell only waits and looks again. Nothing limits this but `recovery.patience`."""
        return patient in self.when

    def answers(self, s: Situation) -> bool:
        """Return whether the row answers in this situation."""
        return s.attempt <= self.until and all(holds(s) for holds in self.when)


K, A = FailureKind, Adjustment


def _in_turn(*recoveries: Recovery) -> tuple[Recovery, ...]:
    """Return the recoveries as rows that answer in turn: the first row after the first failure, and so on."""
    return tuple(replace(row, until=count) for count, row in enumerate(recoveries, 1))


def _ask(reason: str) -> tuple[Recovery]:
    return (Recovery(Event.ASK, reason=reason),)


_LOOK_TWICE = _in_turn(Recovery(Event.LOOK_AGAIN, dwell_s=1.0), Recovery(Event.LOOK_AGAIN, dwell_s=3.0))
_LOOK_PATIENTLY = (Recovery(Event.LOOK_AGAIN, when=(patient,)),)
_LOOK_ONCE_MORE = _LOOK_TWICE[:1]
_GRASP_AGAIN = _in_turn(
    Recovery(Event.GRASP_AGAIN, A.LOWER),
    Recovery(Event.GRASP_AGAIN, A.INWARD),
    Recovery(Event.LOOK_AGAIN),
)
_REACH_FURTHER = tuple(
    replace(row, when=(stood_low,))
    for row in _in_turn(Recovery(Event.GRASP_AGAIN, A.INWARD), Recovery(Event.GRASP_AGAIN, A.UPRIGHT))
)
_MOVE_TWICE = _in_turn(Recovery(Event.GRASP_AGAIN, dwell_s=0.5), Recovery(Event.GRASP_AGAIN, dwell_s=3.0))
_MOVE_AGAIN = _MOVE_TWICE[:1]
_FEEL_AGAIN = _in_turn(Recovery(Event.GRASP_AGAIN, dwell_s=1.0), Recovery(Event.GRASP_AGAIN, dwell_s=3.0))
_OTHER_WAY = _in_turn(
    Recovery(Event.GRASP_AGAIN, A.OTHER_SEARCH),
    Recovery(Event.GRASP_AGAIN, A.INWARD),
    Recovery(Event.PLAN_AGAIN, A.OTHER_VARIANT, when=(another_variant,)),
)
_HOLD_BETTER = _in_turn(Recovery(Event.LOOK_AGAIN, A.STRONGER), Recovery(Event.LOOK_AGAIN, A.INWARD))
_CARRY_ON = Recovery(Event.CARRY_ON, when=(good_enough,))
_GOOD_ENOUGH = (_CARRY_ON, *_LOOK_ONCE_MORE)
_NEAR_ENOUGH = Recovery(Event.CARRY_ON, when=(near_enough,))
"""Make the next folds although the finished garment may not be claimed: a repair was not possible or has not
helped."""
_SPREAD = Recovery(Event.SPREAD, when=(spreadable,))
"""Pull the heap apart. After a failure of recognition this is possible only if the garment was pulled before and
is still not flat: otherwise a person may have laid another garment."""
_REFUSED = (replace(_LOOK_PATIENTLY[0], until=1), _SPREAD, *_LOOK_PATIENTLY)


def _repair(adjust: Adjustment, until: int = 3) -> tuple[Recovery, ...]:
    """Return the rows for a half-made fold, which answer up to so many failures. If the garment lies as before the
    fold, the cell looks again. Otherwise it completes the fold from where its edge lies, or undoes it. A fold
    that is made anew has the change `adjust`. If it then fails in the same way, it is not made a third time."""
    when = (repairable, not_failed_alike)
    return (
        Recovery(Event.LOOK_AGAIN, adjust, until=until, when=(*when, lies_as_before), not_made=True),
        Recovery(Event.REPAIR, adjust, until=until, when=when),
    )


def _held_too_many(rows: tuple[Recovery, ...]) -> tuple[Recovery, ...]:
    """Return the rows with the adjustment HIGHER, for a hand that held too many layers."""
    return tuple(replace(r, adjust=A.HIGHER, when=(too_many_layers, *r.when)) for r in rows)


_MADE_ANEW_LOWER = (*_LOOK_ONCE_MORE, *_repair(A.LOWER))
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
    K.NO_GARMENT: (*_LOOK_PATIENTLY, *_TABLE),
    K.UNKNOWN_GARMENT: (*_REFUSED, *_TABLE),
    K.CATEGORY_MISMATCH: (*_REFUSED, *_TABLE),
    K.OUT_OF_VIEW: (*_LOOK_PATIENTLY, *_TABLE),
    K.VIEW_OBSTRUCTED: (*_LOOK_PATIENTLY, *_ask("the hand or the object that hides the view has not gone away")),
    K.NOT_FLAT: (*_REFUSED, *_TABLE),
    K.LOW_CONFIDENCE: (*_REFUSED, *_TABLE),
    K.CAMERA_FAULT: (*_LOOK_PATIENTLY, *_CAMERA),
    K.GARMENT_MOVED: (Recovery(Event.LOOK_AGAIN, dwell_s=1.0, until=3), *_ask("something keeps moving it")),
    # planning
    K.OPTIMISER_FAILED: (
        Recovery(Event.OPTIMISE_AGAIN, A.PLAIN_ARC, until=1),
        *_ask("no arc for this fold was found"),
    ),
    K.PREDICTION_POOR: (
        *_in_turn(Recovery(Event.OPTIMISE_AGAIN, A.OPTIMISE), Recovery(Event.OPTIMISE_AGAIN, A.PLAIN_ARC)),
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
    K.MISSED_GRASP: (*_held_too_many(_GRASP_AGAIN), *_REACH_FURTHER, *_GRASP_AGAIN, *_GRIP),
    K.SLIPPED: (*_HOLD_BETTER, *_GRIP),
    K.STUCK_ON_FINGER: (Recovery(Event.LOOK_AGAIN, until=1), *_ask("only a person can free the finger")),
    K.TACTILE_FAULT: (*_FEEL_AGAIN, *_ask("without its pads a hand feels neither the table nor the cloth")),
    K.GRIPPER_FAULT: (*_FEEL_AGAIN, *_ask("the gripper does not do as it is told")),
    # the fold itself; if it is only displaced, the plan is moved to it
    K.DRIFT: (Recovery(Event.CARRY_ON, when=(carried,)), *_SHAPE),
    K.OFF_TARGET: (*_GOOD_ENOUGH, *_repair(A.NONE), _NEAR_ENOUGH, _SPREAD, *_SHAPE),
    K.PILING: (*_GOOD_ENOUGH, *_repair(A.OPTIMISE), _NEAR_ENOUGH, _SPREAD, *_SHAPE),
    # the last fold stands higher than its fabric explains, and pressing has not helped: it is folded anew
    K.TOO_HIGH: (*_GOOD_ENOUGH, *_repair(A.OPTIMISE), *_SHAPE),
    K.SAG: (*_GOOD_ENOUGH, *_repair(A.OPTIMISE), _NEAR_ENOUGH, _SPREAD, *_SHAPE),
    K.DROPPED_CORNER: (*_GOOD_ENOUGH, *_repair(A.STRONGER), _NEAR_ENOUGH, _SPREAD, *_SHAPE),
    K.MISSED_LAYER: (
        _CARRY_ON,
        *_held_too_many(_MADE_ANEW_LOWER),
        *_MADE_ANEW_LOWER,
        _NEAR_ENOUGH,
        _SPREAD,
        *_SHAPE,
    ),
    # the garment lies neither as before nor as after the fold: the estimate must be the same twice
    K.HALF_FOLDED: (*_LOOK_ONCE_MORE, *_repair(A.NONE, until=4), _SPREAD, *_LIES),
    K.HEAPED: (*_LOOK_ONCE_MORE, _SPREAD, *_LIES),
    # the cell itself
    K.STOPPED: _ask(_PERSON),
    K.ABORTED: _ask(_PERSON),
    K.HARDWARE_FAULT: _ask("the robot reports a fault: a person looks at it before it moves again"),
    K.SKILL_CRASHED: _ask("the program has a bug, and doing the same again would end in the same way"),
    K.UNRECORDED: _ask("nothing may move that the journal cannot record"),
}
WITHOUT_EDITS = Recovery(Event.PLAN_AGAIN, A.NO_EDITS, when=(edits_impossible,))
"""The fold is planned as it was before the operator's edits. This row is tried before the rows of any kind, and no
substitute replaces it."""

VERDICTS = frozenset({K.OFF_TARGET, K.PILING, K.TOO_HIGH, K.SAG, K.DROPPED_CORNER, K.MISSED_LAYER})
"""Failure kinds of a fold that an inspection refuses. A second look may find another kind in the same fold, so the
failures of all these kinds are counted together."""


@dataclass(frozen=True)
class Substitute:
    """A rule that replaces a recovery. It applies if the recovery's event is in `of`, its adjustment is in
    `adjusts`, and the condition `when` holds. event: what happens instead. reason, limit: see `Recovery`. With a
    limit, nothing else of the replaced recovery is kept, and a recovery that only looks is not replaced."""

    of: frozenset[Event]
    when: Condition
    event: Event
    adjusts: frozenset[Adjustment] = frozenset(A)
    reason: str = ""
    limit: str = ""

    def answers(self, recovery: Recovery, s: Situation) -> bool:
        """Return whether this rule replaces the recovery in this situation."""
        if self.limit and recovery.looks_only:
            return False
        return recovery.event in self.of and recovery.adjust in self.adjusts and self.when(s)


_TRIES = frozenset(
    {Event.LOOK_AGAIN, Event.GRASP_AGAIN, Event.PLAN_AGAIN, Event.OPTIMISE_AGAIN, Event.REPAIR, Event.SPREAD}
)
"""Recoveries that repeat something, and are therefore limited."""
_USED_UP = "it has tried {tries} times, as often as {limit} allows"
_MADE_ANEW = frozenset({Event.REPAIR, Event.PLAN_AGAIN, Event.OPTIMISE_AGAIN})

SUBSTITUTES = (
    Substitute(_TRIES, run_tries_used_up, Event.ASK, reason=_USED_UP, limit="recovery.attempts_per_run"),
    Substitute(_TRIES, fold_tries_used_up, Event.ASK, reason=_USED_UP, limit="recovery.attempts_per_step"),
    Substitute(_MADE_ANEW, repairing, Event.LOOK_AGAIN),
    Substitute(
        frozenset({Event.GRASP_AGAIN}),
        repairing,
        Event.LOOK_AGAIN,
        frozenset({A.LOWER, A.HIGHER, A.INWARD, A.UPRIGHT}),
    ),
    Substitute(frozenset({Event.GRASP_AGAIN, Event.PLAN_AGAIN}), cloth_taken, Event.LOOK_AGAIN),
    Substitute(frozenset({Event.GRASP_AGAIN}), no_trajectory, Event.LOOK_AGAIN),
    Substitute(frozenset({Event.OPTIMISE_AGAIN}), not_planned, Event.LOOK_AGAIN),
    Substitute(frozenset({Event.PLAN_AGAIN}), not_recognised, Event.LOOK_AGAIN),
    Substitute(frozenset({Event.LOOK_AGAIN}), table_unseen, Event.START_OVER),
    Substitute(frozenset({Event.LOOK_AGAIN}), carried, Event.LOOK_AFTER),
    Substitute(frozenset({Event.ASK}), unattended, Event.GIVE_UP),
)
"""Rules that replace a recovery. They are applied in order, each to the result of the previous rules."""


def choose_recovery(s: Situation) -> Recovery:
    """Return the recovery in this situation."""
    if WITHOUT_EDITS.answers(s):
        return WITHOUT_EDITS
    recovery = next(row for row in RECOVERIES[s.kind] if row.answers(s))
    if recovery.not_made:
        s = replace(s, carried=False)
    for other in SUBSTITUTES:
        if other.answers(recovery, s):
            kept = Recovery(Event.ASK, reason=other.reason, limit=other.limit) if other.reason else recovery
            recovery = replace(kept, event=other.event)
    return recovery


def transient(kind: FailureKind) -> bool:
    """Whether the cell tries again after a failure of this kind. If not, it needs a person at once."""
    return len(RECOVERIES[kind]) > 1


class Laying(StrEnum):
    """What the hands do with the cloth that they carry when a fold has to end."""

    BACK = "back"  # return along the checked arc, release at its start
    ONWARD = "onward"  # go on along the checked arc, release at the target
    RELEASE = "release"  # open the hands where they are: they hold nothing


@dataclass(frozen=True)
class LayingRule:
    """The share of the path (lift and arc) from which on the hands go to the target instead of returning.

    all_hold: share if every hand still holds its cloth; some_hold: share if one hand lost it. NEVER: the hands
    always return.
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
hands take the shorter way. If one hand lost its cloth, they return unless the fold is nearly done."""


def choose_laying(kind: FailureKind, progress: float, held: Collection[Side], holding: Collection[Side]) -> Laying:
    """Choose what to do with the cloth in the hands after a failure of this kind.

    progress: share of the path (lift and arc) that the hands have covered; held: the hands that took cloth;
    holding: the hands that still hold their cloth.
    """
    if not holding:
        return Laying.RELEASE
    rule = LAYING.get(kind, LayingRule())
    onward_from = rule.all_hold if set(holding) == set(held) else rule.some_hold
    return Laying.ONWARD if progress >= onward_from else Laying.BACK
