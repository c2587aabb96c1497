"""Tells whether the ground surrounds a region of a photograph on every side.

Around a print lies cloth, and beside the body of a shirt lie its sleeves: along a stretch of such an outline, the
colours just outside it are found nowhere at the rim of the picture. The ground's are, whatever its pattern.
"""

from __future__ import annotations

import cv2
import numpy as np
from scipy.spatial import cKDTree

from foldcell.robots.ports import Array
from foldcell.skills.perception.outline import outward_normals, smooth_closed
from foldcell.skills.perception.registration.boundary import sample
from foldcell.skills.perception.segmentation.mask import Image, Mask, Segmentation, eroded

MOST_FOREIGN = 0.10
"""A region whose outline is longer than this share without the ground beside it is a part of something."""
_RIM = 0.05
"""Width of the rim of the picture that shows mostly ground, relative to the longer edge."""
_SAMPLES = 3000
"""Number of the rim's colours that are compared."""
_OFFSETS = np.arange(5.0, 17.0, 3.0)
"""Distances outside the outline at which colours are compared [px]. A shadow is narrower than the largest."""
_PLACES = 300
"""Number of places on the outline."""
_WEIGHT = np.array([0.4, 1.0, 1.0])
"""Weight of a difference in lightness (Lab): shadows and uneven light are no other ground."""
_FOREIGN = 8.0
"""A colour that is further than this from those at the rim is not the ground's."""
_ALIKE = 4
"""Number of the rim's colours that a colour of the ground resembles."""
_GAP = 2
"""So many places that look like ground do not interrupt a stretch."""

_BESIDE = np.array([3.0, 4.0, 5.0])
"""Distances from the outline at which both sides are compared in lightness [px]."""
_EVEN = 0.042
"""Largest spread of the step of lightness along the outline of a print [log]."""


def printed_on_ground(rgb: Image, segmentation: Segmentation) -> bool:
    """Whether a region's outline is only a change of colour, of a print on the ground: the step of lightness is
    the same all along. An edge of cloth is lit on one side and shaded on the other. rgb: (H, W, 3)."""
    light = np.log(cv2.cvtColor(rgb, cv2.COLOR_RGB2GRAY).astype(np.float32) + 8.0)
    line = smooth_closed(segmentation.contour, 2.0)
    away = _BESIDE[:, None] * outward_normals(line)[:, None]
    step = (sample(light, line[:, None] - away) - sample(light, line[:, None] + away)).mean(axis=1)
    step = smooth_closed(step[:, None], 3.0)[:, 0]
    return bool(1.48 * np.median(np.abs(step - np.median(step))) < _EVEN)


def foreign_stretch(rgb: Image, valid: Mask, segmentation: Segmentation) -> tuple[float, Array]:
    """Return the longest stretch of a region's outline beside which there is no ground, relative to the whole
    outline, and the middle (2,) of this stretch [px]. rgb: (H, W, 3). valid: (H, W), where the picture shows
    something."""
    lab = cv2.cvtColor(cv2.GaussianBlur(rgb, (0, 0), 1.5), cv2.COLOR_RGB2LAB).astype(np.float32)
    rim = lab[valid & ~eroded(valid, max(round(_RIM * max(valid.shape)), 4))]
    line = smooth_closed(segmentation.contour, 3.0)
    stride = max(len(line) // _PLACES, 1)
    line, normals = line[::stride], outward_normals(line)[::stride]
    places = line[:, None] + _OFFSETS[:, None] * normals[:, None]
    outside = sample((valid & ~segmentation.mask).astype(np.float32), places) > 0.8
    ground = cKDTree(rim[:: max(len(rim) // _SAMPLES, 1)] * _WEIGHT)
    away = ground.query((sample(lab, places) * _WEIGHT).reshape(-1, 3), k=_ALIKE)[0][:, -1].reshape(outside.shape)
    seen = np.count_nonzero(outside, axis=1) >= 2
    median = np.zeros(len(line))
    median[seen] = np.nanmedian(np.where(outside, away, np.nan)[seen], axis=1)
    closing = np.ones((1, _GAP + 1), np.uint8)
    twice = np.tile((median > _FOREIGN).astype(np.uint8), 2)[None]
    stretches = np.flatnonzero(cv2.morphologyEx(twice, cv2.MORPH_CLOSE, closing)[0] == 0)
    if not len(stretches):
        return 1.0, line[0]
    lengths = np.diff(stretches) - 1
    if not len(lengths):
        return 0.0, line[0]
    longest = int(np.argmax(lengths))
    return float(lengths[longest] / len(line)), line[(stretches[longest] + lengths[longest] // 2 + 1) % len(line)]
