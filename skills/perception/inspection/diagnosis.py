"""Diagnoses a fold: maps the figures of an inspection to the paper's failure kinds."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from foldcell.skills.perception.inspection.moved_edge import MovedEdge
from foldcell.skills.perception.inspection.result import MAX_PILED_AREA, Inspection, InspectionSettings
from foldcell.skills.vocabulary import Array, FailureKind, FoldStep

CORNER_RADIUS = 0.07
"""If a deviation of the outline is nearer than this to a corner of the target, it counts as a deviation of this
corner [m]."""
MAX_LEFT_BEHIND = 0.035
"""Limit of `Inspection.left_behind` if the outline is not as predicted. If all values are larger, a layer was
missed. If the values at the two grasps differ by more, one corner was dropped."""
MAX_SAG = 0.020
"""If the garment is left behind in the middle further than at both grasps, by more than this, the cloth
between the hands sagged."""
MAX_MISSING = 0.45
"""Maximum missing share of the predicted height at a target."""
EDGE_SAG = 0.026
EDGE_CORNER = 0.0195
"""Limits for an edge that was moved onto other cloth (`moved_edge`): `EDGE_SAG` for the lag of its middle,
`EDGE_CORNER` for the lag of a corner.

The lag of a corner is measured in steps of 2 mm, or of 1 mm if a strip is not visible; the limit lies between
two steps. A corner that is 40 mm behind is measured as 20 to 40 mm. In still pictures, good folds lag by up to
15 mm, nearly all by less than 8 mm."""
SHORT_NOISE, COVERED = 2.0, 0.25
"""Strips of a short edge, whose lag has more than `SHORT_NOISE` times the usual noise, can seem to lie 58 mm
behind on cloth that was loose before. A corner of such an edge is in its place if no target lacks more than
the share `COVERED` of its height: good cuffs lack up to 0.18, and half would be missing without the sleeve."""
THIN_RISE = 0.0022
MAX_LAG_THIN = 0.030
"""Both limits grow in inverse proportion to the rise if the layers raise the surface by less than `THIN_RISE`,
because wrinkles of a millimetre then hide the edge. If the edge is too short for wide strips, the limits also grow
in proportion to the noise of its strips, up to `MAX_LAG_THIN`."""
MOST_DOUBT = 0.010
"""Most that the standard error of a sag adds to its limit [m]: an edge that is more uneven does not lie well. For
thin layers and short edges, whose strips are themselves uncertain, it grows as the limits do. Four hems of shirts,
all good, seemed to sag by 40 to 50 mm, with strips that lay in turn 4 mm before and 50 mm behind their place."""

LASTING_DEVIATION = 0.025
"""Largest distance between the observed and the predicted outline of a fold that is followed by another [m]: the
30 mm that the score allows between edges, less 5 mm by which edges lay further apart at the end of a run than the
outline of the earlier fold had shown."""


def diagnose(
    seen: Inspection, step: FoldStep | None, settings: InspectionSettings
) -> tuple[FailureKind | None, float]:
    """Return the failure kind, or None if the fold is as predicted, and the confidence of this diagnosis. The
    confidence (0..1) grows with the distance of the deciding figure from its limit."""
    outline_ok = outline_matches(seen, settings)
    corner_lag = _corner_lag(seen)
    min_left_behind = _min_left_behind(seen)
    if not outline_ok and min_left_behind > MAX_LEFT_BEHIND:
        return FailureKind.MISSED_LAYER, _confidence(min_left_behind, MAX_LEFT_BEHIND)
    # Cloth that a dropped corner leaves behind is also piled up, so the corner is tested before the piling.
    if not outline_ok and corner_lag > MAX_LEFT_BEHIND:
        return FailureKind.DROPPED_CORNER, _confidence(corner_lag, MAX_LEFT_BEHIND)
    if seen.piled_area_m2 > MAX_PILED_AREA:
        return FailureKind.PILING, _confidence(seen.piled_area_m2, MAX_PILED_AREA)
    if (defect := _moved_edge_defect(seen)) is not None:
        return defect
    if not outline_ok:
        kind = _outline_defect(seen, step)
        excess = abs(seen.edge_deviation_m) / settings.deviation
        return kind, _confidence(max(excess, (1 - seen.iou_aligned) / (1 - settings.iou)), 1.0)
    # Loose layers can be lower or higher than predicted. Height is therefore used only if a part of the moved edge
    # is not visible, so that the edge itself cannot be judged.
    if not _edge_visible(seen) and seen.missing_layer > MAX_MISSING:
        return FailureKind.DROPPED_CORNER, 0.5 * _confidence(seen.missing_layer, MAX_MISSING) + 0.2
    if seen.drift_m > settings.drift or abs(seen.drift_rad) > settings.drift_angle:
        ratio = max(seen.drift_m / settings.drift, abs(seen.drift_rad) / settings.drift_angle)
        return FailureKind.DRIFT, _confidence(ratio, 1.0)
    worst = max(
        (1 - seen.iou_aligned) / (1 - settings.iou),
        seen.drift_m / settings.drift,
        abs(seen.edge_deviation_m) / settings.deviation,
    )
    return None, float(np.clip(1.0 - 0.5 * worst, 0.5, 1.0))


def lasting_defect(seen: Inspection, step: FoldStep | None, settings: InspectionSettings) -> FailureKind | None:
    """Return what is wrong with the shape of a fold that is followed by another, if the finished garment would
    fail by it and the last look cannot show it; None if there is nothing.

    Heights and the place of the garment are left out. The last look shows both, because heaped-up cloth raises
    the whole stack and a drift moves it. The limit for the outline is `LASTING_DEVIATION`.
    """
    shape = replace(seen, piled_area_m2=0.0, drift_m=0.0, drift_rad=0.0)
    return diagnose(shape, step, replace(settings, deviation=max(settings.deviation, LASTING_DEVIATION)))[0]


def outline_matches(seen: Inspection, settings: InspectionSettings) -> bool:
    """Whether the silhouette is as predicted: overlap and boundary deviation are within their limits."""
    return seen.iou_aligned >= settings.iou and abs(seen.edge_deviation_m) <= settings.deviation


def diagnosed_by_height(seen: Inspection, settings: InspectionSettings) -> bool:
    """Whether the diagnosis is based on height: piled cloth although the overlap is good, or a moved edge that
    lags although the outline matches.

    The moved edge is located by the height of one layer. Cloth that stands high can hide this step, so such a
    diagnosis can be wrong. A fold of another shape is not mended by pressing its pile.
    """
    if seen.diagnosis is FailureKind.PILING:
        return seen.iou_aligned >= settings.iou
    return seen.diagnosis in {FailureKind.SAG, FailureKind.DROPPED_CORNER} and outline_matches(seen, settings)


def beyond_limits(seen: Inspection, settings: InspectionSettings) -> tuple[str, ...]:
    """Describe the figures that are beyond their limits, one text each, for the operator."""
    outline_ok = outline_matches(seen, settings)
    behind = (np.nan, np.nan) if outline_ok else (_corner_lag(seen), _min_left_behind(seen))
    edge = (np.nan, np.nan) if seen.edge is None else (edge_corner(seen), seen.edge.sag)
    limits = (np.nan, np.nan) if seen.edge is None else _edge_limits(seen.edge)
    lengths = (
        ("one corner lies {} behind the other", behind[0], MAX_LEFT_BEHIND),
        ("all of the edge lies {} behind", behind[1], MAX_LEFT_BEHIND),
        ("a corner of the moved edge lies {} behind the rest of it", edge[0], limits[0]),
        ("the middle of the moved edge lies {} behind its ends", edge[1], limits[1]),
        ("the outline is {} off", abs(seen.edge_deviation_m), settings.deviation),
        ("it lies {} off as a whole", seen.drift_m, settings.drift),
    )
    beyond = [(text, value, limit) for text, value, limit in lengths if value > limit]
    texts = [f"{text.format(_mm(value))} (at most {_mm(limit)})" for text, value, limit in beyond]
    if seen.piled_area_m2 > MAX_PILED_AREA:
        area, most = (f"{1e4 * a:.0f} cm2" for a in (seen.piled_area_m2, MAX_PILED_AREA))
        texts.insert(0, f"{area} are more than {_mm(settings.extra_height)} too high (at most {most})")
    if seen.iou_aligned < settings.iou:
        texts.insert(0, f"overlap {seen.iou_aligned:.2f} (at least {settings.iou:.2f})")
    if abs(seen.drift_rad) > settings.drift_angle:
        turned, most = (f"{np.rad2deg(a):.0f}" for a in (abs(seen.drift_rad), settings.drift_angle))
        texts.append(f"turned by {turned} degrees (at most {most})")
    if not _edge_visible(seen) and seen.missing_layer > MAX_MISSING:
        share, most = (f"{100 * a:.0f} %" for a in (seen.missing_layer, MAX_MISSING))
        texts.append(f"a target lacks {share} of its upper layer's height (at most {most})")
    return tuple(texts)


def corners_in_place(seen: Inspection) -> bool:
    """Whether all of the moved edge is visible, and neither of its corners lags."""
    return seen.edge is not None and seen.edge.wholly_seen and seen.edge.corner <= _edge_limits(seen.edge)[0]


def _mm(length: float) -> str:
    return f"{1e3 * length:.3g} mm"


def _moved_edge_defect(seen: Inspection) -> tuple[FailureKind, float] | None:
    """Return the larger defect of the edge that was moved onto other cloth (a dropped corner or a sag) with its
    confidence; None if both are within their limits."""
    if seen.edge is None:
        return None
    corner_limit, sag_limit = _edge_limits(seen.edge)
    corner, sag = edge_corner(seen) / corner_limit, seen.edge.sag / sag_limit
    worst = float(np.fmax(corner, sag))
    if not worst > 1.0:  # also true if both are NaN, not visible
        return None
    return FailureKind.SAG if sag == worst else FailureKind.DROPPED_CORNER, _confidence(worst, 1.0)


def edge_corner(seen: Inspection) -> float:
    """Lag of the worse corner of the moved edge [m]; NaN if it is unknown, or if only a short edge shows it."""
    if seen.edge is None or (seen.edge.noise > SHORT_NOISE and seen.missing_layer <= COVERED):
        return float("nan")
    return seen.edge.corner


def _edge_limits(edge: MovedEdge) -> tuple[float, float]:
    """Limits for the lag of a corner and of the middle of this edge [m]: thin layers and short edges are measured
    less exactly, and a sag only counts if it exceeds its limit by more than its error, `_sag_doubt`."""
    corner, sag = (min(limit * _uncertainty(edge), MAX_LAG_THIN) for limit in (EDGE_CORNER, EDGE_SAG))
    return corner, sag + _sag_doubt(edge)


def _uncertainty(edge: MovedEdge) -> float:
    """How much less exactly than others the strips of a thin or short edge are measured, from 1 on."""
    return edge.noise * max(1.0, THIN_RISE / max(edge.rise, 1e-6))


def _sag_doubt(edge: MovedEdge) -> float:
    """Standard error of the sag [m], as far as it counts."""
    return min(edge.sag_error, MOST_DOUBT * _uncertainty(edge))


def _edge_visible(seen: Inspection) -> bool:
    """Whether the edge can be judged: all of it is seen, and its sag is not within its error of the limit."""
    edge = seen.edge
    return edge is not None and edge.wholly_seen and not edge.sag > _edge_limits(edge)[1] - _sag_doubt(edge)


def _confidence(value: float, threshold: float) -> float:
    """Confidence that a value is beyond its threshold: 1/2 at the threshold, 1 from twice the threshold on."""
    return float(np.clip(0.5 * value / threshold, 0.0, 1.0))


def _corner_lag(seen: Inspection) -> float:
    """Difference of `Inspection.left_behind` between the two grasps [m]; NaN for a fold with one arm, or if too
    little is visible at one grasp."""
    at_grasps = _at_grasps(seen)
    return float(np.ptp(at_grasps)) if len(at_grasps) == 2 else float("nan")


def _min_left_behind(seen: Inspection) -> float:
    """Smallest known value of `Inspection.left_behind` [m]; NaN if it is unknown at any grasp. The value in the
    middle may be unknown."""
    at_grasps = _at_grasps(seen)
    if not len(at_grasps) or np.isnan(at_grasps).any():
        return float("nan")
    return float(np.fmin(at_grasps.min(), seen.left_behind.get("middle", np.nan)))


def _at_grasps(seen: Inspection) -> Array:
    """`Inspection.left_behind` at each grasp [m]; NaN where too little is visible."""
    return np.array([reach for name, reach in seen.left_behind.items() if name != "middle"])


def _outline_defect(seen: Inspection, step: FoldStep | None) -> FailureKind:
    """Name the defect of an outline that deviates from the prediction.

    SAG if the garment is left behind further in the middle than at both grasps. Otherwise the place of the largest
    deviation decides: DROPPED_CORNER if it is near a target, SAG if it is between the two targets, OFF_TARGET
    elsewhere.
    """
    if step is None or not step.targets:
        return FailureKind.OFF_TARGET
    if "middle" in seen.left_behind and seen.left_behind["middle"] - _at_grasps(seen).max() > MAX_SAG:
        return FailureKind.SAG
    targets = np.array([t[:2] for t in step.targets.values()])
    near = float(np.linalg.norm(targets - seen.edge_place, axis=1).min())
    if near <= CORNER_RADIUS:
        return FailureKind.DROPPED_CORNER
    if len(targets) == 2:
        a, b = targets
        span = b - a
        share = float((seen.edge_place - a) @ span / max(float(span @ span), 1e-9))
        off = float(np.linalg.norm(a + np.clip(share, 0, 1) * span - seen.edge_place))
        if 0.15 < share < 0.85 and off < 2.0 * CORNER_RADIUS:
            return FailureKind.SAG
    return FailureKind.OFF_TARGET
