"""Segments the garment in the rectified view, by one of several methods.

`reference` compares the view with a picture of the empty table, `plain` with a smooth table colour that is fitted
to the view's rim. `grabcut` also works on a patterned table. `watershed` is the paper's method.
"""

from __future__ import annotations

from skills.perception.segmentation.grabcut import segment_grabcut
from skills.perception.segmentation.mask import Field, Image, Mask, Segmentation, SegmentationSettings
from skills.perception.segmentation.reference import segment_plain, segment_reference
from skills.perception.segmentation.watershed import segment_watershed

__all__ = ["METHODS", "methods", "segment"]

METHODS = ("reference", "plain", "grabcut", "watershed")


def methods(method: str, reference: bool) -> tuple[str, ...]:
    """Return the methods to try in turn. reference: whether there is a picture of the empty table. Without one,
    'reference' means 'plain' and, if that fails, 'grabcut'."""
    return ("plain", "grabcut") if method == "reference" and not reference else (method,)


def segment(
    method: str,
    rgb: Image,
    reference: Image | None,
    valid: Mask,
    height: Field,
    settings: SegmentationSettings,
) -> Segmentation:
    """Segment the garment in rgb (H, W, 3) where valid (H, W).

    reference: picture of the empty table in the same view; without one, 'reference' means 'plain'. height: (H, W)
    above the table [m], NaN where unknown. Raises ValueError for a method that is not in `METHODS`.
    """
    if method == "watershed":
        return segment_watershed(rgb, valid, settings)
    if method == "grabcut":
        return segment_grabcut(rgb, valid, settings)
    if method == "plain" or (method == "reference" and reference is None):
        return segment_plain(rgb, valid, height, settings)
    if method == "reference" and reference is not None:
        return segment_reference(rgb, reference, valid, height, settings)
    raise ValueError(f"method {method!r} is none of {', '.join(METHODS)}")
