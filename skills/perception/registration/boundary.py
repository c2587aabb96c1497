"""Locates the garment's boundary with sub-pixel accuracy, from the colours on both sides."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from foldcell.robots.ports import Array
from foldcell.skills.perception.outline import outward_normals, smooth_closed

_REACH = 6.0
"""Distance from the mask's boundary up to which the true boundary is searched, on both sides [px]."""


def refine_boundary(
    mask: NDArray[np.bool_], rgb: NDArray[np.uint8], table: NDArray[np.float32] | None
) -> tuple[Array, float]:
    """Compute the sub-pixel contour (n, 2) (column, row) of a mask, and the share (0..1) of it that is clearly
    visible.

    The colour I of a pixel on the boundary is a mixture a G + (1 - a) s T of the garment's colour G and the
    table's colour T, which a shadow darkens by the factor s. For a direction w orthogonal to T, I.w = a G.w for
    any s. The boundary is where a falls through 1/2. If garment and table differ only in brightness, w = G - T.
    table: (H, W, 3) colour of the table without garment; None: the colours outside the mask are used.
    """
    points = smooth_closed(_trace(mask), 2.0)
    normals = outward_normals(points)
    offsets = np.arange(-_REACH, _REACH + 0.25, 0.5)
    positions = points[:, None, :] + offsets[None, :, None] * normals[:, None, :]
    profile = smooth_closed(sample(rgb.astype(np.float32) + 8.0, positions), 1.5)
    inside = profile[:, offsets < -3.0].mean(axis=1)
    outside = profile[:, offsets > 3.0].mean(axis=1)
    beneath = outside[:, None, :] if table is None else smooth_closed(sample(table, positions), 1.5)
    opacity, contrast = _opacity(profile, inside, outside, beneath)
    shift, found = _crossing(opacity, offsets)
    visible = found & (contrast > 6.0)
    shift = _running_median(np.where(visible, shift, 0.0))
    return points + shift[:, None] * normals, float(np.mean(visible))


def longest_contour(mask: NDArray[np.bool_]) -> Array:
    """Return the pixels (n, 2) (column, row) along the longest outer boundary of a mask (H, W), which must not be
    empty."""
    contours, _ = cv2.findContours(mask.astype(np.uint8), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    return max(contours, key=len).reshape(-1, 2).astype(float)


def _trace(mask: NDArray[np.bool_]) -> Array:
    pixels = longest_contour(mask)
    # These are the centres of the outermost pixels; the edge lies half a pixel further out.
    return pixels + 0.5 * outward_normals(smooth_closed(pixels, 2.0))


def sample(image: NDArray[np.uint8] | NDArray[np.float32], pixels: NDArray[np.floating]) -> Array:
    """Sample an image (H, W) or (H, W, channels) at pixels (n, m, 2), bilinearly; outside the image, the nearest
    pixel counts. Returns (n, m) or (n, m, channels)."""
    columns, rows = np.moveaxis(pixels.astype(np.float32), -1, 0)
    return cv2.remap(image, columns, rows, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE).astype(float)


def _opacity(profile: Array, inside: Array, outside: Array, beneath: Array) -> tuple[Array, Array]:
    """Compute the garment's share a (n, m) in the colour of each sample, and the contrast (n,) of each profile
    [grey levels]."""
    unit = beneath / np.linalg.norm(beneath, axis=2, keepdims=True)
    garment = inside[:, None, :]
    w = garment - (garment * unit).sum(axis=2, keepdims=True) * unit
    hue = np.linalg.norm(w, axis=2)
    by_hue = (profile * w).sum(axis=2) / np.maximum(hue**2, 1e-6)
    step = inside - outside
    contrast = np.linalg.norm(step, axis=1)
    by_light = ((profile - outside[:, None, :]) * step[:, None, :]).sum(axis=2) / np.maximum(contrast**2, 1e-6)[
        :, None
    ]
    trust = np.clip((hue.mean(axis=1) - 10.0) / 15.0, 0.0, 1.0)[:, None]
    return trust * by_hue + (1 - trust) * by_light, np.maximum(hue.mean(axis=1), contrast)


def _crossing(opacity: Array, offsets: Array) -> tuple[Array, NDArray[np.bool_]]:
    """Find where each profile falls through 1/2: the offset (n,) [px] nearest to the mask's boundary, and (n,)
    whether there is one."""
    falls = (opacity[:, :-1] >= 0.5) & (opacity[:, 1:] < 0.5)
    drop = np.maximum(opacity[:, :-1] - opacity[:, 1:], 1e-9)
    where = offsets[:-1] + (opacity[:, :-1] - 0.5) / drop * (offsets[1] - offsets[0])
    cost = np.where(falls, np.abs(where), np.inf)
    best = np.argmin(cost, axis=1)
    rows = np.arange(len(opacity))
    return where[rows, best], np.isfinite(cost[rows, best])


def _running_median(shift: Array, width: int = 7) -> Array:
    """Compute the running median of `shift` along the closed contour, which removes single outliers."""
    half = width // 2
    padded = np.concatenate([shift[-half:], shift, shift[:half]])
    return np.median(np.lib.stride_tricks.sliding_window_view(padded, width), axis=1)
