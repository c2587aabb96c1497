"""The recovery table: each situation after a failure has one answer, and each row can be reached."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise, product
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from foldcell.cell.states.recovery_table import (
    RECOVERIES,
    SUBSTITUTES,
    Adjustment,
    Laying,
    Recovery,
    choose_laying,
    choose_recovery,
)
from foldcell.cell.states.situation import SEEING_FAILURES, Situation, wait_before_look
from foldcell.cell.states.transition_table import TRANSITIONS, Event, State
from foldcell.robots.errors import FailureKind
from foldcell.robots.ports import Side

K = FailureKind
KNOWN = {row.event for row in TRANSITIONS if row.state is State.RECOVERING}
NO_TRY = {Event.CARRY_ON, Event.ASK, Event.GIVE_UP}
BOTH = tuple(Side)


def tried(kind: FailureKind, **known: Any) -> list[Recovery]:
    """The recoveries after the first to the ninth failure of this kind."""
    return [choose_recovery(Situation(kind, attempt, **known)) for attempt in range(1, 10)]


@pytest.mark.long
@settings(max_examples=2000)
@given(
    st.builds(Situation, attempt=st.integers(1, 9), overlap=st.floats(0.0, 1.0), deviation_m=st.floats(0.0, 0.2))
)
def test_each_situation_has_one_answer_that_the_machine_knows(s: Situation) -> None:
    recovery = choose_recovery(s)
    assert recovery.event in KNOWN - {Event.FAILED}
    assert bool(recovery.reason) == (recovery.event in {Event.ASK, Event.GIVE_UP})
    assert recovery.event is not (Event.GIVE_UP if s.attended else Event.ASK)
    if not (
        (s.fold_tries_left and s.run_tries_left) or recovery.looks_only or recovery.adjust is Adjustment.NO_EDITS
    ):
        assert recovery.event in NO_TRY, "the limits of tries hold"
    if s.carried or s.held or s.repairing:
        assert recovery.event is not Event.PLAN_AGAIN or recovery.adjust is Adjustment.NO_EDITS


@pytest.mark.parametrize("kind", list(FailureKind))
def test_each_row_is_reached_and_the_last_one_asks(kind: FailureKind) -> None:
    names = (
        "carried", "too_many_layers", "repairable", "lies_as_before", "spreadable", "other_variant",
        "lasting_defect", "failed_alike", "stood_low",
    )  # fmt: skip
    situations = [
        Situation(kind, attempt, **dict(zip(names, values, strict=True)))
        for attempt in range(1, 8)
        for values in product((True, False), repeat=len(names))
    ]
    *recoveries, ask = rows = RECOVERIES[kind]
    assert {next(row for row in rows if row.answers(s)) for s in situations} == set(rows)
    assert ask == Recovery(Event.ASK, reason=ask.reason) and len(ask.reason.split()) >= 4
    assert all(row.event is not Event.ASK and not row.reason for row in recoveries)


@pytest.mark.parametrize(
    ("known", "event"),
    [
        (Situation(K.MISSED_GRASP, run_tries_left=False, attended=True), Event.ASK),
        (Situation(K.MISSED_GRASP, fold_tries_left=False, attended=True), Event.ASK),
        (Situation(K.OPTIMISER_FAILED, repairing=True), Event.LOOK_AGAIN),
        (Situation(K.MISSED_GRASP, repairing=True), Event.LOOK_AGAIN),
        (Situation(K.MISSED_GRASP, held=True), Event.LOOK_AGAIN),
        (Situation(K.MISSED_GRASP, trajectory=False), Event.LOOK_AGAIN),
        (Situation(K.OPTIMISER_FAILED, planned=False), Event.LOOK_AGAIN),
        (Situation(K.UNREACHABLE, 3, other_variant=True, recognised=False), Event.LOOK_AGAIN),
        (Situation(K.CAMERA_FAULT, table_seen=False), Event.START_OVER),
        (Situation(K.CAMERA_FAULT, carried=True), Event.LOOK_AFTER),
        (Situation(K.STOPPED), Event.GIVE_UP),
    ],
)
def test_each_substitute_is_reached(known: Situation, event: Event) -> None:
    chosen = choose_recovery(known)
    assert chosen.event is event
    assert sum(other.event is event and other.when(known) for other in SUBSTITUTES) >= 1


def test_the_limit_of_the_run_is_named_before_that_of_the_fold() -> None:
    used_up = Situation(K.MISSED_GRASP, run_tries_left=False, fold_tries_left=False)
    assert choose_recovery(used_up).limit == "recovery.attempts_per_run"
    assert choose_recovery(replace(used_up, run_tries_left=True)).limit == "recovery.attempts_per_step"
    assert not choose_recovery(replace(used_up, attempt=9)).limit, "the table would have asked in any case"
    accepted = choose_recovery(replace(used_up, kind=K.DRIFT, carried=True))
    assert accepted.event is Event.CARRY_ON, "to accept a fold repeats nothing"


@pytest.mark.parametrize("kind", list(FailureKind))
@pytest.mark.parametrize(("attended", "end"), [(True, Event.ASK), (False, Event.GIVE_UP)])
def test_recoveries_are_bounded(kind: FailureKind, attended: bool, end: Event) -> None:
    events = [recovery.event for recovery in tried(kind, attended=attended)]
    assert events[-1] is end and RECOVERIES[kind][-1].reason == tried(kind)[-1].reason
    accepted = [recovery.event for recovery in tried(kind, attended=attended, carried=True)]
    assert Event.CARRY_ON not in accepted or set(accepted) == {Event.CARRY_ON}, "the run goes on after the fold"


@pytest.mark.parametrize("kind", [K.STOPPED, K.HARDWARE_FAULT, K.ABORTED, K.SKILL_CRASHED, K.UNRECORDED])
def test_what_only_a_person_may_end_is_never_recovered_automatically(kind: FailureKind) -> None:
    assert {recovery.event for recovery in tried(kind)} == {Event.GIVE_UP}


@pytest.mark.parametrize("kind", sorted({k for k, rows in RECOVERIES.items() if len(rows) > 1} - {K.DRIFT}))
def test_no_other_failure_ends_a_run_at_the_first_word(kind: FailureKind) -> None:
    """Also after the last fold, with the worst figures and without another variant."""
    worst = Situation(kind, last_fold=True, overlap=0.0, deviation_m=1.0, carried=True)
    assert choose_recovery(worst).event not in NO_TRY


@pytest.mark.parametrize(
    ("kind", "dwells"), [(K.TRACKING_ERROR, [0.5]), (K.LIMIT_EXCEEDED, [0.5]), (K.STALE_STATE, [0.5, 3.0])]
)
def test_a_motion_of_strayed_arms_is_repeated_once_and_of_silent_arms_twice(
    kind: FailureKind, dwells: list[float]
) -> None:
    """docs/do/safety.md states the same."""
    repeated = [recovery for recovery in tried(kind) if recovery.event is not Event.GIVE_UP]
    assert all(r.event is Event.GRASP_AGAIN for r in repeated) and [r.dwell_s for r in repeated] == dwells


@pytest.mark.parametrize("kind", [K.SLIPPED, K.NO_CONTACT, K.MISSED_GRASP, K.IN_COLLISION])
def test_a_failed_grasp_is_retried_two_or_three_times_with_different_adjustments(kind: FailureKind) -> None:
    made = [(r.event, r.adjust) for r in tried(kind, other_variant=True) if r.event is not Event.GIVE_UP]
    assert 2 <= len(made) <= 3 and len(set(made)) == len(made)


@pytest.mark.parametrize(
    ("overlap", "deviation", "good_enough"),
    [(0.84, 0.0, False), (0.86, 0.0, True), (0.86, 0.029, True), (0.86, 0.031, False), (0.99, 0.079, False)],
)
def test_a_fold_that_is_too_far_from_its_prediction_is_never_good_enough(
    overlap: float, deviation: float, good_enough: bool
) -> None:
    seen = {"attended": True, "overlap": overlap, "deviation_m": deviation, "carried": True}
    refused = [Event.LOOK_AFTER] + [Event.ASK] * 8
    assert [r.event for r in tried(K.OFF_TARGET, **seen)] == ([Event.CARRY_ON] * 9 if good_enough else refused)
    assert [r.event for r in tried(K.OFF_TARGET, **seen, last_fold=True)] == refused


@pytest.mark.parametrize("kind", [K.OFF_TARGET, K.SAG, K.DROPPED_CORNER, K.PILING])
def test_a_fold_that_would_spoil_the_garment_is_repaired_before_the_next_one(kind: FailureKind) -> None:
    """If it cannot be repaired, the next folds are made, and the claim decides."""
    spoiled = {"carried": True, "lasting_defect": True, "deviation_m": 0.028}
    mended = [r.event for r in tried(kind, **spoiled, repairable=True)]
    assert mended == [Event.LOOK_AFTER, Event.REPAIR, Event.REPAIR] + [Event.CARRY_ON] * 6
    assert [r.event for r in tried(kind, **spoiled)] == [Event.LOOK_AFTER] + [Event.CARRY_ON] * 8
    assert Event.CARRY_ON not in [r.event for r in tried(kind, **spoiled | {"deviation_m": 0.032})]


@pytest.mark.parametrize("kind", sorted(SEEING_FAILURES))
@pytest.mark.parametrize("used_up", [{}, {"fold_tries_left": False, "run_tries_left": False}])
@given(patience=st.floats(0.0, 600.0))
def test_the_cell_looks_again_for_as_long_as_its_patience_lasts(
    kind: FailureKind, used_up: dict[str, bool], patience: float
) -> None:
    """Also if no try is left: looking moves nothing. The waits double, so they add up to the patience."""
    waits = []
    for attempt in range(1, 12):
        recovery = choose_recovery(Situation(kind, attempt, patience, **used_up))
        wait, left = wait_before_look(attempt, patience)
        assert (recovery.event is Event.LOOK_AGAIN) == (wait > 0) and (wait > 0 or recovery.event is Event.GIVE_UP)
        waits.append(wait)
        assert left == pytest.approx(patience - sum(waits))
    assert sum(waits) == pytest.approx(patience)
    assert all(wait == 2.0**k for k, wait in enumerate(waits) if waits[k + 1 : k + 2] > [0.0])


@pytest.mark.parametrize("kind", [K.STALE_STATE, K.TACTILE_FAULT, K.GRIPPER_FAULT])
def test_the_dwells_of_a_sense_outlast_a_disturbance_of_three_seconds(kind: FailureKind) -> None:
    assert sum(recovery.dwell_s for recovery in tried(kind)) > 3.0


def test_a_hand_that_held_too_many_layers_grasps_higher_whatever_is_tried() -> None:
    for kind in (K.MISSED_GRASP, K.MISSED_LAYER):
        adjusted = [r.adjust for r in tried(kind, too_many_layers=True, repairable=True) if r.event not in NO_TRY]
        assert len(adjusted) == 3 and set(adjusted) == {Adjustment.HIGHER}


@pytest.mark.parametrize("kind", list(FailureKind))
def test_cloth_is_laid_at_one_end_of_its_path_and_never_dropped_by_a_hand_that_holds_it(kind: FailureKind) -> None:
    """It goes back from the beginning, on to the target from the end at the earliest, and turns round once."""
    for holding in (BOTH, BOTH[:1]):
        chosen = [choose_laying(kind, share, BOTH, holding) for share in (0.0, 0.2, 0.49, 0.7, 0.85, 1.0)]
        assert chosen[:3] == [Laying.BACK] * 3 and Laying.RELEASE not in chosen
        assert sum(a is not b for a, b in pairwise(chosen)) <= 1
    assert choose_laying(kind, 0.5, BOTH, ()) is Laying.RELEASE


def test_a_lost_corner_makes_the_way_back_the_better_one_for_longer() -> None:
    assert choose_laying(K.STALE_STATE, 0.6, BOTH, BOTH) is Laying.ONWARD
    assert choose_laying(K.SLIPPED, 0.6, BOTH, BOTH[:1]) is Laying.BACK
