"""Finds the garment's silhouette in a picture, without recognising it: after a fold, and before the hands go
down."""

from __future__ import annotations

from skills.perception.segmentation.mask import Segmentation
from skills.perception.segmentation.segment import segmentations
from skills.perception.settings import PerceptionSettings
from skills.perception.usable_region import intrusion, touches_border
from skills.perception.views import Views
from skills.vocabulary import Failure, FailureKind, Outcome

__all__ = ["find_silhouette"]

_MARGIN = 2
"""A garment nearer than this to the border of the view is out of view [px]."""


def find_silhouette(views: Views, settings: PerceptionSettings) -> Outcome[Segmentation]:
    """Segment the garment. The result is that of the first method with sufficient confidence, else that of the
    first method that finds a garment.

    Failures: NO_GARMENT, OUT_OF_VIEW, VIEW_OBSTRUCTED (something flat reaches into the picture, beside the
    garment).
    """
    best: Segmentation | None = None
    out_of_view = False
    for _, found in segmentations(views, settings.method):
        if not found.found:
            continue
        if touches_border(found.mask, views.seen.valid, _MARGIN):
            out_of_view = True
        elif found.confidence >= settings.lowest_segmentation:
            best = found
            break
        else:
            best = best or found
    if best is not None:
        hidden = intrusion(best, views.view, _MARGIN, settings)
        return Outcome(best) if hidden is None else Outcome(failure=hidden)
    if out_of_view:
        what, hint = "the garment reaches beyond the view", "move it to the middle of the table by hand"
        return Outcome(failure=Failure(FailureKind.OUT_OF_VIEW, what, hint))
    what, hint = "the garment is no longer visible on the table", "lay it back as it was"
    return Outcome(failure=Failure(FailureKind.NO_GARMENT, what, hint))
