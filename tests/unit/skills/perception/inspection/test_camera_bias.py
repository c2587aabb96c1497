"""The bias of the camera's heights is recovered from a flat garment, or is the expected one."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from skills.perception.inspection.claim_settings import ClaimSettings
from skills.perception.inspection.height_expectation import estimate_camera_bias

S = ClaimSettings()


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
    found = estimate_camera_bias(height, mask, layers, thickness, 0.0002)
    assert found.measured and found.value == pytest.approx(bias, abs=1e-4)
    assert found.sigma == pytest.approx((layers - 0.5) * 0.0002)


@pytest.mark.parametrize("bias", [-0.004, 0.012])
def test_an_implausible_bias_is_replaced_by_the_expected_one(bias: float) -> None:
    height, mask = flat_garment(0.0005 + bias)
    found = estimate_camera_bias(height, mask, 1, 0.001)
    assert (found.value, found.sigma, found.measured) == (S.camera_bias, S.camera_bias_sigma, False)


def test_without_depth_the_expected_bias_is_used() -> None:
    height, mask = flat_garment(0.003)
    found = estimate_camera_bias(np.full_like(height, np.nan), mask, 1, 0.001)
    assert (found.value, found.measured) == (S.camera_bias, False)
