"""Limits and uncertainties of the claim that a garment is folded."""

from __future__ import annotations

from dataclasses import dataclass

__all__ = ["ClaimSettings"]


@dataclass(frozen=True, kw_only=True)
class ClaimSettings:
    """From the group `inspection` of the cell's settings. Lengths [m], angles [rad]. The sigmas are standard
    deviations.

    The limits are those of the score. How far a figure has to be from its limit follows from its error
    (`claiming.SURE`).
    """

    iou: float
    """Minimum overlap with the plan's target."""
    drift: float
    drift_angle: float
    """Largest displacement of the garment since it was first seen."""
    stack_margin: float
    """Height allowed above the flat stack."""
    ideal_margin: float
    """Height allowed above that of the ideal fold, away from creases."""
    crease_margin: float
    """The same near creases."""
    height_sigma: float
    crease_sigma: float
    """Error of an observed height after the camera's bias was subtracted."""
    first_crease_sigma: float
    """Error of the first crease's height as a measure of the bending length. It includes the error of the
    observation and the difference from an ideal fold."""
    ideal_sigma: float
    """Error of the ideal fold's heights for a known bending length."""
    thickness_spread: float
    """Error of the stated thickness of a layer, as a share of it, for garments without a class of fabrics."""
    camera_bias: float
    camera_bias_sigma: float
    """Bias of the camera's heights, where it was not measured."""
