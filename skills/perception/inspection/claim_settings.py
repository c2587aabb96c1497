"""Limits and uncertainties of the claim that a garment is folded."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

__all__ = ["ClaimSettings"]


@dataclass(frozen=True)
class ClaimSettings:
    """Lengths [m], angles [rad]. The sigmas are standard deviations.

    The limits are those of the score. No margin of safety is subtracted from them: a false claim and a good fold
    that is not claimed are equally wrong, and at the limit itself both are equally rare. The claim's reliability
    tells how far the figures are from it.
    """

    iou: float = 0.90
    """Minimum overlap with the plan's target."""
    outline: float = 0.027
    """Largest distance of an earlier fold's outline from the predicted one: the 30 mm of the score, less the error
    of an outline."""
    drift: float = 0.050
    drift_angle: float = float(np.deg2rad(10.0))
    """Largest displacement of the garment since it was first seen."""
    stack_margin: float = 0.010
    """Height allowed above the flat stack."""
    ideal_margin: float = 0.003
    """Height allowed above that of the ideal fold, away from creases."""
    crease_margin: float = 0.010
    """The same near creases."""
    height_sigma: float = 0.0010
    crease_sigma: float = 0.0010
    """Error of an observed height after the camera's bias was subtracted."""
    first_crease_sigma: float = 0.004
    """Error with which the first crease shows the bending length: of the observation, and because the fold is not
    ideal."""
    ideal_sigma: float = 0.0015
    """Error of the ideal fold's heights for a known bending length, relative to no other figure."""
    thickness_spread: float = 0.06
    """Error of the stated thickness of a layer, as a share of it, for garments without a class of fabrics."""
    camera_bias: float = 0.0025
    camera_bias_sigma: float = 0.0011
    """Bias of the camera's heights, where it was not measured."""
    iou_sigma: float = 0.010
    drift_sigma: float = 0.004
    drift_angle_sigma: float = float(np.deg2rad(1.0))
    """Errors of the figures of the shape."""
