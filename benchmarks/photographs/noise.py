"""Smooth random fields, for grain, wrinkles and light."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

Field = NDArray[np.float32]


def smooth(rng: np.random.Generator, shape: tuple[int, int], scale: tuple[float, float]) -> Field:
    """Noise of unit deviation whose features measure about `scale` (rows, columns) in pixels."""
    grid = tuple(max(2, round(n / s) + 2) for n, s in zip(shape, scale, strict=True))
    values = rng.standard_normal(grid).astype(np.float32)
    field = cv2.resize(values, shape[::-1], interpolation=cv2.INTER_CUBIC)
    return np.asarray((field - field.mean()) / max(float(field.std()), 1e-6), np.float32)


def turned(field: Field, angle: float) -> Field:
    """The field turned about its middle; the margin is mirrored."""
    rows, columns = field.shape[:2]
    matrix = cv2.getRotationMatrix2D((columns / 2, rows / 2), np.degrees(angle), 1.0)
    turned_field = cv2.warpAffine(field, matrix, (columns, rows), borderMode=cv2.BORDER_REFLECT)
    return np.asarray(turned_field, np.float32)
