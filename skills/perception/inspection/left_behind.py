"""What stayed behind the fold line: how far the garment still reaches there, at each hand and between them."""

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
    """How much further than predicted the garment reaches beyond the fold line, in strips across it [m]."""
    if step is None or not step.grasps:
        return {}
    line = step.line
    places = {str(i): float((g.point - line.point) @ line.direction) for i, g in step.grasps.items()}
    if len(places) == 2:
        places["middle"] = sum(places.values()) / 2
    reach = []
    for region in (mask, predicted):
        rows, columns = np.nonzero(region)
        xy = view.to_table(np.stack([columns, rows], axis=1))
        reach.append(((xy - line.point) @ line.direction, line.signed_distance(xy)))
    out = {}
    for name, place in places.items():
        seen, planned = (across[np.abs(along - place) < settings.strip] for along, across in reach)
        enough = min(len(seen), len(planned)) > 50
        out[name] = float(np.quantile(seen, 0.98) - np.quantile(planned, 0.98)) if enough else float("nan")
    return out
