"""Segments a garment by comparison with a picture of the empty table, or with a table fitted to the view's rim.

A shadow scales a colour but hardly changes its hue. The comparison therefore uses log colours, in which a change
of illumination is the same offset in all channels. A pixel with the table's colour times a factor below 1 can be
shadow; a pixel with any other colour is garment. The garment's colours are learnt from pixels that are certainly
garment. Each pixel is then assigned to the most likely class: garment, unshaded table or shaded table.
"""

from __future__ import annotations

import cv2
import numpy as np

from foldcell.skills.perception.rectification.heights import smooth_height
from foldcell.skills.perception.segmentation.colour_model import (
    colour_likelihood,
    log_colour,
    noise_scale,
    opponent,
)
from foldcell.skills.perception.segmentation.mask import (
    SMALLEST_AREA,
    Field,
    Image,
    Mask,
    Segmentation,
    closed,
    empty_segmentation,
    opened,
    outlined,
)
from foldcell.skills.perception.segmentation.table_model import (
    DEEPEST_SHADOW,
    KNOWN_SHARE,
    fit_table,
    light_change,
    light_plane,
    table_likelihood,
    table_spread,
)

_MIXED_SHARE = 0.1
"""If more than this share of a dark region is flat, the region consists of cloth and shadow."""
_WINDOW = 25
"""Side of the square over which the height is averaged, to separate cloth from an adjacent shadow [px]."""
_SURELY_GARMENT = 6.0
"""A pixel whose colour is further than this from every shade of the table is certainly garment [standard
deviations]."""
_DARK_OFFSET = 0.04
"""A region that is darker than the table by more than this [natural logarithm of the intensity], and wider than
`_SHADOW_RIM`, may be a dark garment."""
_SHADOW_RIM = 13
"""Maximum width of the shadows that a flat garment casts [px]."""
_GARMENT_HEIGHT = 0.0006
"""A dark region whose mean height is above this is cloth, not shadow [m]."""
_STRIDE = 3
"""Distance between the pixels that are used to find the garment's bounding box [px]."""


def segment_reference(rgb: Image, reference: Image, valid: Mask, height: Field | None = None) -> Segmentation:
    """Segment a garment by comparison with a picture of the empty table, both (H, W, 3) uint8 in the same view.

    valid: (H, W), where both pictures see the table. height: (H, W) above the measured empty table [m], NaN where
    unknown. Height separates cloth from shadow in dark, wide regions, and decides where colours are ambiguous. It
    also distinguishes a garment that covers half of the view from a change of light.
    """
    image, table = log_colour(rgb), log_colour(reference)
    light = light_change(image, table, valid, height)
    strided = np.s_[::_STRIDE, ::_STRIDE]
    sparse = opponent(image[strided] - table[strided] - light_plane(light, valid.shape, strided))
    sparse_noise = noise_scale(np.ascontiguousarray(rgb[strided]), 2.0 / _STRIDE)
    spread = table_spread(sparse, sparse_noise, valid[strided])
    box = _changed_box(sparse, sparse_noise, spread, valid[strided])
    if box is None:
        return empty_segmentation(valid.shape)
    lit = table[box] + light_plane(light, valid.shape, box)
    box_height = None if height is None else height[box]
    found = _segment_in_box(rgb[box], image[box], lit, valid[box], box_height, spread)
    if not found.found:
        return empty_segmentation(valid.shape)
    contour = found.contour + np.array([box[1].start, box[0].start])
    mask, others = np.zeros(valid.shape, bool), np.zeros(valid.shape, bool)
    mask[box], others[box] = found.mask, found.others
    return Segmentation(mask, contour, found.confidence, others)


def _segment_in_box(
    rgb: Image,
    image: Field,
    table: Field,
    valid: Mask,
    height: Field | None,
    spread: tuple[float, float],
) -> Segmentation:
    """Segment the garment in a part of the view. image, table: log colours (h, w, 3) of the picture and of the
    unshaded, empty table. spread: of the table's colour, see `table_spread`."""
    noise = noise_scale(rgb)
    difference = opponent(image - table)
    core = _certain_garment(difference, noise, spread, valid, height)
    if np.count_nonzero(core) < SMALLEST_AREA // 4:
        return empty_segmentation(valid.shape)
    odds = colour_likelihood(image, noise, core)
    odds -= table_likelihood(difference, noise, spread)
    if height is not None:
        odds += _height_odds(height, core)
    return outlined((cv2.GaussianBlur(odds, (0, 0), 0.8) > 0) & valid, rgb, valid, np.exp(table))


