"""Segments the garment in an opened picture by one of several methods. After a fold, and before the hands go down,
it finds the garment's silhouette without recognising it.

`reference` compares the picture with that of the empty table, `plain` with a smooth table colour that is fitted to
the view's rim. `grabcut` also works on a patterned table.
"""

from __future__ import annotations

from collections.abc import Iterator

from foldcell.skills.perception.segmentation.grabcut import segment_grabcut
from foldcell.skills.perception.segmentation.mask import Segmentation
from foldcell.skills.perception.segmentation.reference import segment_plain, segment_reference
from foldcell.skills.perception.settings import MIN_SEGMENTATION, PerceptionSettings
from foldcell.skills.perception.usable_region import intrusion, touches_border
from foldcell.skills.perception.views import Views
from foldcell.skills.vocabulary import Failure, FailureKind, Outcome

_MARGIN = 2
"""A garment nearer than this to the border of the view is out of view [px]."""


def segmentations(views: Views, method: str) -> Iterator[tuple[str, Segmentation]]:
    """Yield the segmentations to try in turn, each with the name of its method.

    method: 'reference', 'plain' or 'grabcut'. Without a picture of the empty table, 'reference' means 'plain' and,
    if that fails, 'grabcut'. Raises ValueError for another method.
    """
    rgb, valid = views.seen.rgb, views.seen.valid
    if method == "reference" and views.empty is not None:
        yield method, segment_reference(rgb, views.empty.rgb, valid, views.height)
    elif method in ("reference", "plain"):
        yield "plain", segment_plain(rgb, valid, views.height)
    elif method != "grabcut":
        raise ValueError(f"method {method!r} is none of reference, plain, grabcut")
    if method == "grabcut" or (method == "reference" and views.empty is None):
        yield "grabcut", segment_grabcut(rgb, valid)


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
        elif found.confidence >= MIN_SEGMENTATION:
            best = found
            break
        else:
            best = best or found
    if best is not None:
        hidden = intrusion(best, views.view, _MARGIN)
        return Outcome(best) if hidden is None else Outcome(failure=hidden)
    if out_of_view:
        what, hint = "the garment reaches beyond the view", "move it to the middle of the table by hand"
        return Outcome(failure=Failure(FailureKind.OUT_OF_VIEW, what, hint))
    what, hint = "the garment is no longer visible on the table", "lay it back as it was"
    return Outcome(failure=Failure(FailureKind.NO_GARMENT, what, hint))
