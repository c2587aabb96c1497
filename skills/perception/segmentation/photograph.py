"""Proposes garments in a photograph of an unknown place: a floor with a pattern, uneven light, no picture of the
empty floor.

No single rule tells cloth from every floor. Several segmentations are therefore made: by the distance of each
colour from a smooth model of the floor, and by brightness and saturation alone. They are judged against each other
by two properties of a garment's outline: the colour changes along all of it, and it is smooth.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import cv2
import numpy as np

from foldcell.robots.ports import Array
from foldcell.skills.perception.outline import outward_normals, smooth_closed
from foldcell.skills.perception.registration.boundary import longest_contour, refine_boundary, sample
from foldcell.skills.perception.segmentation.mask import (
    SMALLEST_AREA,
    Field,
    Image,
    Mask,
    Segmentation,
    closed,
    eroded,
    fill,
    filled,
    graph_cut,
    largest,
    opened,
    reduced,
)
from foldcell.skills.perception.segmentation.surroundings import MOST_FOREIGN, foreign_stretch

_SIZE = 320
"""Longer edge of the reduced picture in which regions are sought [px]."""
_RIM = 0.06
"""Width of the rim that is assumed to show mostly floor, relative to the longer edge."""
_FLOOR_SIGMA = np.array([4.0, 1.5, 1.5])
"""Least standard deviations of the floor's lightness and colour (Lab) [grey levels]."""
_LEVELS = (2.5, 3.5, 5.0, 7.0, 10.0, 14.0)
"""Distances from the floor's colour at which regions are cut out [standard deviations]."""
_SMALLEST, _LARGEST = 0.03, 0.75
"""Least and largest area of a garment, relative to the picture."""
_BORDER = 4
"""A region that comes this near to the border of the picture may go on beyond it [px]."""
_SAME = 0.94
"""Regions that overlap by more than this (intersection over union) are the same."""
_REACH = 2.5
"""Distance from the outline at which the colours on both sides are compared [px]."""
_CLEAR_STEP = 30.0
"""A clear step of colour (Lab); larger steps count as this one [grey levels]."""
_VISIBLE = 0.25
"""A step of colour that is visible, relative to a clear one."""
_LEAST_SCORE = 0.4
"""Least score of a garment that the border cuts off."""
_LEAST_CLEAR = 0.5
"""If less than this share of a region's outline is clearly visible, the region is a patch of the floor."""
_COUNT, _CUT_OFF = 6, 2
"""Number of proposals, and of things that the border cuts off."""
_RIVAL = 0.7
"""A separate region with more than this share of a proposal's score is another thing on the floor."""


@dataclass(frozen=True, eq=False)
class _Region:
    """A candidate in the reduced picture. mask: (h, w). score: 0..1."""

    mask: Mask
    score: float


def propose_garments(rgb: Image, valid: Mask) -> tuple[Segmentation, ...]:
    """Propose up to six garments in rgb (H, W, 3) where valid (H, W), the most likely first.

    A proposal's confidence is the share of its outline that is clearly visible. Its `others` are the separate
    regions that look as much like a garment as itself. What is not surrounded by the ground, as a print, is no
    proposal.
    """
    small, inside = reduced(rgb, valid, _SIZE)
    lab, least = _smooth_lab(small), _least(inside, valid)
    regions: list[_Region] = []
    for mask in _masks(small, lab, inside):
        for region in _regions(mask, inside, least):
            _add(regions, region, lab)
    for found in list(regions):
        for region in _regions(_cut(small, found.mask, inside), inside, least):
            _add(regions, region, lab)
    regions.sort(key=lambda r: -r.score)
    proposals = [_refined(region, regions, rgb, valid) for region in regions[:_COUNT]]
    clear = [p for p in proposals if p.confidence > _LEAST_CLEAR and np.count_nonzero(p.mask) >= SMALLEST_AREA]
    return tuple(p for p in clear if foreign_stretch(rgb, valid, p)[0] <= MOST_FOREIGN)