def segment_plain(rgb: Image, valid: Mask, height: Field | None = None) -> Segmentation:
    """Segment a garment on a table without pattern. A plane, fitted to the rim of the view, gives its log
    colour."""
    return segment_reference(rgb, fit_table(rgb, valid), valid, height)


def _changed_box(
    difference: Field, noise: Field, spread: tuple[float, float], valid: Mask
) -> tuple[slice, slice] | None:
    """Find the bounding box, with a margin, of all pixels that differ from the unshaded table: slices of rows and
    of columns in the full view; None if no pixel differs. difference, noise, valid: every `_STRIDE`-th pixel."""
    light, chroma = difference[..., 0], np.hypot(difference[..., 1], difference[..., 2])
    darker = np.maximum(_DARK_OFFSET, 4.0 * spread[0] * noise)
    changed = (chroma > 4.0 * spread[1] * noise) | (np.abs(light) > darker)
    changed = opened(closed(changed & valid, 3), 3)
    rows, columns = np.flatnonzero(changed.any(axis=1)), np.flatnonzero(changed.any(axis=0))
    if not len(rows):
        return None
    margin = 40
    return (
        slice(max(int(rows[0]) * _STRIDE - margin, 0), int(rows[-1]) * _STRIDE + margin + 1),
        slice(max(int(columns[0]) * _STRIDE - margin, 0), int(columns[-1]) * _STRIDE + margin + 1),
    )


def _certain_garment(
    difference: Field,
    noise: Field,
    spread: tuple[float, float],
    valid: Mask,
    height: Field | None,
) -> Mask:
    """Find the pixels that are certainly garment. Either their colour is no shade of the table, or they belong to
    a wide dark region that is raised above the table."""
    light, c1, c2 = difference[..., 0], difference[..., 1], difference[..., 2]
    light_sigma, chroma_sigma = max(spread[0], 0.02) * noise, spread[1] * noise
    outside_shadow_range = np.maximum(light, 0.0) + np.maximum(-light - DEEPEST_SHADOW, 0.0)
    distance = np.sqrt((c1 * c1 + c2 * c2) / chroma_sigma**2 + (outside_shadow_range / light_sigma) ** 2)
    core = opened((distance > _SURELY_GARMENT) & valid, 5)
    dark = light < -np.maximum(_DARK_OFFSET, 4.0 * spread[0] * noise)
    dark = opened(closed(dark & valid, 5), _SHADOW_RIM) & ~core
    if dark.any():
        core |= _dark_cloth(dark, height)
    return core


def _dark_cloth(dark: Mask, height: Field | None) -> Mask:
    """Select the dark, wide regions that are cloth, because they are raised. Without depth, all of them count as
    cloth.

    Cloth and an adjacent shadow can form one region. Then only its raised part is cloth.
    """
    if height is None:
        return dark
    flat = smooth_height(height, _WINDOW, KNOWN_SHARE) < 0.5 * _GARMENT_HEIGHT
    cloth = np.zeros(dark.shape, bool)
    count, labels, stats, _ = cv2.connectedComponentsWithStats(dark.astype(np.uint8))
    for i in range(1, count):
        left, top, width, rows, area = stats[i]
        box = np.s_[top : top + rows, left : left + width]
        region = labels[box] == i
        if area < 200 or not _is_raised(region, height[box]):
            continue
        mixed = np.count_nonzero(region & flat[box]) > _MIXED_SHARE * area
        cloth[box] |= opened(region & ~flat[box], _SHADOW_RIM) if mixed else region
    return cloth


def _is_raised(region: Mask, height: Field) -> bool:
    samples = height[region]
    samples = samples[np.isfinite(samples)]
    return len(samples) < 50 or float(samples.mean()) > _GARMENT_HEIGHT


def _height_odds(height: Field, core: Mask) -> Field:
    """Compute log odds (H, W) from the height, -2 (table) to 2 (garment), which decide ambiguous pixels. They are
    0 where the height is unknown, and everywhere if the cloth is too thin to be measured."""
    known = np.isfinite(height)
    cloth = height[core & known]
    if len(cloth) < 500 or (top := float(np.median(cloth))) < 0.0015:
        return np.zeros(height.shape, np.float32)
    mean = smooth_height(height, 7, KNOWN_SHARE)
    return np.nan_to_num(np.clip(4.0 * (mean / top - 0.5), -2.0, 2.0)).astype(np.float32)
