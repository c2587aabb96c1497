"""The garment against a picture of the empty table, or against a table fitted to the view's rim.

A shadow scales a colour but hardly turns it, so that the comparison is made in log colour, where light is a common
offset: a pixel that is the table's colour times some factor below 1 can be shadow; the rest is garment. The
garment's own colours are learnt from what is surely garment; then each pixel is what it more likely is: garment,
lit table or table in some shadow.
"""

from __future__ import annotations

import cv2
import numpy as np

from skills.perception.registration.boundary import refine_boundary
from skills.perception.segmentation.colour_model import colour_likelihood, log_colour, noise_scale, opponent
from skills.perception.segmentation.covered import mean_height
from skills.perception.segmentation.mask import (
    Field,
    Image,
    Mask,
    Segmentation,
    SegmentationSettings,
    clean,
    closed,
    fill,
    nothing,
    opened,
)
from skills.perception.segmentation.table_model import (
    fit_table,
    light_change,
    light_plane,
    table_likelihood,
    table_spread,
)

__all__ = ["segment_plain", "segment_reference"]

_MIXED = 0.1
"""Share of a dark region that lies flat from which it is cloth and shadow together."""
_WIDE = 25
"""Square over which mean height tells cloth from a shadow beside it [px]."""
_STRIDE = 3
"""Of the pixels by which the box around the garment is found."""


def segment_reference(
    rgb: Image,
    reference: Image,
    valid: Mask,
    height: Field | None = None,
    settings: SegmentationSettings | None = None,
) -> Segmentation:
    """Garment against a picture of the empty table, both (H, W, 3) uint8 in the same view.

    valid: (H, W), where both pictures see the table. height: (H, W) [m] above the empty table's own
    measured height, NaN where unknown; it tells whether a dark, wide region is cloth or shadow, helps where
    colours leave a doubt, and tells a garment that covers half of the view from a change of light.
    """
    settings = settings or SegmentationSettings()
    image, table = log_colour(rgb), log_colour(reference)
    light = light_change(image, table, valid, height)
    few = np.s_[::_STRIDE, ::_STRIDE]
    sparse = opponent(image[few] - table[few] - light_plane(light, valid.shape, few))
    sparse_noise = noise_scale(np.ascontiguousarray(rgb[few]), 2.0 / _STRIDE)
    spread = table_spread(sparse, sparse_noise, valid[few])
    box = _changed(sparse, sparse_noise, spread, valid[few], settings)
    if box is None:
        return nothing(valid.shape)
    lit = table[box] + light_plane(light, valid.shape, box)
    inside = None if height is None else height[box]
    found = _in_box(rgb[box], image[box], lit, valid[box], inside, spread, settings)
    if not found.found:
        return nothing(valid.shape)
    contour = found.contour + np.array([box[1].start, box[0].start])
    mask, others = np.zeros(valid.shape, bool), np.zeros(valid.shape, bool)
    mask[box], others[box] = found.mask, found.others
    return Segmentation(mask, contour, found.confidence, others)


def _in_box(
    rgb: Image,
    image: Field,
    table: Field,
    valid: Mask,
    height: Field | None,
    spread: tuple[float, float],
    settings: SegmentationSettings,
) -> Segmentation:
    """The garment in a part of the view; image, table: log colours (h, w, 3)."""
    noise = noise_scale(rgb)
    difference = opponent(image - table)
    core = _core(difference, noise, spread, valid, height, settings)
    if np.count_nonzero(core) < settings.smallest_area // 4:
        return nothing(valid.shape)
    odds = colour_likelihood(image, noise, core)
    odds -= table_likelihood(difference, noise, spread, settings)
    if height is not None:
        odds += _height_odds(height, core)
    mask, others, share = clean((cv2.GaussianBlur(odds, (0, 0), 0.8) > 0) & valid, settings)
    if not mask.any():
        return nothing(valid.shape)
    contour, clear = refine_boundary(mask, rgb, np.exp(table))
    return Segmentation(fill(contour, valid), contour, share * clear, others)


