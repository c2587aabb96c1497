"""The situation after a failure, and the named conditions by which the recovery table tells situations apart."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from foldcell.robots.errors import FailureKind

GOOD_ENOUGH_M = 0.030
"""The next fold may be made if the outline deviates from the prediction by at most this, and if the cloth left
behind is at most this long [m]. Later folds do not bring an edge back, so its error remains to the end. The score
allows 30 mm between edges that belong together, so a run with more cannot pass, whatever follows."""
GOOD_ENOUGH_IOU = 0.85
"""The next fold may be made if the IoU of observed and predicted shape is at least this."""
PLANNING_FAILURES = frozenset(
    {
        FailureKind.LOW_CONFIDENCE,
        FailureKind.OPTIMISER_FAILED,
        FailureKind.PREDICTION_POOR,
        FailureKind.UNREACHABLE,
        FailureKind.IN_COLLISION,
        FailureKind.LIMIT_EXCEEDED,
    }
)
"""If the planning of an edited fold ends with one of these failures, the fold cannot be made as edited."""
SEEING_FAILURES = frozenset(
    {
        FailureKind.NO_GARMENT,
        FailureKind.UNKNOWN_GARMENT,
        FailureKind.CATEGORY_MISMATCH,
        FailureKind.OUT_OF_VIEW,
        FailureKind.VIEW_OBSTRUCTED,
        FailureKind.NOT_FLAT,
        FailureKind.LOW_CONFIDENCE,
        FailureKind.CAMERA_FAULT,
    }
)
"""After these failures the cell has only looked. To look again moves nothing and costs only time."""


@dataclass(frozen=True)
class Situation:
    """What is known after a failure. The defaults are those of a planned fold, before the hands take cloth.

    attempt: number of failures of this kind in the present fold, this one included; the verdicts of inspections
    count together. patience_s: how long the cell looks again after a failure of seeing [s]. edited: whether the
    operator has changed the plan of the fold, and the hands have not approached yet. held: whether a hand holds
    cloth. If an inspection failed, overlap: IoU of observed and predicted shape; deviation_m: the largest of the
    outline's deviation, the length of cloth left behind, and how far a fold that is surely half made lies off its
    place [m]; lasting_defect: whether the finished garment would fail by the shape of this fold. The conditions
    below explain the other values.
    """

    kind: FailureKind
    attempt: int = 1
    patience_s: float = 30.0
    attended: bool = False
    fold_tries_left: bool = True
    run_tries_left: bool = True
    last_fold: bool = False
    edited: bool = False
    other_variant: bool = False
    carried: bool = False
    held: bool = False
    repairing: bool = False
    overlap: float = 1.0
    deviation_m: float = 0.0
    lasting_defect: bool = False
    too_many_layers: bool = False
    stood_low: bool = False
    repairable: bool = False
    failed_alike: bool = False
    lies_as_before: bool = False
    spreadable: bool = False
    table_seen: bool = True
    recognised: bool = True
    planned: bool = True
    trajectory: bool = True


@dataclass(frozen=True)
class Condition:
    """A condition by which the recovery table tells situations apart. says: when it holds, for the operator."""

    name: str
    says: str
    holds: Callable[[Situation], bool]

    def __call__(self, s: Situation) -> bool:
        return self.holds(s)


def wait_before_look(attempt: int, patience_s: float) -> tuple[float, float]:
    """Return how long the cell waits before it looks again after so many failures of seeing, and how long it will
    still wait after that [s]. The waits double: 1, 2, 4 s and so on, `patience_s` in all; then both are 0."""
    waited = 2.0 ** (attempt - 1) - 1.0
    left = max(0.0, patience_s - waited)
    wait = min(left, waited + 1.0)
    return wait, left - wait


edits_impossible = Condition(
    "edits impossible",
    "the fold cannot be planned as the operator has changed it",
    lambda s: s.edited and s.kind in PLANNING_FAILURES,
)
carried = Condition("carried", "the hands completed the fold", lambda s: s.carried)
near_enough = Condition(
    "near enough",
    "the hands completed the fold, another fold follows, and this one is near enough to its prediction for it: an"
    " IoU of at least 0.85, and edges at most 30 mm off",
    lambda s: s.carried and not s.last_fold and s.overlap >= GOOD_ENOUGH_IOU and s.deviation_m <= GOOD_ENOUGH_M,
)
good_enough = Condition(
    "good enough",
    "the next fold can build on this one (an IoU of at least 0.85, edges at most 30 mm off), and this one has no"
    " defect of its shape that spoils the finished garment",
    lambda s: near_enough(s) and not s.lasting_defect,
)
patient = Condition(
    "patient",
    "the cell has waited for less than `recovery.patience`: 1 s at first, then twice as long each time",
    lambda s: wait_before_look(s.attempt, s.patience_s)[0] > 0,
)
too_many_layers = Condition("too many layers", "a hand held more layers than planned", lambda s: s.too_many_layers)
stood_low = Condition(
    "stood low",
    "the hand stood low enough for the lowest layer: the layers that it missed end beside its pads",
    lambda s: s.stood_low,
)
repairable = Condition(
    "repairable",
    "it is known well enough how the garment lies to complete or to undo the fold",
    lambda s: s.repairable,
)
not_failed_alike = Condition(
    "not failed alike",
    "the fold was not already made anew and refused for the same reason",
    lambda s: not s.failed_alike,
)
lies_as_before = Condition(
    "lies as before",
    "the garment is estimated to lie as before the fold, so that there is nothing to repair",
    lambda s: s.lies_as_before,
)
spreadable = Condition(
    "spreadable",
    "a pull may spread the garment: it is the first fold, which no inspection has found good, the garment was seen"
    " flat, and `recovery.pulls` are left",
    lambda s: s.spreadable,
)
another_variant = Condition(
    "another variant", "the garment file has a variant of this fold that was not tried", lambda s: s.other_variant
)
run_tries_used_up = Condition(
    "run tries used up",
    "the run was tried again as often as `recovery.attempts_per_run` allows",
    lambda s: not s.run_tries_left,
)
fold_tries_used_up = Condition(
    "fold tries used up",
    "the fold was tried again as often as `recovery.attempts_per_step` allows",
    lambda s: not s.fold_tries_left,
)
repairing = Condition(
    "repairing",
    "a repair or a pull is in progress: the next one is planned from the next picture",
    lambda s: s.repairing,
)
cloth_taken = Condition(
    "cloth taken",
    "the hands completed the fold or hold cloth: released cloth may lie anywhere",
    lambda s: s.carried or s.held,
)
not_recognised = Condition("not recognised", "the garment was not recognised yet", lambda s: not s.recognised)
not_planned = Condition("not planned", "the folds were not planned yet", lambda s: not s.planned)
no_trajectory = Condition("no trajectory", "the arcs of the fold were not chosen yet", lambda s: not s.trajectory)
table_unseen = Condition(
    "table unseen",
    "the empty table must be photographed before the garment is laid on it",
    lambda s: not s.table_seen,
)
unattended = Condition("unattended", "no operator is there", lambda s: not s.attended)
