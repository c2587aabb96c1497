"""The key points of one garment in its picture while a person edits them, and the findings about them for the
page."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from foldcell.robots.ports import Array
from foldcell.skills.fold_plan.folding import crease_segments
from foldcell.skills.fold_plan.plan import plan_folds
from foldcell.skills.garments.garment import Garment
from foldcell.skills.garments.key_point_check import KeyPointFinding, check_key_points
from foldcell.skills.garments.picture_measure import PictureMeasure, as_laid
from foldcell.skills.perception.family import best_members
from foldcell.skills.perception.outline import counter_clockwise, polygon_area
from foldcell.skills.perception.registration.energy import Boundary
from foldcell.skills.perception.registration.register import best_starts


@dataclass(frozen=True, eq=False)
class KeyPointEdit:
    """The picture and the garment whose key points are edited. rgb: (H, W, 3), the picture. like: a garment with
    the same folds and key points.

    outline: (n, 2) [px] of the region that the perception takes for the garment; None if it found none. start:
    first places of all or some key points, name -> (2,) [px]. about: facts for the page, (name, text).
    """

    title: str
    rgb: NDArray[np.uint8]
    like: Garment
    measure: PictureMeasure
    outline: Array | None
    start: Mapping[str, Array]
    about: tuple[tuple[str, str], ...]

    def shown(self, points: Mapping[str, Array]) -> dict[str, Any]:
        """Return the content of the page for these key points: the findings, the size of the garment [m] and the
        creases of its folds [px]. There are no size and no folds if no garment can be made of the points. points:
        name -> (2,) [px]."""
        findings, folds = self._judged(points)
        possible = not any(finding.refused for finding in findings)
        size = np.ptp(self._template(points), axis=0) if possible else None
        return {"findings": findings, "size_m": size, "folds": folds}

    def _judged(self, points: Mapping[str, Array]) -> tuple[tuple[KeyPointFinding, ...], list[dict[str, Any]]]:
        findings = check_key_points(points, self.like, self.measure, self.outline)
        if any(finding.refused for finding in findings):
            return findings, []
        template = self._template(points)
        garment = replace(self.like, template=template)
        planned = plan_folds(garment.flat_state(0.0, 0.0), garment)
        if planned.failure is not None:
            hint = "correct the key points, or choose another garment with --like"
            return (
                *findings,
                KeyPointFinding((), f"its folds cannot be planned: {planned.failure.what}", hint),
            ), []
        # The template has straight axes and equal halves; an affine map leads from there back into the picture.
        homogeneous = np.column_stack([template, np.ones(len(template))])
        to_picture = np.linalg.lstsq(homogeneous, self._pixels(points), rcond=None)[0]
        creases = [crease_segments(step.lines, template) for step in planned.unwrap()]
        earlier = [0, *map(len, creases)]
        return findings, [
            {"name": step.name, "creases": made[n:] @ to_picture[:2] + to_picture[2]}
            for step, made, n in zip(planned.unwrap(), creases, earlier, strict=False)
        ]

    def _template(self, points: Mapping[str, Array]) -> Array:
        return self.measure.template(self._pixels(points), self.like.template)

    def _pixels(self, points: Mapping[str, Array]) -> Array:
        return np.array([points[name] for name in self.like.keypoints], dtype=float)


def template_over(outline: Array, like: Garment) -> Mapping[str, Array]:
    """Lay the template of a garment over an outline (n, 2) in pixels, with its limbs turned towards it. Returns
    the places of its key points, name -> (2,) in pixels."""
    laid = as_laid(np.asarray(outline, dtype=float))
    scale = float(np.sqrt(polygon_area(like.template) / abs(polygon_area(laid))))
    contour = scale * counter_clockwise(laid)
    posed = best_members(contour, [like])[0]
    start = best_starts(np.asarray(posed.template), Boundary(contour, step=0.003, sample_step=0.015))[0]
    return dict(zip(like.keypoints, -start.polygon[:, ::-1] / scale, strict=True))
