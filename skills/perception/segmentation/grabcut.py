"""Segments a garment on a table of any pattern by GrabCut (Rother, Kolmogorov and Blake, SIGGRAPH 2004).

The colours at the view's rim are assumed to be those of the table. A graph cut along edges of colour gives the
garment's boundary.
"""

from __future__ import annotations

import cv2
import numpy as np

from foldcell.skills.perception.segmentation.colour_model import (
    cluster_colours,
    colour_likelihood,
    log_colour,
    noise_scale,
    opponent,
)
from foldcell.skills.perception.segmentation.mask import (
    Field,
    Image,
    Mask,
    Segmentation,
    empty_segmentation,
    eroded,
    graph_cut,
    outlined,
    reduced,
)
from foldcell.skills.perception.segmentation.table_model import fit_table

_REDUCED_SIZE = 180
"""Longer edge of the reduced picture for GrabCut [px]. The boundary is refined at full resolution."""
_RIM = 0.04
"""Width of the rim that is assumed to be table, relative to the view's longer edge."""
_MIN_COLOUR_DISTANCE = 3.5
"""A pixel whose colour is further than this from every colour of the rim may be garment [standard deviations]."""
_CUT_WEIGHT = 1.5
"""Weight of GrabCut's label. Half of it is added to a pixel's log odds, which follow from its colour, if the label
is garment; half of it is subtracted if the label is table."""


def segment_grabcut(rgb: Image, valid: Mask) -> Segmentation:
    """Segment a garment by GrabCut on a reduced picture. All of the table's pattern must be visible at the view's
    rim.

    rgb: (H, W, 3); valid: (H, W), where the camera sees the table.
    """
    small, inside = reduced(rgb, valid, _REDUCED_SIZE)
    colour = _light_corrected(small, inside)
    rim = inside & ~eroded(inside, max(round(_RIM * max(inside.shape)), 2))
    colour_distance = _colour_distance(colour, rim)
    labels = np.where(colour_distance > _MIN_COLOUR_DISTANCE, cv2.GC_PR_FGD, cv2.GC_PR_BGD).astype(np.uint8)
    labels[~inside] = cv2.GC_BGD
    if np.count_nonzero(labels == cv2.GC_PR_FGD) < 20 or np.count_nonzero(labels != cv2.GC_PR_FGD) < 20:
        return empty_segmentation(valid.shape)
    cloth = graph_cut(colour, labels, 4).astype(np.float32)
    coarse = np.asarray(cv2.resize(cloth, valid.shape[::-1], interpolation=cv2.INTER_LINEAR), dtype=np.float32)
    return outlined(_by_colour(rgb, valid, coarse) & valid, rgb, valid)


def _by_colour(rgb: Image, valid: Mask, coarse: Field) -> Mask:
    """Classify each pixel by the colours on both sides of a coarse boundary.

    This finds gaps that the cut misses because they are narrower than its coarse pixels, such as the table between
    two trouser legs. coarse: (H, W), 1 where the garment is.
    """
    image = log_colour(rgb) - np.log(fit_table(rgb, valid).astype(np.float32) + 8.0)
    noise = noise_scale(rgb)
    garment, table = eroded(coarse > 0.5, 4), eroded((coarse < 0.5) & valid, 4)
    if min(np.count_nonzero(garment), np.count_nonzero(table)) < 500:
        return coarse > 0.5
    odds = colour_likelihood(image, noise, garment) - colour_likelihood(image, noise, table)
    return np.asarray(cv2.GaussianBlur(odds, (0, 0), 0.8) + _CUT_WEIGHT * (coarse - 0.5) > 0)


def _light_corrected(rgb: Image, inside: Mask) -> Image:
    """Compute log luminance and chromaticities (h, w, 3) as bytes, without the gradient of the light, which is
    estimated at the rim."""
    colour = opponent(log_colour(rgb) - np.log(fit_table(rgb, inside).astype(np.float32) + 8.0))
    return np.clip(128.0 + colour * np.array([60.0, 160.0, 160.0], np.float32), 0, 255).astype(np.uint8)


def _colour_distance(colour: Image, rim: Mask) -> Field:
    """Compute the distance (h, w) of each pixel's colour from the nearest of the rim's four main colours, in
    standard deviations."""
    sample = colour[rim].astype(float)
    _, centres, covariances = cluster_colours(sample, 4)
    floor = np.diag([4.0, 3.0, 3.0]) ** 2
    best = np.full(colour.shape[:2], np.inf)
    for centre, covariance in zip(centres, covariances, strict=True):
        z = (colour - centre) @ np.linalg.inv(np.linalg.cholesky(covariance + floor)).T
        best = np.minimum(best, np.sqrt((z * z).sum(axis=2)))
    return best
