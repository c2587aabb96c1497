"""Judges whether a segmented region can be a garment that lies alone, flat and wholly in view."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from foldcell.skills.perception.rectification.heights import smooth_height, upper
from foldcell.skills.perception.rectification.table_view import RectifiedView, TableView
from foldcell.skills.perception.segmentation.mask import Segmentation, eroded
from foldcell.skills.perception.segmentation.obstruction import obstruction_failure
from foldcell.skills.perception.segmentation.photograph import skin
from foldcell.skills.perception.segmentation.surroundings import MOST_FOREIGN, foreign_stretch
from foldcell.skills.perception.settings import LITTER_SHARE, MIN_SEGMENTATION, VIEW_BORDER, PerceptionSettings
from foldcell.skills.vocabulary import Failure, FailureKind

INTRUDER_SHARE = 0.02
"""Maximum area of objects that reach into the picture from its edge, relative to the area of the garment."""
RIVAL_SHARE = 0.5
"""Maximum area of other objects in a photograph of an unknown place, where other things lie, too."""

LEAST_SHARE, LEAST_CUT = 0.03, 0.10
"""Least area of a garment in a photograph, and of one that the edge of the picture cuts off, relative to the
picture. Smaller things at the edge are other things."""
LEAST_RECTANGLE = 0.10
"""Least area of a rectangle that is taken for a towel in a photograph of unknown scale without a name, relative to
the picture."""
MOST_EDGE = 0.35
"""More than this share of the outline of a part of the ground runs along the edge of the picture. A garment in a
corner of the picture has as much, too."""
LEAST_SIDE = 0.1
"""A side of the picture is met if at least this share of the outline's points at the edge lies nearest to it."""
SLENDER = 15.0
"""Least ratio of an arm's area to the square of the radius of the largest circle in it; garments have 3 to 11."""


def unusable(
    segmentation: Segmentation,
    seen: RectifiedView,
    view: TableView,
    height: NDArray[np.float32],
    settings: PerceptionSettings,
    referenced: bool,
    proposed: bool,
) -> Failure | None:
    """Return the reason why a region cannot be the garment, else None. height: (H, W) above the table [m].
    referenced: whether there is a picture of the empty table. proposed: whether the region looks like a garment by
    its outline (`segmentation.photograph`)."""
    if not segmentation.found:
        return Failure(
            FailureKind.NO_GARMENT, "no garment is visible on the table", "lay one flat in the camera's view"
        )
    margin = max(round(VIEW_BORDER / view.pixel), 1)
    if settings.size_known and (failure := intrusion(segmentation, view, margin)) is not None:
        return failure
    if not settings.size_known and (failure := nothing_whole(segmentation, seen, margin, proposed)) is not None:
        return failure
    if segmentation.others_share > (LITTER_SHARE if settings.size_known else RIVAL_SHARE):
        return Failure(
            FailureKind.UNKNOWN_GARMENT,
            "more than one thing lies on the table",
            "leave a single garment on the table",
            {"other_area_share": segmentation.others_share},
        )
    if segmentation.confidence < MIN_SEGMENTATION:
        return Failure(
            FailureKind.LOW_CONFIDENCE,
            f"only {segmentation.confidence:.0%} of the garment's boundary is clearly visible",
            "the fabric has the table's colour, or the light changed: take a new picture of the empty table"
            if referenced
            else "use a table of another colour, or more even light",
            {"segmentation_confidence": segmentation.confidence},
        )
    if touches_border(segmentation.mask, view.valid, margin):
        return Failure(
            FailureKind.OUT_OF_VIEW,
            "the garment extends beyond the camera's view or the table's edge",
            "lay it nearer to the middle of the table",
        )
    smooth = smooth_height(height)
    top = upper(smooth[segmentation.mask & np.isfinite(smooth)])
    if top > settings.flat_height:
        return Failure(
            FailureKind.NOT_FLAT,
            f"the garment reaches {top * 1e3:.0f} mm above the table",
            "spread it flat",
            {"height_m": top},
        )
    return None


