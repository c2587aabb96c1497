"""Outlines of a fold as an SVG drawing, seen from above, with a scale bar."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from markupsafe import Markup

from foldcell.robots.ports import Array

RULER = 14
"""Height of the scale bar under a drawing [px]."""


def outline_drawing(layers: Mapping[str, Sequence[Array]], width: int = 420) -> Markup | None:
    """Draw outlines as SVG, seen from above. Up is away from the robot. layers: name (and class in the drawing) ->
    contours (k, 2) [m]; width [px]. None if there are no contours."""
    points = [np.asarray(c, dtype=float) for outlines in layers.values() for c in outlines if len(c)]
    if not points:
        return None
    corners = np.vstack(points)
    low, high = corners.min(axis=0) - 0.03, corners.max(axis=0) + 0.03
    scale = min(width / (high[1] - low[1]), 0.62 * width / (high[0] - low[0]))
    width, height = round((high[1] - low[1]) * scale), (high[0] - low[0]) * scale
    paths = [
        f'<path class="{name}" d="{" ".join(_path(np.asarray(c), low, high, scale) for c in outlines)}"/>'
        for name, outlines in layers.items() if len(outlines)
    ]  # fmt: skip
    bar = 0.1 * scale
    height += RULER  # the scale bar is below all outlines
    ruler = (
        f'<path class="ruler" d="M8 {height - 8:.1f} v-5 m0 2.5 h{bar:.1f} m0 -2.5 v5"/>'
        f'<text x="{12 + bar:.1f}" y="{height - 7:.1f}">100 mm</text>'
    )
    text = (
        f'<svg viewBox="0 0 {width} {height:.1f}" role="img" style="max-width: {width}px" '
        f'aria-label="outlines of the target, the prediction and the observation">{"".join(paths)}{ruler}</svg>'
    )
    return Markup(text)


def _path(contour: Array, low: Array, high: Array, scale: float) -> str:
    """Return the SVG path of a closed contour (k, 2). In the drawing, table x points up and table y to the
    left."""
    u, v = (high[1] - contour[:, 1]) * scale, (high[0] - contour[:, 0]) * scale
    return "M" + " L".join(f"{a:.1f} {b:.1f}" for a, b in zip(u, v, strict=True)) + " Z"
