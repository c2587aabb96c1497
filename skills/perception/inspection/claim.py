"""The claim: what the executive says of a finished fold, from the camera alone (made in `claiming.py`).

Records, pages and settings need these values only: they stand apart from the image processing.
"""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass


@dataclass(frozen=True, kw_only=True)
class ClaimSettings:
    """Limits and errors of the claim, from the group `inspection` of the cell's settings. Lengths [m], angles
    [rad]. The sigmas are standard deviations.

    The limits are those of the score. How far a figure has to be from its limit follows from its error
    (`claiming.SURE`, or `claiming.SURE_AFTER` after a disturbance).
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


@dataclass(frozen=True)
class Claim:
    """The two parts of the claim, and the figures that decided.

    shape: seen from above, the garment lies as planned. flat: it is as flat as an ideal fold of its fabric may be.
    reliability: probability (0..1) that the claim is right, by the stated errors of the figures. Heights [m] are
    of the middle of the upper layer, above the table; the camera's bias `camera_bias_m` was subtracted. NaN: not
    visible. says: the claim in one sentence.
    """

    shape: bool
    flat: bool
    reliability: float
    height_m: float
    height_limit_m: float
    crease_height_m: float
    crease_height_limit_m: float
    camera_bias_m: float
    bending_length_m: float
    target_iou: float
    drift_m: float
    drift_rad: float
    says: str
    probable_flat: float = 1.0
    """Probability that the garment is flat."""
    probable_pressed: tuple[float, ...] = ()
    """Predicted probability that both parts hold after one more pressing of the crease, after two, and so on. With
    `probable` it decides whether the fold is pressed. Empty if pressing cannot mend the shape."""

    @property
    def holds(self) -> bool:
        return self.shape and self.flat

    @property
    def probable(self) -> float:
        """Probability that the garment is folded well."""
        return self.reliability if self.holds else 1.0 - self.reliability

    @property
    def too_high(self) -> bool:
        """Whether a measured height is above its limit. A height that is not visible does not count as too
        high."""
        return self.height_m > self.height_limit_m or self.crease_height_m > self.crease_height_limit_m


def claim_to_dict(claim: Claim) -> dict[str, bool | float | str | None]:
    """Return the claim as a mapping, in the form that results use. Figures that are not visible are None. The
    reliability stands for the probabilities."""
    told = {k: v for k, v in asdict(claim).items() if k not in {"probable_flat", "probable_pressed"}}
    return {k: None if isinstance(v, float) and not math.isfinite(v) else v for k, v in told.items()}
