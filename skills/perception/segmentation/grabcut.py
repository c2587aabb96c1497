"""The garment on a table of any pattern: what has the colours of the view's rim is table, and a cut through the
colour edges between the two says where it ends (Rother, Kolmogorov and Blake, GrabCut, SIGGRAPH 2004).
"""

from __future__ import annotations

import cv2
import numpy as np

from skills.perception.registration.boundary import refine_boundary
from skills.perception.segmentation.colour_model import (
    cluster_colours,
    colour_likelihood,
    log_colour,
    noise_scale,
    opponent,
)
from skills.perception.segmentation.mask import (
    Field,
    Image,
    Mask,
    Segmentation,
    SegmentationSettings,
    clean,
    eroded,
    fill,
    nothing,
)
from skills.perception.segmentation.table_model import fit_table

__all__ = ["segment_grabcut"]

_SMALL = 180
"""Longer edge of the picture that GrabCut works on [px]: the boundary is refined on the whole one."""
_RIM = 0.04
"""Width of the rim that is taken for table, relative to the view's longer edge."""
_STRANGE = 3.5
"""What lies further than this from every colour of the rim may be garment [standard deviations]."""
_TRUST = 1.5
"""Log odds between the two sides of GrabCut's boundary, against those of a pixel's own colour."""


def segment_grabcut(rgb: Image, valid: Mask, settings: SegmentationSettings | None = None) -> Segmentation:
    """Garment on a table of any pattern that is also seen along the view's rim, by GrabCut on a small picture."""
    settings = settings or SegmentationSettings()
    small, inside = _small(rgb, valid)
    colour = _unlit(small, inside)
    rim = inside & ~eroded(inside, max(round(_RIM * max(inside.shape)), 2))
    strange = _strangeness(colour, rim)
    labels = np.where(strange > _STRANGE, cv2.GC_PR_FGD, cv2.GC_PR_BGD).astype(np.uint8)
    labels[~inside] = cv2.GC_BGD
    if np.count_nonzero(labels == cv2.GC_PR_FGD) < 20 or np.count_nonzero(labels != cv2.GC_PR_FGD) < 20:
        return nothing(valid.shape)
    cv2.setRNGSeed(0)  # its colour clusters start from chance
    cv2.grabCut(colour, labels, (0, 0, 0, 0), np.zeros((1, 65)), np.zeros((1, 65)), 4, cv2.GC_INIT_WITH_MASK)
    cloth = np.isin(labels, (cv2.GC_FGD, cv2.GC_PR_FGD)).astype(np.float32)
    whole = np.asarray(cv2.resize(cloth, valid.shape[::-1], interpolation=cv2.INTER_LINEAR), dtype=np.float32)
    mask, others, share = clean(_by_colour(rgb, valid, whole) & valid, settings)
    if not mask.any():
        return nothing(valid.shape)
    contour, clear = refine_boundary(mask, rgb, None)
    return Segmentation(fill(contour, valid), contour, share * clear, others)


def _by_colour(rgb: Image, valid: Mask, coarse: Field) -> Mask:
    """Each pixel by the colours on both sides of a coarse boundary: a cut bridges what is narrower than its
    pixels, such as the table between two legs. coarse: (H, W), 1 where the garment is."""
    image = log_colour(rgb) - np.log(fit_table(rgb, valid).astype(np.float32) + 8.0)
    noise = noise_scale(rgb)
    garment, table = eroded(coarse > 0.5, 4), eroded((coarse < 0.5) & valid, 4)
    if min(np.count_nonzero(garment), np.count_nonzero(table)) < 500:
        return coarse > 0.5
    odds = colour_likelihood(image, noise, garment) - colour_likelihood(image, noise, table)
    return np.asarray(cv2.GaussianBlur(odds, (0, 0), 0.8) + _TRUST * (coarse - 0.5) > 0)


def _small(rgb: Image, valid: Mask) -> tuple[Image, Mask]:
    scale = min(_SMALL / max(valid.shape), 1.0)
    size = (max(round(valid.shape[1] * scale), 8), max(round(valid.shape[0] * scale), 8))
    inside = cv2.resize(valid.astype(np.uint8), size, interpolation=cv2.INTER_NEAREST) > 0
    return np.asarray(cv2.resize(rgb, size, interpolation=cv2.INTER_AREA), dtype=np.uint8), inside


def _unlit(rgb: Image, inside: Mask) -> Image:
    """Log luminance and chromaticities (h, w, 3) as bytes, the light's slope along the rim taken out."""
    colour = opponent(log_colour(rgb) - np.log(fit_table(rgb, inside).astype(np.float32) + 8.0))
    return np.clip(128.0 + colour * np.array([60.0, 160.0, 160.0], np.float32), 0, 255).astype(np.uint8)


def _strangeness(colour: Image, rim: Mask) -> Field:
    """Distance (h, w) of each pixel's colour from the nearest of the rim's four, in standard deviations."""
    sample = colour[rim].astype(float)
    _, centres, covariances = cluster_colours(sample, 4)
    floor = np.diag([4.0, 3.0, 3.0]) ** 2
    best = np.full(colour.shape[:2], np.inf)
    for centre, covariance in zip(centres, covariances, strict=True):
        z = (colour - centre) @ np.linalg.inv(np.linalg.cholesky(covariance + floor)).T
        best = np.minimum(best, np.sqrt((z * z).sum(axis=2)))
    return best
