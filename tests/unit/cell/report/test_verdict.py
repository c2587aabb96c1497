"""The verdict: one sentence, which names the fold and what decided."""

from __future__ import annotations

import pytest

from cell.report.verdict import FoldEnd, verdict
from cell.states.transition_table import State

UNFINISHED, ENDED = State.NOT_FOLDED, "not_folded"
GOOD, GOOD_2 = FoldEnd("half", 1, True, True), FoldEnd("quarter", 2, True, True)
CLAIM = "folded as planned, 16 mm high (at most 22 mm), reliability 98 %"


def test_a_folded_garment_is_judged_by_the_last_picture_and_then_by_the_score() -> None:
    says = verdict("folded", State.FOLDED, [GOOD, GOOD_2], claim=CLAIM, score="the score passes")
    assert says == f"Both folds were made; by the last picture the garment is {CLAIM}; the score passes."
    assert verdict("folded", State.FOLDED, [GOOD]).endswith("the last fold was not inspected.")


def test_a_finished_fold_that_does_not_count_names_the_claim_and_not_the_failure() -> None:
    claim = "folded, but stands 31 mm high, 6 mm more than it should, reliability 93 %"
    high = FoldEnd("quarter", 1, False, False)
    says = verdict("not_folded", State.NOT_FOLDED, [GOOD, high], "too high.", claim)
    assert claim in says and "does not count as folded" in says and "too high" not in says


@pytest.mark.parametrize(
    ("state", "result", "fold", "begins"),
    [
        (UNFINISHED, ENDED, FoldEnd("quarter", 2, False, None), "Fold 2 of 2 (quarter) was not finished"),
        (UNFINISHED, ENDED, FoldEnd("quarter", 0, False, None), "Fold 2 of 2 (quarter) was not made"),
        (UNFINISHED, ENDED, FoldEnd("quarter", 1, False, False), "Fold 2 of 2 (quarter) failed"),
        (State.STOPPED, "not_folded", FoldEnd("quarter", 1, False, None), "The run was stopped at fold 2 of 2"),
        (State.FAULT, "fault", FoldEnd("quarter", 1, False, None), "A fault ended the run at fold 2 of 2"),
    ],
)  # fmt: skip
def test_an_unfinished_run_names_the_fold_and_the_reason(
    state: State, result: str, fold: FoldEnd, begins: str
) -> None:
    says = verdict(result, state, [GOOD, fold], "right: 0.1 N between the pads, 2.1 N expected. ")
    assert says.startswith(begins)
    assert says.endswith(": right: 0.1 N between the pads, 2.1 N expected.")


def test_a_claim_of_an_earlier_look_does_not_hide_a_fold_that_was_left_out() -> None:
    folds = [FoldEnd("half", 0, False, None), FoldEnd("quarter", 1, True, True)]
    says = verdict("not_folded", State.NOT_FOLDED, folds, "left out by the operator: half", CLAIM)
    assert says == "Fold 1 of 2 (half) was not made: left out by the operator: half."


def test_a_run_that_ends_before_its_first_fold_says_so() -> None:
    assert verdict("fault", None, [], "no camera") == "A fault ended the run before the first fold: no camera."
    assert "the reason is not known" in verdict("not_folded", State.NOT_FOLDED, [])


@pytest.mark.parametrize("result", ["folded", "not_folded", "fault"])
def test_every_verdict_is_one_sentence(result: str) -> None:
    for state in (State.FOLDED, State.NOT_FOLDED, State.STOPPED, State.FAULT):
        for folds in ([], [GOOD], [GOOD, FoldEnd("b", 1, False, False)], [GOOD, GOOD_2, GOOD]):
            for claim in ("", "not folded as planned: it lies 61 mm away."):
                says = verdict(result, state, folds, "the joint is hot.", claim, "the score passes.")
                assert says.count(". ") == 0 and says.endswith(".") and not says.endswith("..")
                assert says[0].isupper()
