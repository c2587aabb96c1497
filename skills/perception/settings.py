"""Thresholds of the recognition of a garment."""

from __future__ import annotations

from dataclasses import dataclass

__all__ = ["PerceptionSettings"]


@dataclass(frozen=True)
class PerceptionSettings:
    """Thresholds of recognition. Lengths [m]; shares and overlaps 0..1.

    method: 'reference', 'plain', 'grabcut' or 'watershed' (the paper's). Without a picture of the empty table,
    'reference' means 'plain', if that finds no garment 'grabcut', and last the proposals of `propose_garments`.
    """

    pixel: float = 0.002
    method: str = "reference"
    lowest_segmentation: float = 0.5
    litter: float = 0.08
    """Maximum area of other objects on the table, relative to the area of the garment."""
    intruder: float = 0.02
    """Maximum area of objects that reach into the picture from its edge, relative to the area of the garment."""
    min_template_iou: float = 0.80
    """Minimum overlap of a silhouette with the best template; below it the garment is unknown."""
    polygon_iou: float = 0.91
    """Minimum overlap of a silhouette with the polygon of its key points."""
    proposed_polygon_iou: float = 0.86
    """The same for a proposal, whose limbs may be bent as well as swung."""
    sure: float = 0.82
    """A proposal that fits so well (`candidate.fit_quality`) is accepted before the others are tried."""
    proportions: float = 0.20
    """Maximum difference from the template's proportions: standard deviation, over the outline's edges, of the
    logarithm of observed over template length."""
    least_turn: float = 0.35
    """Minimum turn of the outline at the place of a sharp corner, relative to the turn of this corner in the
    template."""
    category_margin: float = 0.03
    """The expected category is accepted unless another category has an overlap that is larger by more than
    this."""
    size_tolerance: float = 0.20
    """Maximum relative difference of the observed size from a garment's nominal size."""
    flat_height: float = 0.025
    """Maximum height of a flat garment (95th percentile over the garment)."""
    border: float = 0.006
    min_fit: float = 0.62
    """Minimum quality of a fit (`candidate.fit_quality`)."""
    least_confidence: float = 0.3
    """A garment is refused if the probability that its key points are accurate is below this. It is low, because
    each fold that is planned with them is inspected."""
    within: float = 0.010
    """The confidence is the probability that all key points lie within this distance of their true places, on a
    garment of its nominal size."""
    dark_level: float = 6.0
    white_level: float = 254.0
    depth_holes: float = 0.5
