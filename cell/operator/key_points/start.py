"""Where the key points stand before a person moves them, if the perception has found none."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from robots.ports import Array
from skills.garments.garment import Garment
from skills.garments.picture_measure import as_laid
from skills.perception.limb_poses import best_poses
from skills.perception.outline import counter_clockwise, polygon_area
from skills.perception.registration.energy import Boundary
from skills.perception.registration.register import best_starts

__all__ = ["template_over"]


def template_over(outline: Array, like: Garment) -> Mapping[str, Array]:
    """Lay the template of a garment over an outline (n, 2) in pixels, with its limbs turned towards it. Returns
    the places of its key points, name -> (2,) in pixels."""
    laid = as_laid(np.asarray(outline, dtype=float))
    scale = float(np.sqrt(polygon_area(like.template) / abs(polygon_area(laid))))
    contour = scale * counter_clockwise(laid)
    posed = best_poses(contour, [like])[0]
    start = best_starts(np.asarray(posed.template), Boundary(contour, step=0.003, sample_step=0.015))[0]
    return dict(zip(like.keypoints, -start.polygon[:, ::-1] / scale, strict=True))
