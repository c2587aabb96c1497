"""Height maps: the garment's heights over the table, as the depth camera measured them, in colour."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from skills.perception.inspection.inspect import Inspection
from skills.perception.perceive import smooth_height

__all__ = ["height_maps"]

Picture = NDArray[np.uint8]

MARGIN = 12
"""Margin around the garment [px]."""
WIDTH = 420
"""Least width of a picture [px]."""
PAPER = 250


def height_maps(looks: Sequence[Inspection]) -> list[Picture]:
    """One (H, W, 3) RGB picture for each look. All show the same part of the table in the same colour scale, from
    blue at the table to red at the highest point of all looks."""
    rows, columns = np.nonzero(np.logical_or.reduce([look.mask for look in looks]))
    part = (
        slice(max(int(rows.min()) - MARGIN, 0), int(rows.max()) + MARGIN),
        slice(max(int(columns.min()) - MARGIN, 0), int(columns.max()) + MARGIN),
    )
    smooth = [np.where(look.mask, smooth_height(look.height, 5), np.nan)[part] for look in looks]
    top = max(float(np.nanquantile(height, 0.995)) for height in smooth)
    return [_coloured(height, top) for height in smooth]


def _coloured(height: NDArray[np.floating], top: float) -> Picture:
    level = (255.0 * np.clip(np.nan_to_num(height) / top, 0.0, 1.0)).astype(np.uint8)
    colour = np.asarray(cv2.applyColorMap(level, cv2.COLORMAP_TURBO))[..., ::-1]
    picture = np.where(np.isfinite(height)[..., None], colour, np.uint8(PAPER))
    scale = int(np.ceil(WIDTH / picture.shape[1]))
    return np.repeat(np.repeat(picture, scale, axis=0), scale, axis=1)