def segment_plain(
    rgb: Image, valid: Mask, height: Field | None = None, settings: SegmentationSettings | None = None
) -> Segmentation:
    """Garment on a table of one colour, which is fitted to the rim of the view (a plane in log colour)."""
    return segment_reference(rgb, fit_table(rgb, valid), valid, height, settings)


def _changed(
    difference: Field, noise: Field, spread: tuple[float, float], valid: Mask, settings: SegmentationSettings
) -> tuple[slice, slice] | None:
    """The box, in view pixels, around all that is no lit table; `difference` is every `_STRIDE`-th pixel."""
    light, chroma = difference[..., 0], np.hypot(difference[..., 1], difference[..., 2])
    darker = np.maximum(settings.dark_offset, 4.0 * spread[0] * noise)
    odd = (chroma > 4.0 * spread[1] * noise) | (np.abs(light) > darker)
    odd = opened(closed(odd & valid, 3), 3)
    rows, columns = np.flatnonzero(odd.any(axis=1)), np.flatnonzero(odd.any(axis=0))
    if not len(rows):
        return None
    margin = 40
    return (
        slice(max(int(rows[0]) * _STRIDE - margin, 0), int(rows[-1]) * _STRIDE + margin + 1),
        slice(max(int(columns[0]) * _STRIDE - margin, 0), int(columns[-1]) * _STRIDE + margin + 1),
    )


def _core(
    difference: Field,
    noise: Field,
    spread: tuple[float, float],
    valid: Mask,
    height: Field | None,
    settings: SegmentationSettings,
) -> Mask:
    """What is surely garment: no shade of the table, or a wide dark region that stands above it."""
    light, c1, c2 = difference[..., 0], difference[..., 1], difference[..., 2]
    light_sigma, chroma_sigma = max(spread[0], 0.02) * noise, spread[1] * noise
    beyond = np.maximum(light, 0.0) + np.maximum(-light - settings.deepest_shadow, 0.0)
    doubt = np.sqrt((c1 * c1 + c2 * c2) / chroma_sigma**2 + (beyond / light_sigma) ** 2)
    core = opened((doubt > settings.surely_garment) & valid, 5)
    dark = light < -np.maximum(settings.dark_offset, 4.0 * spread[0] * noise)
    dark = opened(closed(dark & valid, 5), settings.shadow_rim) & ~core
    if dark.any():
        core |= _cloth_of(dark, height, settings)
    return core


def _cloth_of(dark: Mask, height: Field | None, settings: SegmentationSettings) -> Mask:
    """The dark, wide regions that are cloth by their height; without depth all of them are taken for it.

    Cloth and a shadow beside it can make one region: of that, only what stands up is cloth.
    """
    if height is None:
        return dark
    mean, known = mean_height(height, _WIDE)
    flat = known & (mean < 0.5 * settings.garment_height)
    cloth = np.zeros(dark.shape, bool)
    count, labels, stats, _ = cv2.connectedComponentsWithStats(dark.astype(np.uint8))
    for i in range(1, count):
        left, top, width, rows, area = stats[i]
        box = np.s_[top : top + rows, left : left + width]
        region = labels[box] == i
        if area < 200 or not _stands_up(region, height[box], settings):
            continue
        mixed = np.count_nonzero(region & flat[box]) > _MIXED * area
        cloth[box] |= opened(region & ~flat[box], settings.shadow_rim) if mixed else region
    return cloth


def _stands_up(region: Mask, height: Field, settings: SegmentationSettings) -> bool:
    samples = height[region]
    samples = samples[np.isfinite(samples)]
    return len(samples) < 50 or float(samples.mean()) > settings.garment_height


def _height_odds(height: Field, core: Mask) -> Field:
    """What depth says for the doubtful: at most two units of log odds, where cloth is thick enough to see."""
    known = np.isfinite(height)
    cloth = height[core & known]
    if len(cloth) < 500 or (top := float(np.median(cloth))) < 0.0015:
        return np.zeros(height.shape, np.float32)
    mean, seen = mean_height(height, 7)
    return np.where(seen, np.clip(4.0 * (mean / top - 0.5), -2.0, 2.0), 0.0).astype(np.float32)