def propose_cut_off(rgb: Image, valid: Mask) -> tuple[Segmentation, ...]:
    """Propose things in rgb (H, W, 3) that the border of the picture cuts off: up to two garments that are partly
    out of view, and what has the colour of skin, which may be an arm. A proposal's confidence is the share of its
    outline within the picture that is visible."""
    small, inside = reduced(rgb, valid, _SIZE)
    lab, border, least = _smooth_lab(small), _border(inside), _least(inside, valid)
    regions: list[_Region] = []
    for mask in _masks(small, lab, inside):
        for region in _regions(mask, inside, least, cut_off=True):
            _add(regions, region, lab, ~border)
    likely = sorted((r for r in regions if r.score > _LEAST_SCORE), key=lambda r: -r.score)[:_CUT_OFF]
    limbs = skin(small) & inside & (table_distance(lab, inside) > _LEVELS[2])
    masks = [*(r.mask for r in likely), *_regions(limbs, inside, least, cut_off=True)]
    found = []
    for region in masks:
        mask = cv2.resize(region.astype(np.float32), valid.shape[::-1], interpolation=cv2.INTER_LINEAR) > 0.5
        clear = float(np.mean(_steps(region, lab, ~border)[0] > _VISIBLE))
        found.append(Segmentation(mask, longest_contour(mask), clear, np.zeros(valid.shape, bool)))
    return tuple(found)


def skin(rgb: Image) -> Mask:
    """Return where a picture (h, w, 3) has a colour of skin of any shade (Chai and Ngan, IEEE TCSVT 1999)."""
    y, cr, cb = cv2.split(cv2.cvtColor(cv2.GaussianBlur(rgb, (0, 0), 1.5), cv2.COLOR_RGB2YCrCb))
    return np.asarray((cr >= 133) & (cr <= 178) & (cb >= 77) & (cb <= 127) & (y > 30))


def _smooth_lab(rgb: Image) -> Field:
    return cv2.cvtColor(cv2.GaussianBlur(rgb, (0, 0), 0.8), cv2.COLOR_RGB2LAB).astype(np.float32)


def _least(inside: Mask, valid: Mask) -> float:
    """Return the least area of a garment in the reduced picture [px^2]."""
    return max(_SMALLEST * np.count_nonzero(inside), SMALLEST_AREA * min(_SIZE / max(valid.shape), 1.0) ** 2)


def _border(inside: Mask) -> Mask:
    return inside & ~eroded(inside, _BORDER)


def table_distance(lab: Field, inside: Mask) -> Field:
    """Compute the distance (h, w) of each colour from the floor's [standard deviations].

    The floor's colour is a quadratic function of the place, fitted to the rim by Huber's weights. It is kept
    within the rim's own colours, because far from the rim a quadratic function can take any value. lab: (h, w, 3).
    """
    rows, columns = inside.shape
    rim = inside & ~eroded(inside, max(round(_RIM * max(inside.shape)), 2))
    r, c = np.nonzero(rim)
    basis = _quadratic(r / rows - 0.5, c / columns - 0.5)
    sample = lab[r, c].astype(float)
    weight = np.ones(sample.shape)
    fitted = np.zeros((basis.shape[1], 3))
    sigma = _FLOOR_SIGMA.copy()
    for _ in range(6):
        for k in range(3):
            w = np.sqrt(weight[:, k])[:, None]
            fitted[:, k] = np.linalg.lstsq(basis * w, sample[:, k] * w[:, 0], rcond=None)[0]
        residual = np.abs(sample - basis @ fitted)
        sigma = np.maximum(1.4826 * np.median(residual, axis=0), _FLOOR_SIGMA)
        weight = np.minimum(1.0, 1.5 * sigma / np.maximum(residual, 1e-6))
    place = np.meshgrid(np.arange(rows) / rows - 0.5, np.arange(columns) / columns - 0.5, indexing="ij")
    floor = (_quadratic(place[0].ravel(), place[1].ravel()) @ fitted).reshape(rows, columns, 3)
    floor = np.clip(floor, np.quantile(sample, 0.02, axis=0), np.quantile(sample, 0.98, axis=0))
    return np.asarray(np.linalg.norm((lab - floor) / sigma, axis=2), dtype=np.float32)


def _quadratic(y: Array, x: Array) -> Array:
    return np.stack([np.ones_like(x), x, y, x * x, x * y, y * y], axis=1)


def _masks(rgb: Image, lab: Field, inside: Mask) -> Iterator[Mask]:
    """Yield raw masks (h, w): what differs from the floor at several levels, and what is dark, bright, pale or
    colourful."""
    distance = table_distance(lab, inside)
    for level in _LEVELS:
        yield (distance > level) & inside
    scaled = np.clip(distance * 8.0, 0, 255).astype(np.uint8)
    yield (scaled > _otsu(scaled, inside)) & inside
    hsv = cv2.cvtColor(rgb, cv2.COLOR_RGB2HSV)
    for channel in (hsv[..., 2], hsv[..., 1]):
        smooth = np.asarray(cv2.GaussianBlur(channel, (0, 0), 1.5), dtype=np.uint8)
        level = _otsu(smooth, inside)
        yield (smooth > level) & inside
        yield (smooth <= level) & inside


