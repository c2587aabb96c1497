"""Locates the garment's boundary with sub-pixel accuracy, from the colours on both sides."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from robots.ports import Array

__all__ = ["outward_normals", "refine_boundary", "smooth_closed"]

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
    pixels = _trace(mask)
    points = smooth_closed(pixels, 2.0)
    normals = outward_normals(points)
    offsets = np.arange(-_REACH, _REACH + 0.25, 0.5)
    positions = points[:, None, :] + offsets[None, :, None] * normals[:, None, :]
    profile = smooth_closed(_sample(rgb.astype(np.float32) + 8.0, positions), 1.5)
    inside = profile[:, offsets < -3.0].mean(axis=1)
    outside = profile[:, offsets > 3.0].mean(axis=1)
    beneath = outside[:, None, :] if table is None else smooth_closed(_sample(table, positions), 1.5)
    opacity, contrast = _opacity(profile, inside, outside, beneath)
    shift, found = _crossing(opacity, offsets)
    visible = found & (contrast > 6.0)
    shift = _running_median(np.where(visible, shift, 0.0))
    return points + shift[:, None] * normals, float(np.mean(visible))


def outward_normals(points: Array) -> Array:
    """Compute the outward unit normals (n, 2) of a closed contour (n, 2), whether it runs clockwise or not."""
    tangent = np.roll(points, -2, axis=0) - np.roll(points, 2, axis=0)
    tangent /= np.maximum(np.linalg.norm(tangent, axis=1, keepdims=True), 1e-9)
    x, y = points.T
    area = x @ np.roll(y, -1) - np.roll(x, -1) @ y
    return np.stack([tangent[:, 1], -tangent[:, 0]], axis=1) * (1.0 if area > 0 else -1.0)


def smooth_closed(values: Array, sigma: float) -> Array:
    """Smooth a closed sequence along its first axis by a Gaussian. sigma: in samples."""
    reach = int(np.ceil(3 * sigma))
    kernel = np.exp(-0.5 * (np.arange(-reach, reach + 1) / sigma) ** 2)
    kernel /= kernel.sum()
    if len(values) <= 2 * reach:
        return values
    flat: Array = values.reshape(len(values), -1).astype(np.float64)
    padded = np.concatenate([flat[-reach:], flat, flat[:reach]])
    smoothed: Array = np.asarray(cv2.filter2D(padded, -1, kernel[:, None]), dtype=np.float64)[reach:-reach]
    return smoothed.reshape(values.shape)


def _trace(mask: NDArray[np.bool_]) -> Array:
    contours, _ = cv2.findContours(mask.astype(np.uint8), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    longest = max(contours, key=len).reshape(-1, 2).astype(float)
    # findContours returns the centres of the outermost pixels; the edge lies half a pixel further out.
    return longest + 0.5 * outward_normals(smooth_closed(longest, 2.0))


def _sample(image: NDArray[np.float32], positions: Array) -> Array:
    return cv2.remap(
        image,
        positions[..., 0].astype(np.float32),
        positions[..., 1].astype(np.float32),
        cv2.INTER_LINEAR,
        borderMode=cv2.BORDER_REPLICATE,
    ).astype(float)


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
