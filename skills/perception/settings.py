"""Thresholds of the recognition of a garment."""

from __future__ import annotations

from dataclasses import dataclass

VIEW_PIXEL = 0.002
"""Length of a pixel of the rectified view [m]."""
VIEW_BORDER = 0.006
"""A garment that comes nearer than this to the edge of the view is not wholly in view [m]."""
MIN_SEGMENTATION = 0.5
"""Minimum confidence of a segmentation."""
LITTER_SHARE = 0.08
"""Maximum area of other objects on the table, relative to the area of the garment."""


@dataclass(frozen=True, kw_only=True)
class PerceptionSettings:
    """Thresholds of recognition. Lengths [m]; shares and overlaps 0..1. Those without a default come from the
    group `perception` of the cell's settings. Constants stand beside the functions that use them.

    method: 'reference', 'plain' or 'grabcut'. Without a picture of the empty table, 'reference' means 'plain'. If
    that finds no garment, 'grabcut' is tried, and last the proposals of `propose_garments`; in a photograph of
    unknown scale, `segment_by_edges` comes first.
    """

    method: str
    min_template_iou: float
    """Minimum overlap of a silhouette with the best template; below it the garment is unknown."""
    size_tolerance: float
    """Maximum relative difference of the observed size from a garment's nominal size."""
    flat_height: float
    """Maximum height of a flat garment (95th percentile over the garment)."""
    min_fit: float
    """Minimum quality of a fit (`candidate.fit_quality`)."""
    least_confidence: float
    """A garment is refused if the probability that its key points are accurate is below this. It is low, because
    each fold that is planned with them is inspected."""
    size_known: bool = True
    """Whether lengths in the picture are true. If not, a garment has any size and any shape of its category, and
    its key points are accurate within a share of its diagonal."""
    depth_holes: float = 0.5
    """Maximum share of the picture without depth. The value 1 is for pictures that have no depth."""