def _otsu(channel: Image, inside: Mask) -> float:
    level, _ = cv2.threshold(channel[inside].reshape(-1, 1), 0, 255, cv2.THRESH_BINARY + cv2.THRESH_OTSU)
    return float(level)


def _regions(mask: Mask, inside: Mask, least: float, cut_off: bool = False) -> Iterator[Mask]:
    """Yield the mask's connected regions, filled, that have the size of a garment and do not reach the border, or
    those that it cuts off."""
    border = _border(inside)
    most = _LARGEST * np.count_nonzero(inside)
    for size in (3, 7):
        cleaned = opened(closed(mask, size), 5)
        count, labels, stats, _ = cv2.connectedComponentsWithStats(cleaned.astype(np.uint8))
        for i in range(1, count):
            if stats[i, cv2.CC_STAT_AREA] < least:
                continue
            region = filled(labels == i)
            if np.count_nonzero(region) <= most and (region & border).any() == cut_off:
                yield region


def _add(regions: list[_Region], mask: Mask, lab: Field, counted: Mask | None = None) -> None:
    """Add a region, or let it replace the same region with a lower score. counted: see `_score`."""
    score = _score(mask, lab, counted)
    for i, other in enumerate(regions):
        if np.count_nonzero(mask & other.mask) > _SAME * np.count_nonzero(mask | other.mask):
            if score > other.score:
                regions[i] = _Region(mask, score)
            return
    regions.append(_Region(mask, score))


def _score(mask: Mask, lab: Field, counted: Mask | None) -> float:
    """Compute how much a region looks like a garment (0..1). The score is the mean step of colour across the
    outline, relative to a clear step. A factor reduces the score of a ragged outline. counted: see `_steps`."""
    steps, ragged = _steps(mask, lab, counted)
    return float(steps.mean()) * float(np.exp(-ragged))


def _steps(mask: Mask, lab: Field, counted: Mask | None) -> tuple[Array, float]:
    """Return the steps of colour (n,) across a region's outline, relative to a clear step and at most 1, and how
    ragged the outline is [px]. counted: (h, w), where the outline counts; None: everywhere."""
    trace = longest_contour(mask)
    line = smooth_closed(trace, 1.5)
    normals = outward_normals(line)
    outside, inside = sample(lab, np.stack([line + _REACH * normals, line - _REACH * normals]))
    steps = np.minimum(np.linalg.norm(outside - inside, axis=1), _CLEAR_STEP) / _CLEAR_STEP
    ragged = np.linalg.norm(line - smooth_closed(trace, 8.0), axis=1)
    if counted is not None:
        columns, rows = trace.astype(int).T
        steps, ragged = steps[counted[rows, columns]], ragged[counted[rows, columns]]
    return (steps, float(ragged.mean())) if len(steps) else (np.zeros(1), 0.0)


def _cut(rgb: Image, region: Mask, inside: Mask) -> Mask:
    """Return the region after a graph cut (GrabCut) that starts from it."""
    labels = np.where(region, cv2.GC_PR_FGD, cv2.GC_PR_BGD).astype(np.uint8)
    labels[eroded(region, 6)] = cv2.GC_FGD
    labels[~eroded(inside, 3)] = cv2.GC_BGD
    if not (labels == cv2.GC_PR_FGD).any():
        return region
    return graph_cut(rgb, labels, 3)


def _refined(region: _Region, regions: list[_Region], rgb: Image, valid: Mask) -> Segmentation:
    """Return the region at full resolution, with its outline at the sharpest step of colour."""
    size = valid.shape[1], valid.shape[0]

    def enlarged(mask: Mask) -> Mask:
        return cv2.resize(mask.astype(np.float32), size, interpolation=cv2.INTER_LINEAR) > 0.5

    mask = largest(enlarged(region.mask) & valid)
    contour, clear = refine_boundary(mask, rgb, None)
    for _ in range(2):  # each search reaches six pixels
        finer = largest(fill(contour, valid))
        if np.count_nonzero(finer) < 0.5 * np.count_nonzero(mask):
            break
        mask = finer
        contour, clear = refine_boundary(mask, rgb, None)
    others = np.zeros(region.mask.shape, bool)
    for rival in regions:
        if rival.score > _RIVAL * region.score and not (rival.mask & region.mask).any():
            others |= rival.mask
    return Segmentation(fill(contour, valid), contour, clear, enlarged(others))
