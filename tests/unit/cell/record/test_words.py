"""Figures, recoveries and verdicts as text."""

from __future__ import annotations

import math
from collections.abc import Iterator

import pytest

from foldcell.cell.record.run_record import FailureRecord, FoldRecord
from foldcell.cell.record.words import figure, laying_in_words, length, recovery_in_words, seconds, verdict
from foldcell.cell.states.recovery_table import RECOVERIES, Laying
from foldcell.cell.states.transition_table import State
from foldcell.robots.errors import FailureKind
from foldcell.skills.perception.inspection.claim import Claim
from tests.builders.records import run_record, score_record
from tests.inspections import a_claim

UNFINISHED, ENDED = State.NOT_FOLDED, "not_folded"
GOOD = FoldRecord("half", done=True, accepted=True, attempts=1)
GOOD_2 = FoldRecord("quarter", done=True, accepted=True, attempts=2)
REFUSED = FoldRecord("quarter", accepted=False, attempts=1)


def said(
    result: str,
    state: State,
    folds: list[FoldRecord],
    why: str = "",
    claim: Claim | None = None,
    score: object = None,
) -> str:
    failure = FailureRecord(FailureKind.MISSED_GRASP, why, "look again") if why else None
    return verdict(
        run_record(result=result, state=state, steps=tuple(folds), failure=failure, claim=claim, score=score)
    )


def test_a_folded_garment_is_judged_by_the_last_picture_and_then_by_the_score() -> None:
    claim = a_claim(says="folded as planned, 16 mm high (at most 22 mm)")
    assert said("folded", State.FOLDED, [GOOD, GOOD_2], claim=claim, score=score_record()) == (
        "Both folds were made; by the last picture the garment is folded as planned, 16 mm high (at most 22 mm),"
        " reliability 98 %; the score, measured on the simulated garment itself, passes."
    )
    assert said("folded", State.FOLDED, [GOOD]).endswith("the last fold was not inspected.")
    missed = score_record({"edges_m": 0.03}, passed=False, edges_m=0.0412)
    assert "does not pass (edges 41.2 mm, limit 30.0 mm)." in said("folded", State.FOLDED, [GOOD], score=missed)


def test_a_finished_fold_that_does_not_count_names_the_claim_and_not_the_failure() -> None:
    claim = a_claim(says="folded, but stands 31 mm high, 6 mm more than it should")
    says = said("not_folded", State.NOT_FOLDED, [GOOD, REFUSED], "too high.", claim)
    assert claim.says in says and "does not count as folded" in says and "too high" not in says


@pytest.mark.parametrize(
    ("state", "result", "fold", "begins"),
    [
        (UNFINISHED, ENDED, FoldRecord("quarter", attempts=2), "Fold 2 of 2 (quarter) was not finished"),
        (UNFINISHED, ENDED, FoldRecord("quarter"), "Fold 2 of 2 (quarter) was not made"),
        (UNFINISHED, ENDED, REFUSED, "Fold 2 of 2 (quarter) failed"),
        (State.STOPPED, "not_folded", FoldRecord("quarter", attempts=1), "The run was stopped at fold 2 of 2"),
        (State.FAULT, "fault", FoldRecord("quarter", attempts=1), "A fault ended the run at fold 2 of 2"),
    ],
)
def test_an_unfinished_run_names_the_fold_and_the_reason(
    state: State, result: str, fold: FoldRecord, begins: str
) -> None:
    says = said(result, state, [GOOD, fold], "right: 0.1 N between the pads, 2.1 N expected. ")
    assert says.startswith(begins)
    assert says.endswith(": right: 0.1 N between the pads, 2.1 N expected.")


def test_a_claim_of_an_earlier_look_does_not_hide_a_fold_that_was_left_out() -> None:
    folds = [FoldRecord("half"), GOOD_2]
    says = said("not_folded", State.NOT_FOLDED, folds, "left out by the operator: half", a_claim())
    assert says == "Fold 1 of 2 (half) was not made: left out by the operator: half."


def test_a_run_that_ends_before_its_first_fold_says_so() -> None:
    assert said("fault", State.FAULT, [], "no camera") == "A fault ended the run before the first fold: no camera."
    assert "the reason is not known" in said("not_folded", State.NOT_FOLDED, [])


@pytest.mark.parametrize("result", ["folded", "not_folded", "fault"])
def test_every_verdict_is_one_sentence(result: str) -> None:
    for state in (State.FOLDED, State.NOT_FOLDED, State.STOPPED, State.FAULT):
        for folds in ([], [GOOD], [GOOD, REFUSED], [GOOD, GOOD_2, GOOD]):
            for claim in (None, a_claim(says="not folded as planned: it lies 61 mm away")):
                says = said(result, state, folds, "the joint is hot.", claim, score_record())
                assert says.count(". ") == 0 and says.endswith(".") and not says.endswith("..")
                assert says[0].isupper()


def test_the_unit_of_a_figure_follows_from_its_name() -> None:
    assert figure("drift_m", 0.0123) == length(0.0123) == "12.3 mm" and length(0.0123, 0) == "12 mm"
    assert figure("edges_m", None) == figure("height_m", math.nan) == seconds(None) == "–"
    assert (seconds(8.314), seconds(83.14), figure("robot_time_s", 123.0)) == ("8.31 s", "83.1 s", "2 min 03 s")
    assert (figure("drift_rad", math.pi / 18), figure("iou", 0.9)) == ("10.0°", "0.900")
    assert (figure("grip_n", 1.834), figure("grip_n", None)) == ("1.83 N", "–")


def recoveries_of_the_table() -> Iterator[str]:
    for recoveries in RECOVERIES.values():
        for recovery in recoveries:
            record = {"change": recovery.adjust.value} | ({"reason": recovery.reason} if recovery.reason else {})
            yield recovery_in_words(recovery.event, record)


def test_every_recovery_of_the_table_is_said_in_words() -> None:
    assert all(said and "_" not in said for said in recoveries_of_the_table())
    recoveries = {(r.event, r.adjust, r.reason) for row in RECOVERIES.values() for r in row}
    assert len(set(recoveries_of_the_table())) == len(recoveries), "two recoveries are told apart"
    assert len({laying_in_words({"laying": laying.value}) for laying in Laying}) == len(Laying)
