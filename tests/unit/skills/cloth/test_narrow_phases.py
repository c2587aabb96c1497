"""When pairs are looked at: as often as anything could come through, and none too late, whatever the others do."""

import hypothesis.strategies as st
from hypothesis import given

from skills.cloth.contact import HASTE, LEISURE, MOST_WAY, PHASE, STRAY, is_due, later, next_narrow_phase

PACES = st.sampled_from([PHASE, LEISURE])
LIMITS = [share * MOST_WAY / step for step in (HASTE, PHASE, LEISURE) for share in (0.99, 1.01)]
WAYS = st.one_of(st.floats(0.0, 3.0), st.sampled_from(LIMITS))
FRAMES = st.sampled_from([16, 20, 24, 64])


@given(st.data(), FRAMES, PACES, WAYS)
def test_nothing_comes_nearer_than_is_allowed_before_it_is_looked_at_again(data, substeps, pace, way):
    s = HASTE * data.draw(st.integers(0, substeps // HASTE - 1))
    then, next_pace = next_narrow_phase(s, substeps, pace, way)
    assert s < then <= min(s + pace, substeps), "contacts serve no longer than they were made for"
    assert (then - s) * way <= MOST_WAY or then - s == HASTE
    assert next_pace == PHASE or next_pace * way <= MOST_WAY
    assert then % PHASE == 0 or then - s == HASTE, "haste apart, they come when the cloth is damped"


def test_what_is_calm_is_looked_at_half_as_often():
    looks, s, pace = 0, 0, LEISURE
    while s < 64:
        s, pace = next_narrow_phase(s, 64, pace, 0.01)
        looks += 1
    assert looks == 64 // LEISURE


@given(st.floats(0.001, 0.1), st.floats(0.01, 3.0), st.randoms(use_true_random=False), FRAMES)
def test_a_pair_that_comes_nearer_is_looked_at_before_it_meets(gap, speed, random, substeps):
    """Others of the same cloth set the pace as they like, and it comes 1.5 times as fast as it seemed."""
    h = 1.0 / (60 * substeps)
    now, s, pace, due = 0, 0, PHASE, 0
    for _ in range(100_000):
        if is_due(due, now, pace):
            reach, free = STRAY + pace * h * speed, gap - now * h * speed
            if free <= reach:
                break
            due = later(now, pace, free, reach)
        then, pace = next_narrow_phase(s, substeps, pace, random.choice([0.01, 0.3, 1.0]))
        now += then - s
        s = then % substeps
    assert now * h * speed <= gap
