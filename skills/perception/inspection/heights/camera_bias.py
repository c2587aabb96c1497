"""Estimates by how much the camera sees cloth too high, from the flat garment before its first fold."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from skills.perception.inspection.claim_settings import ClaimSettings

__all__ = ["CameraBias", "estimate_camera_bias"]

RIM = 11
"""Side of the square by which the silhouette is eroded [px]. At its rim, hems stand high and depths of cloth and
table are mixed."""
FEWEST = 1000
"""Fewest pixels of which the median is taken."""
PLAUSIBLE = 4.0
"""An estimate further than this many standard deviations from the expected bias is not believed."""


@dataclass(frozen=True)
class CameraBias:
    """Bias of the camera's heights [m], positive if cloth is seen too high, and its standard deviation [m].
    measured: False if the expected value of the settings is used instead of an estimate."""

    value: float
    sigma: float
    measured: bool


def estimate_camera_bias(
    height: NDArray[np.float32],
    mask: NDArray[np.bool_],
    layers: int,
    thickness: float,
    thickness_sigma: float = 0.0,
    settings: ClaimSettings | None = None,
) -> CameraBias:
    """Estimate the bias: the median height over the interior of a flat garment minus its true height.

    height: (H, W) above the table [m], NaN where unknown. mask: (H, W) of the garment. layers: number of layers of
    the flat garment, each `thickness` [m] thick, with the standard deviation `thickness_sigma`. The true height is
    that of the middle of the upper layer, as in the simulation and the score.

    If too little is visible, or if the estimate is implausible (for example because the garment is crumpled), the
    result is the expected bias of the settings.
    """
    settings = settings or ClaimSettings()
    expected = CameraBias(settings.camera_bias, settings.camera_bias_sigma, measured=False)
    interior = cv2.erode(mask.astype(np.uint8), np.ones((RIM, RIM), np.uint8)) > 0
    samples = height[interior & np.isfinite(height)]
    if len(samples) < FEWEST:
        return expected
    value = float(np.median(samples)) - (layers - 0.5) * thickness
    if abs(value - expected.value) > PLAUSIBLE * expected.sigma:
        return expected
    return CameraBias(value, (layers - 0.5) * thickness_sigma, measured=True)
