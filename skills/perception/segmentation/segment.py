"""Segments the garment in the rectified view, by one of several methods.

`reference` compares the view with a picture of the empty table, `plain` with a smooth table colour that is fitted
to the view's rim. `grabcut` also works on a patterned table. `watershed` is the paper's method.
"""

from __future__ import annotations

from collections.abc import Iterator

import cv2
import numpy as np

from skills.perception.segmentation.grabcut import segment_grabcut
from skills.perception.segmentation.mask import Image, Mask, Segmentation, outlined
from skills.perception.segmentation.reference import segment_plain, segment_reference
from skills.perception.views import Views

__all__ = ["segment_watershed", "segmentations"]


def segmentations(views: Views, method: str) -> Iterator[tuple[str, Segmentation]]:
    """Yield the segmentations to try in turn, each with the name of its method.

    method: 'reference', 'plain', 'grabcut' or 'watershed'. Without a picture of the empty table, 'reference' means
    'plain' and, if that fails, 'grabcut'. Raises ValueError for another method.
    """
    rgb, valid = views.seen.rgb, views.seen.valid
    if method == "reference" and views.empty is not None:
        yield method, segment_reference(rgb, views.empty.rgb, valid, views.height)
    elif method in ("reference", "plain"):
        yield "plain", segment_plain(rgb, valid, views.height)
    elif method == "watershed":
        yield method, segment_watershed(rgb, valid)
    elif method != "grabcut":
        raise ValueError(f"method {method!r} is none of reference, plain, grabcut, watershed")
    if method == "grabcut" or (method == "reference" and views.empty is None):
        yield "grabcut", segment_grabcut(rgb, valid)


def segment_watershed(rgb: Image, valid: Mask) -> Segmentation:
    """Segment rgb (H, W, 3) where valid (H, W) by watershed, as in the paper (Vincent and Soille 1991). The four
    corners are assumed to be background, the centre garment."""
    rows, columns = np.nonzero(valid)
    top, bottom, left, right = rows.min(), rows.max(), columns.min(), columns.max()
    radius = max(min(bottom - top, right - left) // 20, 2)
    markers = np.zeros(valid.shape, np.int32)
    for row in (top + radius, bottom - radius):
        inside = np.flatnonzero(valid[row])
        for column in (inside[0] + radius, inside[-1] - radius):
            cv2.circle(markers, (int(column), int(row)), int(radius), 1, -1)
    cv2.circle(markers, (int(left + right) // 2, int(top + bottom) // 2), int(radius), 2, -1)
    markers[~valid] = 1
    labels = cv2.watershed(np.ascontiguousarray(cv2.medianBlur(rgb, 5)), markers)
    return outlined(labels == 2, rgb, valid)
