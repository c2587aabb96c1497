"""Models the colours of the empty table: by its picture and the change of light since then, or by a fit to the
view's rim."""

from __future__ import annotations

import cv2
import numpy as np

from foldcell.robots.ports import Array
from foldcell.skills.perception.rectification.heights import smooth_height
from foldcell.skills.perception.segmentation.colour_model import FLOOR, log_colour
from foldcell.skills.perception.segmentation.mask import Field, Image, Mask, eroded

DEEPEST_SHADOW = 1.0
"""Darkest possible shadow, as a decrease of the natural logarithm of the intensity: a shaded table has at least
exp(-1.0) = 37 % of its unshaded intensity."""
_SHADOW_SHARE = 0.05
"""Prior probability that a pixel of the table is in shadow."""
KNOWN_SHARE = 0.3
"""Heights are averaged where more than this share of the surroundings is known."""
_MIN_HEIGHT = 0.0012
"""A place is covered if the mean height over a square of `_WINDOW` pixels is above this [m]: four times the noise
of this mean."""
_WINDOW = 5
_MIN_SHARE = 0.4
"""Covered pixels are reported only if their share of the view is larger than this. If it is smaller, the table's
colour is the most frequent one, so the object cannot be mistaken for the table."""
_RIM = 2
_MAX_RIM_SHARE = 0.25
"""If more than this share of the view's rim, which is `_RIM` pixels wide, is also above `_MIN_HEIGHT`, the height
is not trusted and no covered pixels are reported."""


def light_change(image: Field, table: Field, valid: Mask, height: Field | None = None) -> Field:
    """Fit the change of light or exposure between the picture of the empty table and the image, both log colours.
    The result is one plane per channel, (3, 3), see `light_plane`.

    The planes are fitted to the pixels near the most frequent change, so that the garment's pixels are outliers.
    If the garment covers much of the view according to height (H, W) above the table [m], NaN where unknown, its
    pixels are excluded.
    """
    rows, columns = valid.shape
    r, c = np.mgrid[0:rows:6, 0:columns:6]
    keep = valid[r, c]
    if height is not None:
        keep &= ~_covered(height[::6, ::6], keep)
    d = (image[::6, ::6] - table[::6, ::6])[keep].astype(float)
    r, c = r[keep], c[keep]
    basis = np.stack([np.ones(len(r)), r / rows - 0.5, c / columns - 0.5], axis=1)
    centre = np.array([_mode(channel) for channel in d.T])
    plane = np.zeros((3, 3))
    plane[0] = centre
    for tolerance in (0.12, 0.08, 0.08):
        inlier = np.abs(d - basis @ plane).max(axis=1) < tolerance
        if np.count_nonzero(inlier) < 50:
            break
        plane = np.linalg.lstsq(basis[inlier], d[inlier], rcond=None)[0]
    return np.asarray(plane, dtype=np.float32)


def _covered(height: Field, valid: Mask) -> Mask:
    """Return the mask (h, w) of a large object on the table; the mask is empty unless the object covers much of
    the view. The object's colour can then be the most frequent one, so it could be mistaken for the table.

    height: (h, w) above the table [m], NaN where unknown. valid: (h, w), where the camera sees the table.
    """
    high = (smooth_height(height, _WINDOW, KNOWN_SHARE) > _MIN_HEIGHT) & valid
    rim = valid & ~eroded(valid, _RIM)
    large = np.count_nonzero(high) > _MIN_SHARE * np.count_nonzero(valid)
    if not large or np.count_nonzero(high & rim) > _MAX_RIM_SHARE * np.count_nonzero(rim):
        return np.zeros(valid.shape, bool)
    return high


def _mode(values: Array) -> float:
    """Find the most frequent value, by a smoothed histogram with bins of 0.02."""
    edges = np.arange(-2.0, 2.02, 0.02)
    counts, _ = np.histogram(np.clip(values, -1.99, 1.99), edges)
    best = int(np.argmax(np.convolve(counts, np.ones(5), mode="same")))
    near_mode = values[np.abs(values - (edges[best] + 0.01)) < 0.05]
    return float(np.median(near_mode)) if len(near_mode) else 0.0


