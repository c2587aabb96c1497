"""The claim: what the executive says of a finished fold, from the camera alone (made in `claiming.py`).

Records and pages need this value only: it stands apart from the image processing.
"""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass

__all__ = ["Claim", "claim_to_dict"]


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
