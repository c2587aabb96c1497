"""The record of an estimate of the garment's state, for the report."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

__all__ = ["EstimateNote"]


@dataclass(frozen=True, eq=False)
class EstimateNote:
    """fold: index of the fold; t: cell time [s]; says: the state in words; picture: (H, W, 3) the candidates drawn
    over the picture."""

    fold: int
    t: float
    says: str
    picture: NDArray[np.uint8]
