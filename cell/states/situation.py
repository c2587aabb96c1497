"""The situation after a failure, and the named conditions by which the recovery table tells situations apart."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from foldcell.robots.errors import FailureKind

__all__ = [
    "PLANNING_FAILURES",
    "SEEING_FAILURES",
    "Condition",
    "Situation",
    "another_variant",
    "carried",
    "cloth_taken",
    "edits_impossible",
    "fold_tries_used_up",
    "good_enough",
    "lies_as_before",
    "near_enough",
    "no_trajectory",
    "not_failed_alike",
    "not_planned",
    "not_recognised",
    "patient",
    "repairable",
    "repairing",
    "run_tries_used_up",
    "spreadable",
    "stood_low",
    "table_unseen",
    "too_many_layers",
    "unattended",
    "wait_before_look",
]

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
    count together. edited: whether the operator has changed the plan of the fold, and the hands have not
    approached yet. held: whether a hand holds cloth. If an inspection failed, overlap: IoU of observed and
    predicted shape; deviation_m: the larger of the outline's deviation and the length of cloth left behind [m];
    lasting_defect: whether the finished garment would fail by the shape of this fold.


    count together. patience_s: how long the cell looks again after a failure of seeing [s]. edited: whether the
    operator has changed the plan of the fold, and the hands have not approached yet. held: whether a hand holds
    cloth. If an inspection failed, overlap: IoU of observed and predicted shape; deviation_m: the larger of the
    outline's deviation and the length of cloth left behind [m].
    The conditions below explain the other values.
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


Condition = Callable[[Situation], bool]


def edits_impossible(s: Situation) -> bool:
    """the fold cannot be planned as the operator has changed it"""
    return s.edited and s.kind in PLANNING_FAILURES


def carried(s: Situation) -> bool:
    """the hands completed the fold"""
    return s.carried


def near_enough(s: Situation) -> bool:
    """the hands completed the fold, another fold follows, and this one is near enough to its prediction for it: an
    IoU of at least 0.85, and edges at most 30 mm off"""
    near = s.overlap >= GOOD_ENOUGH_IOU and s.deviation_m <= GOOD_ENOUGH_M
    return s.carried and not s.last_fold and near


def good_enough(s: Situation) -> bool:
    """the next fold can build on this one (an IoU of at least 0.85, edges at most 30 mm off), and this one has no
    defect of its shape that spoils the finished garment"""
    return near_enough(s) and not s.lasting_defect


def wait_before_look(attempt: int, patience_s: float) -> tuple[float, float]:
    """Return how long the cell waits before it looks again after so many failures of seeing, and how long it will
    still wait after that [s]. The waits double: 1, 2, 4 s and so on, `patience_s` in all; then both are 0."""
    waited = 2.0 ** (attempt - 1) - 1.0
    left = max(0.0, patience_s - waited)
    wait = min(left, waited + 1.0)
    return wait, left - wait


def patient(s: Situation) -> bool:
    """the cell has waited for less than `recovery.patience`: 1 s at first, then twice as long each time"""
    return wait_before_look(s.attempt, s.patience_s)[0] > 0


def too_many_layers(s: Situation) -> bool:
    """a hand held more layers than planned"""
    return s.too_many_layers


def stood_low(s: Situation) -> bool:
    """the hand stood low enough for the lowest layer: the layers that it missed end beside its pads"""
    return s.stood_low


def repairable(s: Situation) -> bool:
    """it is known well enough how the garment lies to complete or to undo the fold"""
    return s.repairable


def not_failed_alike(s: Situation) -> bool:
    """the fold was not already made anew and refused for the same reason"""
    return not s.failed_alike


def lies_as_before(s: Situation) -> bool:
    """the garment is estimated to lie as before the fold, so that there is nothing to repair"""
    return s.lies_as_before


def spreadable(s: Situation) -> bool:
    """a pull may spread the garment: it is the first fold, the garment was seen flat, `recovery.pulls` are left,
    and the last pull helped"""
    return s.spreadable


def another_variant(s: Situation) -> bool:
    """the garment file has a variant of this fold that was not tried"""
    return s.other_variant


def run_tries_used_up(s: Situation) -> bool:
    """the run was tried again as often as `recovery.attempts_per_run` allows"""
    return not s.run_tries_left


def fold_tries_used_up(s: Situation) -> bool:
    """the fold was tried again as often as `recovery.attempts_per_step` allows"""
    return not s.fold_tries_left


def repairing(s: Situation) -> bool:
    """a repair or a pull is in progress: the next one is planned from the next picture"""
    return s.repairing


def cloth_taken(s: Situation) -> bool:
    """the hands completed the fold or hold cloth: released cloth may lie anywhere"""
    return s.carried or s.held


def not_recognised(s: Situation) -> bool:
    """the garment was not recognised yet"""
    return not s.recognised


def not_planned(s: Situation) -> bool:
    """the folds were not planned yet"""
    return not s.planned


def no_trajectory(s: Situation) -> bool:
    """the arcs of the fold were not chosen yet"""
    return not s.trajectory


def table_unseen(s: Situation) -> bool:
    """the empty table must be photographed before the garment is laid on it"""
    return not s.table_seen


def unattended(s: Situation) -> bool:
    """no operator is there"""
    return not s.attended
