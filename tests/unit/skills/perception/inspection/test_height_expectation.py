"""Expected heights of a fold: inversion of the table, limits, and probabilities that are true; and the bias of the
camera's heights, which is recovered from a flat garment, or is the expected one."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from foldcell.skills.perception.inspection.height_expectation import (
    IdealHeights,
    Normal,
    estimate_bending,
    estimate_camera_bias,
    expected_heights,
    judge_flatness,
    rising,
    scaled_ideal_heights,
)
from foldcell.skills.perception.inspection.target_view import StackHeights
from tests.builders.shipped_settings import INSPECTION

S = INSPECTION.claim
C = np.linspace(0.010, 0.020, 11)
TABLE = IdealHeights(C, 0.004 + 0.5 * C, 0.004 + 1.2 * C, 0.002 + 0.9 * C)
"""Heights that are straight lines over the bending length."""
lengths = st.floats(0.0105, 0.0195)


@given(lengths)
def test_an_exact_first_crease_gives_the_bending_length(c: float) -> None:
    found = estimate_bending(TABLE, Normal(0.002 + 0.9 * c, 0.0))
    assert found.mean == pytest.approx(c, abs=1e-9) and found.sigma < 1e-6


@given(lengths, st.floats(0.0005, 0.01))
def test_prior_and_observation_are_weighted_by_their_precision(c: float, sigma: float) -> None:
    found = estimate_bending(TABLE, Normal(0.002 + 0.9 * c, sigma))
    a, b = 12.0 / 0.010**2, (0.9 / sigma) ** 2
    assert found.mean == pytest.approx((0.015 * a + c * b) / (a + b), abs=1e-9)
    assert found.sigma == pytest.approx((a + b) ** -0.5)


@pytest.mark.parametrize("first", [None, Normal(math.nan, 0.001)])
def test_without_a_first_crease_the_fabrics_range_remains(first: Normal | None) -> None:
    found = estimate_bending(TABLE, first)
    assert found.mean == pytest.approx(0.015) and found.sigma == pytest.approx(0.010 / math.sqrt(12.0))


@given(st.floats(0.0, 0.1), st.floats(0.0, 0.1), st.floats(0.0, 0.01))
def test_a_higher_first_crease_never_means_a_softer_fabric(a: float, b: float, sigma: float) -> None:
    low, high = (estimate_bending(TABLE, Normal(h, sigma)).mean for h in sorted((a, b)))
    assert C[0] <= low <= high <= C[-1]


@given(lengths, st.floats(0.0, 0.002), st.floats(0.0, 0.002))
def test_expected_heights_follow_the_table_with_its_slope(c: float, sigma: float, ideal: float) -> None:
    found = expected_heights(TABLE, Normal(c, sigma), ideal)
    assert found[0].mean == pytest.approx(0.004 + 0.5 * c)
    assert found[1].mean == pytest.approx(0.004 + 1.2 * c)
    assert found[1].sigma == pytest.approx(math.hypot(1.2 * sigma, ideal), abs=1e-9)


def test_heights_above_the_stack_are_scaled_with_the_bending_length() -> None:
    table = scaled_ideal_heights(
        StackHeights(0.004, 0.004), StackHeights(0.010, 0.020), 0.002, 0.018, 0.015, (0.5, 1.5), 3
    )
    np.testing.assert_allclose(table.bending_lengths, [0.0075, 0.015, 0.0225])
    np.testing.assert_allclose(table.height_m, [0.007, 0.010, 0.013])
    np.testing.assert_allclose(table.crease_height_m, [0.012, 0.020, 0.028])
    np.testing.assert_allclose(table.first_crease_m, [0.010, 0.018, 0.026])


def test_a_table_is_made_to_rise_and_can_then_be_inverted() -> None:
    table = rising(IdealHeights(C[:4], C[:4], C[:4], np.array([0.010, 0.014, 0.013, 0.016])))
    np.testing.assert_allclose(table.first_crease_m, [0.010, 0.014, 0.014, 0.016])
    found = [estimate_bending(table, Normal(h, 0.001)).mean for h in np.linspace(0.009, 0.017, 50)]
    assert np.isfinite(found).all() and C[0] <= min(found) and max(found) <= C[3]
    assert found[-1] > found[0]


def test_the_limit_is_that_of_the_stack_or_of_the_ideal_fold_whichever_is_higher() -> None:
    none = Normal(0.0, 0.0)
    low = judge_flatness(none, none, (Normal(0.005, 0.0), Normal(0.02, 0.0)), Normal(0.004, 0.0), S)
    high = judge_flatness(none, none, (Normal(0.013, 0.0), Normal(0.02, 0.0)), Normal(0.004, 0.0), S)
    assert (low.height_limit_m, high.height_limit_m) == pytest.approx((0.014, 0.016))
    assert low.crease_height_limit_m == pytest.approx(0.030)


@pytest.mark.parametrize(
    ("height", "crease", "flat"), [(0.0139, 0.0299, True), (0.0141, 0.02, False), (0.01, 0.0301, False)]
)
def test_both_heights_must_be_within_their_limits(height: float, crease: float, flat: bool) -> None:
    expected = (Normal(0.005, 0.0), Normal(0.02, 0.0))
    found = judge_flatness(Normal(height, 0.0), Normal(crease, 0.0), expected, Normal(0.004, 0.0), S)
    assert found.flat is flat and found.probability == pytest.approx(float(flat), abs=1e-6)


@given(st.floats(0.0, 0.05), st.floats(0.0, 0.05))
def test_a_higher_fold_is_never_more_probably_flat(a: float, b: float) -> None:
    expected, stack = (Normal(0.010, 0.002), Normal(0.02, 0.003)), Normal(0.004, 0.001)
    low, high = (
        judge_flatness(Normal(h, 0.001), Normal(0.025, 0.001), expected, stack, S).probability
        for h in sorted((a, b))
    )
    assert 0.0 <= high <= low + 1e-9 and low <= 1.0


def test_the_probability_of_being_flat_is_the_share_of_flat_folds() -> None:
    """Folds of all heights are drawn, and their observations and expectations with the stated normal errors. In
    each class of probability, that share of the folds is flat."""
    rng, told, true = np.random.default_rng(4), [], []
    errors = {"height": 0.0015, "crease": 0.002, "ideal": 0.002, "ideal_crease": 0.003, "stack": 0.001}
    for _ in range(6000):
        height, crease = rng.uniform(0.0, 0.035), rng.uniform(0.01, 0.055)
        ideal, ideal_crease, stack = rng.uniform(0.005, 0.02), rng.uniform(0.015, 0.03), rng.uniform(0.002, 0.008)
        seen = {
            name: Normal(value + errors[name] * rng.normal(), errors[name])
            for name, value in zip(errors, (height, crease, ideal, ideal_crease, stack), strict=True)
        }
        judged = judge_flatness(
            seen["height"], seen["crease"], (seen["ideal"], seen["ideal_crease"]), seen["stack"], S
        )
        told.append(judged.probability)
        within = height <= max(stack + S.stack_margin, ideal + S.ideal_margin)
        true.append(within and crease <= ideal_crease + S.crease_margin)
    probability, flat = np.array(told), np.array(true)
    for low in (0.0, 0.2, 0.4, 0.6, 0.8):
        here = (probability >= low) & (probability <= low + 0.2)
        assert flat[here].mean() == pytest.approx(probability[here].mean(), abs=0.06)
    right = np.where(probability >= 0.5, probability, 1.0 - probability)
    assert np.mean(flat == (probability >= 0.5)) == pytest.approx(right.mean(), abs=0.02)


def flat_garment(top: float, noise: float = 0.0015) -> tuple[np.ndarray, np.ndarray]:
    """A garment of 240 x 240 mm whose rim stands 10 mm higher, with noise and holes in the depth."""
    rng = np.random.default_rng(1)
    mask = np.zeros((200, 200), bool)
    mask[40:160, 40:160] = True
    height = np.where(mask, top, 0.0) + noise * rng.normal(size=mask.shape)
    height[40:44, 40:160] += 0.010
    height[rng.random(mask.shape) < 0.1] = np.nan
    return height.astype(np.float32), mask


@given(st.floats(-0.0015, 0.0065), st.integers(1, 2), st.floats(0.0005, 0.0035))
def test_the_bias_is_recovered_from_a_flat_garment(bias: float, layers: int, thickness: float) -> None:
    height, mask = flat_garment((layers - 0.5) * thickness + bias)
    found = estimate_camera_bias(height, mask, layers, thickness, 0.0002, settings=S)
    assert found.measured and found.value == pytest.approx(bias, abs=1e-4)
    assert found.sigma == pytest.approx((layers - 0.5) * 0.0002)


@pytest.mark.parametrize("bias", [-0.004, 0.012])
def test_an_implausible_bias_is_replaced_by_the_expected_one(bias: float) -> None:
    height, mask = flat_garment(0.0005 + bias)
    found = estimate_camera_bias(height, mask, 1, 0.001, settings=S)
    assert (found.value, found.sigma, found.measured) == (S.camera_bias, S.camera_bias_sigma, False)


def test_without_depth_the_expected_bias_is_used() -> None:
    height, mask = flat_garment(0.003)
    found = estimate_camera_bias(np.full_like(height, np.nan), mask, 1, 0.001, settings=S)
    assert (found.value, found.measured) == (S.camera_bias, False)
