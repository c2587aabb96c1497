"""The schedule of narrow phases: they are frequent enough that nothing passes through, and independent of other
pairs."""

import hypothesis.strategies as st
import pytest
from hypothesis import given

from foldcell.skills.cloth.contact.contacts import (
    HASTE_WAY,
    LEISURE_WAY,
    PHASES,
    STRAY,
    is_due,
    later,
    next_narrow_phase,
    phase_length,
)
from tests.builders.cloth import call

FRAMES = st.sampled_from([16, 20, 28, 64])
LIMITS = [share * way for way in (HASTE_WAY, LEISURE_WAY, 0.5 * LEISURE_WAY) for share in (0.99, 1.01)]
WAYS = st.one_of(st.floats(0.0, 12.0), st.sampled_from(LIMITS))  # distance moved within a phase


@given(st.data(), FRAMES, st.booleans(), WAYS)
def test_no_pair_comes_too_near_between_two_narrow_phases(data, substeps, leisure, way):
    phase = phase_length(1.0 / (60 * substeps), substeps)
    pace = 2 * phase if leisure else phase
    s = data.draw(st.integers(0, substeps - 1))
    then, next_pace = call(next_narrow_phase, s, substeps, phase, pace, way / phase)
    assert s < then <= min(s + pace, substeps), "contacts are not used longer than planned"
    steps = then - s
    if steps > phase // 2:
        assert steps * way / phase <= (HASTE_WAY if steps <= phase else LEISURE_WAY)
    assert next_pace == phase or 2.0 * way <= LEISURE_WAY
    assert then % phase == 0 or steps == phase // 2, "except in haste, narrow phases coincide with damping"


@pytest.mark.parametrize("substeps", [16, 20, 28, 64])
def test_calm_cloth_has_half_as_many_narrow_phases(substeps):
    phase = phase_length(1.0 / (60 * substeps), substeps)
    looks, s, pace = 0, 0, 2 * phase
    while s < substeps:
        s, pace = call(next_narrow_phase, s, substeps, phase, pace, 0.01 / phase)
        looks += 1
    assert looks == PHASES / 60 / 2


@pytest.mark.parametrize(
    ("rate", "substeps", "phase"), [(60, 16, 4), (60, 28, 7), (60, 8, 4), (240, 4, 4), (90, 20, 5)]
)
def test_a_phase_has_the_longest_fitting_length_of_at_least_four_substeps(rate, substeps, phase):
    assert phase_length(1.0 / (rate * substeps), substeps) == phase


@given(st.floats(0.001, 0.1), st.floats(0.01, 3.0), st.randoms(use_true_random=False), FRAMES)
def test_an_approaching_pair_is_checked_before_contact(gap, speed, random, substeps):
    """Other pairs set the pace at random, and this pair approaches 1.5 times as fast as estimated."""
    h = 1.0 / (60 * substeps)
    phase = phase_length(h, substeps)
    now, s, pace, due = 0, 0, phase, 0
    for _ in range(100_000):
        if call(is_due, due, now, pace):
            reach, free = STRAY + pace * h * speed, gap - now * h * speed
            if free <= reach:
                break
            due = call(later, now, pace, free, reach)
        then, pace = call(next_narrow_phase, s, substeps, phase, pace, random.choice([0.01, 0.3, 1.0]))
        now += then - s
        s = then % substeps
    assert now * h * speed <= gap