def nothing_whole(segmentation: Segmentation, seen: RectifiedView, margin: int, proposed: bool) -> Failure | None:
    """Return NO_GARMENT if a region of a photograph is a thing at its edge or a part of the ground,
    VIEW_OBSTRUCTED if it is a hand or an arm that reaches in, OUT_OF_VIEW if the edge cuts off a garment, else
    None. margin: the region reaches the edge if it comes this near [px]. proposed: see `unusable`."""
    share = float(np.count_nonzero(segmentation.mask) / np.count_nonzero(seen.valid))
    columns, rows = np.clip(np.round(segmentation.contour), 0, np.array(seen.valid.shape[::-1]) - 1).astype(int).T
    at_edge = ~eroded(seen.valid, margin)[rows, columns]
    cut = float(at_edge.mean())
    values = {"area_share": share, "edge_share": cut}
    if not at_edge.any() and share >= LEAST_SHARE and segmentation.confidence >= MIN_SEGMENTATION:
        return None
    side, corner = _met(columns[at_edge], rows[at_edge], seen.valid.shape)
    if side and proposed and segmentation.confidence >= MIN_SEGMENTATION and (corner or cut <= MOST_EDGE):
        if _is_arm(segmentation.mask, seen):
            return Failure(
                FailureKind.VIEW_OBSTRUCTED,
                f"a hand or an arm reaches into the picture from its {side} edge",
                "keep it out, and take the picture again",
                values,
            )
        if share >= LEAST_CUT:
            return Failure(
                FailureKind.OUT_OF_VIEW,
                f"the {side} edge of the picture cuts the garment off",
                "take the picture from further away, or move the garment to its middle",
                values,
            )
    return Failure(
        FailureKind.NO_GARMENT,
        "no garment is visible: nothing that lies wholly in the picture stands out from the ground",
        "lay a garment flat in the middle of the picture, on a ground of another colour",
        values,
    )


def _met(columns: NDArray[np.int_], rows: NDArray[np.int_], shape: tuple[int, ...]) -> tuple[str, bool]:
    """Return the side of the picture (height, width) that most points of its edge lie at, and whether they lie at
    two neighbouring sides and no others. Without points, the side is empty."""
    away = {"left": columns, "right": shape[1] - 1 - columns, "upper": rows, "lower": shape[0] - 1 - rows}
    nearest = np.argmin(list(away.values()), axis=0)
    counts = {name: np.count_nonzero(nearest == k) for k, name in enumerate(away)}
    met = {name for name, count in counts.items() if count and count >= LEAST_SIDE * len(nearest)}
    corner = len(met) == 2 and met not in ({"left", "right"}, {"upper", "lower"})
    return max(met, key=counts.__getitem__, default=""), corner


def _is_arm(mask: NDArray[np.bool_], seen: RectifiedView) -> bool:
    """Whether a region is slender and has the colour of skin, unlike the ground beside it."""
    around = cv2.dilate(mask.astype(np.uint8), np.ones((25, 25), np.uint8)) > 0
    coloured = skin(seen.rgb)
    padded = np.pad(mask.astype(np.uint8), 1, mode="edge")
    radius = float(cv2.distanceTransform(padded, cv2.DIST_L2, 5).max())
    beside = coloured[around & ~mask & seen.valid]
    like_skin = coloured[mask].mean() > 0.6 and (not len(beside) or beside.mean() < 0.4)
    return bool(like_skin and np.count_nonzero(mask) > SLENDER * radius**2)


def adjoined(segmentation: Segmentation, seen: RectifiedView, view: TableView) -> Failure | None:
    """Return UNKNOWN_GARMENT if something else than the ground lies beside a stretch of a region's outline, else
    None: the region is a part of a garment, such as a print."""
    share, (column, row) = foreign_stretch(seen.rgb, seen.valid, segmentation)
    if share <= MOST_FOREIGN:
        return None
    middle = segmentation.contour.mean(axis=0)
    away = {
        "right": column - middle[0],
        "left": middle[0] - column,
        "lower": row - middle[1],
        "upper": middle[1] - row,
    }
    side = max(away, key=lambda name: away[name])
    return Failure(
        FailureKind.UNKNOWN_GARMENT,
        f"something else than the ground lies beside {share:.0%} of the outline, on its {side} side: it may be a "
        "print or a part of the garment",
        "lay the garment on a ground of another colour, with nothing beside it",
        {"foreign_share": share},
    )


def small_rectangle(corners: int, segmentation: Segmentation, seen: RectifiedView) -> Failure | None:
    """Return UNKNOWN_GARMENT for a small rectangle in a photograph of unknown scale without a name, else None:
    prints and sheets of paper are such. corners: number of key points."""
    share = float(np.count_nonzero(segmentation.mask) / np.count_nonzero(seen.valid))
    if corners != 4 or share >= LEAST_RECTANGLE:
        return None
    return Failure(
        FailureKind.UNKNOWN_GARMENT,
        f"a rectangle on {share:.0%} of the picture may be a print, or a sheet of paper",
        "name the garment, or take the picture from nearer",
        {"area_share": share},
    )


def intrusion(segmentation: Segmentation, view: TableView, margin: int) -> Failure | None:
    """Return VIEW_OBSTRUCTED if something flat beside the garment reaches into the picture, to within `margin`
    pixels of the border, else None."""
    share = segmentation.others_share
    if share <= INTRUDER_SHARE or not touches_border(segmentation.others, view.valid, margin):
        return None
    return obstruction_failure(view, segmentation.others, "something flat", {"other_area_share": share})


def touches_border(mask: NDArray[np.bool_], valid: NDArray[np.bool_], margin: int) -> bool:
    """Whether a region comes within `margin` pixels of the border of the valid view."""
    return bool((mask & ~eroded(valid, margin)).any())
