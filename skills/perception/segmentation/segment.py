"""Which pixels are garment: several methods on the rectified view, one result.

`reference` compares with a picture of the empty table, `plain` with a smooth table fitted to the view's rim;
`grabcut` does not ask the table to be of one colour; `watershed` is the paper's.
"""

from __future__ import annotations

from skills.perception.segmentation.grabcut import segment_grabcut
from skills.perception.segmentation.mask import Field, Image, Mask, Segmentation, SegmentationSettings
from skills.perception.segmentation.reference import segment_plain, segment_reference
from skills.perception.segmentation.watershed import segment_watershed

__all__ = ["METHODS", "methods", "segment"]

METHODS = ("reference", "plain", "grabcut", "watershed")


def methods(method: str, reference: bool) -> tuple[str, ...]:
    """What to try, one after the other. reference: whether there is a picture of the empty table; without one
    'reference' stands for 'plain' and, where that finds nothing usable, 'grabcut'."""
    return ("plain", "grabcut") if method == "reference" and not reference else (method,)


def segment(
    method: str,
    rgb: Image,
    reference: Image | None,
    valid: Mask,
    height: Field,
    settings: SegmentationSettings,
) -> Segmentation:
    """The garment in rgb (H, W, 3), where valid (H, W). reference: the empty table in the same view; without one
    'reference' is 'plain'. height: (H, W) [m] above the table, NaN where unknown. Raises ValueError for a method
    that is none of `METHODS`."""
    if method == "watershed":
        return segment_watershed(rgb, valid, settings)
    if method == "grabcut":
        return segment_grabcut(rgb, valid, settings)
    if method == "plain" or (method == "reference" and reference is None):
        return segment_plain(rgb, valid, height, settings)
    if method == "reference" and reference is not None:
        return segment_reference(rgb, reference, valid, height, settings)
    raise ValueError(f"method {method!r} is none of {', '.join(METHODS)}")
