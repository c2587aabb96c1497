"""Height maps: the garment's heights over the table, as the depth camera measured them, in colour."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from foldcell.skills.perception.inspection.result import Inspection
from foldcell.skills.perception.rectification.heights import smooth_height

Picture = NDArray[np.uint8]

MARGIN = 12
"""Margin around the garment [px]."""
WIDTH = 420
"""Smallest width of a picture [px]."""
PAPER = 250
BAR = 34
"""Height of the strip below the picture that shows the colour scale [px]."""
TICK = 0.005
"""Distance of the ticks of the colour scale [m]."""
INK = 30


def height_maps(looks: Sequence[Inspection]) -> list[Picture]:
    """Return one (H, W, 3) RGB picture per inspection. All show the same part of the table in the same colour
    scale, from dark violet at the table to yellow at the highest point of all inspections. A bar below shows the
    scale."""
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
    picture = np.where(np.isfinite(height)[..., None], _colours(level), np.uint8(PAPER))
    scale = int(np.ceil(WIDTH / picture.shape[1]))
    picture = np.repeat(np.repeat(picture, scale, axis=0), scale, axis=1)
    return np.concatenate([picture, _bar(picture.shape[1], top)])


def _colours(level: NDArray[np.uint8]) -> Picture:
    """Convert levels to Viridis colours. Viridis is perceptually uniform: equal steps of height look equally
    large."""
    return np.asarray(cv2.applyColorMap(level, cv2.COLORMAP_VIRIDIS), np.uint8)[..., ::-1]


def _bar(width: int, top: float) -> Picture:
    """Draw a strip (BAR, width, 3) with the colours from height 0 to `top` [m], ticks, and both heights written in
    millimetres."""
    strip = np.full((BAR, width, 3), PAPER, np.uint8)
    labels = ("0 mm", f"{top * 1e3:.0f} mm")
    font, size, margin = cv2.FONT_HERSHEY_SIMPLEX, 0.45, 8
    widths = [cv2.getTextSize(label, font, size, 1)[0][0] for label in labels]
    left, right = widths[0] + 2 * margin, width - widths[1] - 2 * margin
    strip[margin : BAR - margin, left:right] = _colours(np.linspace(0, 255, right - left).astype(np.uint8)[None])
    for height in np.arange(TICK, top, TICK):
        x = left + round((right - left - 1) * height / top)
        strip[BAR - margin : BAR - margin + 4, x] = INK
    for label, x in zip(labels, (margin, right + margin), strict=True):
        cv2.putText(strip, label, (x, BAR // 2 + 5), font, size, (INK, INK, INK), 1, cv2.LINE_AA)
    return strip
