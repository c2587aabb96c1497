"""Measures how far the garment still reaches beyond the fold line after a fold, at each grasp and between them."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from skills.perception.inspection.result import InspectionSettings
from skills.perception.rectification.table_view import TableView
from skills.vocabulary import FoldStep

__all__ = ["left_behind"]


def left_behind(
    view: TableView,
    mask: NDArray[np.bool_],
    predicted: NDArray[np.bool_],
    step: FoldStep | None,
    settings: InspectionSettings,
) -> Mapping[str, float]:
    """Measure how much further than predicted the garment reaches beyond the fold line [m], on the side from which
    it was folded.

    mask, predicted: (H, W) observed and predicted silhouette. The result's keys are the grasps, and 'middle' for
    the place between two grasps; a value is NaN if too little is visible there. Empty without a step.
    """
    if step is None or not step.grasps:
        return {}
    line = step.line
    places = {str(i): float((g.point - line.point) @ line.direction) for i, g in step.grasps.items()}
    if len(places) == 2:
        places["middle"] = sum(places.values()) / 2
    coordinates = []
    for region in (mask, predicted):
        rows, columns = np.nonzero(region)
        xy = view.to_table(np.stack([columns, rows], axis=1))
        coordinates.append(((xy - line.point) @ line.direction, line.signed_distance(xy)))
    excess = {}
    for name, place in places.items():
        seen, planned = (across[np.abs(along - place) < settings.strip] for along, across in coordinates)
        enough = min(len(seen), len(planned)) > 50
        excess[name] = float(np.quantile(seen, 0.98) - np.quantile(planned, 0.98)) if enough else float("nan")
    return excess
