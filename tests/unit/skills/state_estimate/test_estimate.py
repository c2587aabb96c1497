"""States of the simulated world's cloth, whose mesh, outline and fabric the estimate does not know, are told apart
in pictures."""

from dataclasses import replace
from functools import partial

import numpy as np
import pytest

from benchmarks.interrupted_folds import shoved
from benchmarks.perception.scenes import TABLE
from benchmarks.state_estimate import estimate
from foldcell.skills.state_estimate import observation
from foldcell.skills.state_estimate.comparison import fit
from foldcell.skills.state_estimate.drawing import draw_estimate
from foldcell.skills.state_estimate.estimate import estimate_state
from foldcell.skills.state_estimate.hypothesis import FoldState, Hypothesis
from foldcell.skills.state_estimate.wording import describe
from foldcell.skills.vocabulary import FailureKind, GraspId
from tests.builders.shipped_settings import PERCEPTION

observe = partial(observation.observe, settings=PERCEPTION)

LEFT, RIGHT = GraspId.LEFT, GraspId.RIGHT


def never(ways):
    raise AssertionError("nothing had to be simulated")


def judged(fold, vertices):
    found = estimate(fold, fold.shoot(vertices))
    assert sum(found.probabilities.values()) == pytest.approx(1.0)
    assert found.confidence == max(found.probabilities.values())
    return found


@pytest.mark.parametrize(("shift", "turn"), [(0.0, 0.0), (0.08, 0.2), (0.05, -0.5)])
def test_a_garment_that_was_not_folded_lies_as_before_wherever_it_was_shoved(fold, shift, turn):
    found = judged(fold, shoved(fold.at_start(), shift, turn, 2.0))
    assert found.state is FoldState.BEFORE and found.confidence > 0.95
    centre = fold.at_start()[:, :2].mean(axis=0)
    c, s = np.cos(turn), np.sin(turn)
    true = (
        centre
        + shift * np.array([np.cos(2.0), np.sin(2.0)])
        + np.array([[c, -s], [s, c]]) @ (found.best.about - centre)
    )
    assert np.linalg.norm(found.best.about + found.best.drift - true) < 0.008
    assert found.best.drift_rad == pytest.approx(turn, abs=0.02)
    assert "as before the fold" in describe(found)
    assert ("turned" in describe(found)) == (turn != 0.0)


@pytest.mark.parametrize("shift", [0.0, 0.06])
def test_a_completed_fold_is_recognised(fold, shift):
    found = judged(fold, shoved(fold.interrupted({}), shift, 0.0, 1.0))
    assert found.state is FoldState.AFTER and found.confidence > 0.8
    assert "the fold is made" in describe(found)


@pytest.fixture(scope="module")
def dropped(fold):
    """A picture of the garment after the hands opened half way."""
    return fold.shoot(fold.interrupted({}, 0.6))


@pytest.fixture(scope="module")
def found_dropped(fold, dropped):
    return estimate(fold, dropped)


def test_hands_that_opened_half_way_are_recognised_with_the_moment(found_dropped):
    found = found_dropped
    assert sum(found.probabilities.values()) == pytest.approx(1.0)
    assert found.state is FoldState.HALF_WAY and found.confidence > 0.8
    how = found.best.hypothesis.interruption
    assert not how.lost and 0.3 < how.end < 0.6  # in shares of the way, which lag behind those of the time
    assert "the hands let go" in describe(found)


@pytest.mark.parametrize(("share", "end", "slipped"), [(0.45, 1.0, RIGHT), (0.6, 0.7, LEFT)])
def test_a_corner_that_slipped_out_is_named(fold, share, end, slipped):
    found = judged(fold, fold.interrupted({slipped: share}, end))
    assert found.state is FoldState.HALF_WAY and found.confidence > 0.8
    assert list(found.best.hypothesis.interruption.lost) == [slipped]
    assert f"the {slipped} corner slipped out" in describe(found)
    swapped = {slipped: slipped.other.value, slipped.other: slipped.value}
    assert f"the {slipped.other} corner slipped out" in describe(found, swapped)


def test_cloth_that_falling_hands_dragged_aside_is_recognised_by_their_measured_course(fold):
    vertices, course = fold.swerving(0.7, aside=0.10)
    frame = fold.shoot(vertices)
    found, guessed = estimate(fold, frame, course), estimate(fold, frame)
    assert found.state is FoldState.HALF_WAY and found.confidence > 0.8
    assert found.simulations == 1 and found.best.hypothesis.interruption.measured and "sensors" in describe(found)
    measured = found.best.misfit / found.best.cells
    assert measured < 0.5 * min(f.misfit / f.cells for f in guessed.fits)


def test_a_dropped_garment_lies_in_a_heap(fold, rng):
    found = judged(fold, fold.heaped(rng))
    assert found.state is FoldState.HEAP and found.confidence > 0.95 and found.best is None
    assert "in a heap" in describe(found)


def test_a_clear_picture_needs_no_simulation(fold):
    seen = observe(
        fold.shoot(fold.at_start()), fold.calibration, TABLE, fold.reference, settings=PERCEPTION
    ).unwrap()
    found = estimate_state(seen, fold.before, fold.after, [LEFT, RIGHT], never, fold.lift)
    assert found.simulations == 0 and len(found.fits) == 2


def test_the_silhouette_tells_the_ends_of_the_fold_apart_without_depth(fold):
    for vertices, state in ((fold.at_start(), FoldState.BEFORE), (fold.interrupted({}), FoldState.AFTER)):
        frame = fold.shoot(vertices)
        seen = observe(frame, fold.calibration, TABLE, fold.reference).unwrap()
        blind = replace(seen, height=np.full_like(seen.height, np.nan))
        assert estimate_state(blind, fold.before, fold.after, [LEFT, RIGHT], never).state is state


def test_an_empty_table_is_a_failure(fold):
    assert (
        observe(fold.shoot(None), fold.calibration, TABLE, fold.reference).failure.kind is FailureKind.NO_GARMENT
    )


def test_a_hypothesis_is_moved_to_the_place_where_it_was_drawn(fold):
    """The fit of a mesh to its own rendering, moved by a known motion, finds that motion and leaves no misfit."""
    seen = observe(
        fold.shoot(fold.at_start()), fold.calibration, TABLE, fold.reference, settings=PERCEPTION
    ).unwrap()
    found = fit(seen, Hypothesis(FoldState.BEFORE, fold.before), fold.lift)
    moved = replace(fold.before, vertices=shoved(found.shape.vertices, 0.05, 0.3, 1.0))
    back = fit(seen, Hypothesis(FoldState.BEFORE, moved), fold.lift)
    assert back.drift_rad == pytest.approx(-0.3, abs=0.01)
    assert np.linalg.norm(back.shape.vertices - found.shape.vertices, axis=1).max() < 0.004
    assert back.misfit == pytest.approx(found.misfit, rel=0.5)


def test_the_drawing_shows_each_state_that_has_a_candidate(fold, dropped, found_dropped):
    seen = observe(dropped, fold.calibration, TABLE, fold.reference).unwrap()
    found = found_dropped
    picture = draw_estimate(seen, found.condensed())
    assert len(found.condensed().fits) == 3 and picture.dtype == np.uint8
    estimated, other = np.array([40, 220, 90]), np.array([255, 150, 40])
    for colour in (estimated, other):
        assert (np.abs(picture.astype(int) - colour).max(axis=-1) < 60).sum() > 100
