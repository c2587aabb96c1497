"""How long a garment lies after each fold, from the moments when hands hold it."""

from __future__ import annotations

import pytest

from foldcell.cell.simulation.scoring.ground_truth_recorder import DwellTimes

Hold = tuple[float, float, bool]
"""Time of the grasp and of the release [s], and whether the garment was lifted."""


def noted(*holds: Hold) -> DwellTimes:
    dwell = DwellTimes()
    for k in range(1200):
        stamp = k / 12.0
        now = [hold for hold in holds if hold[0] <= stamp < hold[1]]
        dwell.note(stamp, bool(now), any(lifted for *_, lifted in now))
    return dwell


def test_a_fold_settles_until_the_next_grasp_and_the_last_one_until_the_end() -> None:
    dwell = noted((10.0, 15.0, True), (33.0, 40.0, True))
    assert dwell.after_each(2, 52.0) == pytest.approx([18.0, 12.0], abs=0.1)


def test_a_grasp_that_lifts_nothing_ends_the_rest_but_is_no_fold() -> None:
    dwell = noted((10.0, 15.0, True), (21.0, 22.0, False), (33.0, 40.0, True))
    assert dwell.after_each(2, 52.0) == pytest.approx([6.0, 12.0], abs=0.1)


@pytest.mark.parametrize("folds", [1, 3])
def test_nothing_is_known_if_the_garment_was_folded_more_or_less_often(folds: int) -> None:
    assert noted((10.0, 15.0, True), (33.0, 40.0, True)).after_each(folds, 52.0) is None