def light_plane(plane: Field, shape: tuple[int, ...], where: tuple[slice, slice]) -> Field:
    """Evaluate one plane per channel in a part of the view, (h, w, 3). plane: (3, 3), its rows are the value at
    the centre, the slope downwards and the slope to the right. where: slices of rows and columns."""
    rows, columns = shape
    row_offset = (np.arange(rows) / rows - 0.5).astype(np.float32)[where[0], None, None]
    column_offset = (np.arange(columns) / columns - 0.5).astype(np.float32)[None, where[1], None]
    return np.asarray((plane[0] + row_offset * plane[1]) + column_offset * plane[2], dtype=np.float32)


def fit_table(rgb: Image, valid: Mask) -> Image:
    """Estimate a picture (H, W, 3) of the empty table: its log colour is a plane, fitted robustly to the rim of
    the view."""
    rows, columns = valid.shape
    inner = cv2.erode(valid.astype(np.uint8), np.ones((41, 41), np.uint8), borderValue=0) > 0
    rim = valid & ~inner
    r, c = np.nonzero(rim)
    r, c = r[::11], c[::11]
    colour = log_colour(rgb)
    d = colour[r, c].astype(float)
    basis = np.stack([np.ones(len(r)), r / rows - 0.5, c / columns - 0.5], axis=1)
    keep = np.ones(len(r), bool)
    plane = np.zeros((3, 3))
    for _ in range(4):
        plane = np.linalg.lstsq(basis[keep], d[keep], rcond=None)[0]
        residual = np.abs(d - basis @ plane).max(axis=1)
        keep = residual <= max(2.0 * float(np.median(residual)), 1e-3)
    row_offset = (np.arange(rows) / rows - 0.5)[:, None, None]
    column_offset = (np.arange(columns) / columns - 0.5)[None, :, None]
    table = np.exp(plane[0] + row_offset * plane[1] + column_offset * plane[2]) - 8.0
    return np.clip(table, 0, 255).astype(np.uint8)


def table_spread(difference: Field, noise: Field, valid: Mask) -> tuple[float, float]:
    """Estimate the standard deviations of the empty table's log luminance and log chromaticity, in units of
    `noise_scale`."""
    light, c1, c2 = difference[..., 0], difference[..., 1], difference[..., 2]
    table = valid & (np.abs(light) < 0.1) & (np.hypot(c1, c2) < 0.08)
    chroma = max(_spread(c1, noise, table), _spread(c2, noise, table), 0.006)
    return max(_spread(light, noise, table), 0.008), chroma


def _spread(values: Field, noise: Field, where: Mask) -> float:
    """Compute the robust standard deviation of values / noise in the mask `where`."""
    sample = values[where] / noise[where]
    return float(1.4826 * np.median(np.abs(sample - np.median(sample)))) if len(sample) > 20 else 0.03


def table_likelihood(difference: Field, noise: Field, spread: tuple[float, float]) -> Field:
    """Compute the log density (H, W) of each pixel's colour under the assumption that it shows the table, unshaded
    or in a shadow of any depth. difference: (H, W, 3) from the empty table, as of `opponent`."""
    light, c1, c2 = difference[..., 0], difference[..., 1], difference[..., 2]
    light_sigma, chroma_sigma = spread[0] * noise, spread[1] * noise
    lit = np.exp(-0.5 * np.minimum((light / light_sigma) ** 2, 80.0)) / (2.5066 * light_sigma)
    shaded = (light < 0) & (light > -DEEPEST_SHADOW)
    density = (1 - _SHADOW_SHARE) * lit + _SHADOW_SHARE / DEEPEST_SHADOW * shaded
    colour = -0.5 * (c1 * c1 + c2 * c2) / chroma_sigma**2 - 2.0 * np.log(chroma_sigma) - 1.8379
    return np.maximum(np.log(density + 1e-12) + colour, FLOOR)
