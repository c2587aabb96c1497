"""From the figures of an inspection to the paper's failure kinds."""

from __future__ import annotations

import numpy as np

from skills.perception.inspection.result import Inspection, InspectionSettings
from skills.vocabulary import FailureKind, FoldStep

__all__ = ["beyond_limits", "diagnose", "outline_good", "told_by_height"]


def diagnose(
    seen: Inspection, step: FoldStep | None, settings: InspectionSettings
) -> tuple[FailureKind | None, float]:
    """What went wrong, if anything, and how sure that is (0..1: how far beyond its threshold it lies)."""
    shape_good = outline_good(seen, settings)
    lag = _lag(seen)
    least = _least_left(seen)
    if not shape_good and least > settings.left_behind:
        return FailureKind.MISSED_LAYER, _surety(least, settings.left_behind)
    # Cloth that a dropped corner leaves behind also stands up in folds: the corner is named first.
    if not shape_good and lag > settings.left_behind:
        return FailureKind.DROPPED_CORNER, _surety(lag, settings.left_behind)
    if seen.piled_area_m2 > settings.piled_area:
        return FailureKind.PILING, _surety(seen.piled_area_m2, settings.piled_area)
    if (defect := _edge_on_cloth(seen, settings)) is not None:
        return defect
    if not shape_good:
        kind = _edge_defect(seen, step, settings)
        excess = abs(seen.edge_deviation_m) / settings.deviation
        return kind, _surety(max(excess, (1 - seen.iou_aligned) / (1 - settings.iou)), 1.0)
    # Loose layers lie lower or higher than predicted: heights count only where not all of the edge can be seen.
    if not _edge_seen(seen) and seen.missing_layer > settings.missing_share:
        return FailureKind.DROPPED_CORNER, 0.5 * _surety(seen.missing_layer, settings.missing_share) + 0.2
    if seen.drift_m > settings.drift or abs(seen.drift_rad) > settings.drift_angle:
        ratio = max(seen.drift_m / settings.drift, abs(seen.drift_rad) / settings.drift_angle)
        return FailureKind.DRIFT, _surety(ratio, 1.0)
    worst = max(
        (1 - seen.iou_aligned) / (1 - settings.iou),
        seen.drift_m / settings.drift,
        abs(seen.edge_deviation_m) / settings.deviation,
    )
    return None, float(np.clip(1.0 - 0.5 * worst, 0.5, 1.0))


def outline_good(seen: Inspection, settings: InspectionSettings) -> bool:
    """Whether the silhouette is as predicted."""
    return seen.iou_aligned >= settings.iou and abs(seen.edge_deviation_m) <= settings.deviation


def told_by_height(seen: Inspection, settings: InspectionSettings) -> bool:
    """Whether heights speak against the fold: cloth is heaped up, or, its outline being good, the moved edge lies
    behind. That is looked for where the surface rose by one layer, which cloth that stands up hides."""
    if seen.diagnosis is FailureKind.PILING:
        return True
    return seen.diagnosis in {FailureKind.SAG, FailureKind.DROPPED_CORNER} and outline_good(seen, settings)


def beyond_limits(seen: Inspection, settings: InspectionSettings) -> tuple[str, ...]:
    """The figures that are not as predicted, each with its limit, for people."""
    shape_good = outline_good(seen, settings)
    behind = (np.nan, np.nan) if shape_good else (_lag(seen), _least_left(seen))
    edge = (np.nan, np.nan) if seen.edge is None else (seen.edge.corner, seen.edge.sag)
    lengths = (
        ("one corner lies {} behind the other", behind[0], settings.left_behind),
        ("all of the edge lies {} behind", behind[1], settings.left_behind),
        ("a corner of the moved edge lies {} behind the rest of it", edge[0], settings.edge_corner),
        ("the middle of the moved edge lies {} behind its ends", edge[1], settings.edge_sag),
        ("the outline is {} off", abs(seen.edge_deviation_m), settings.deviation),
        ("it lies {} off as a whole", seen.drift_m, settings.drift),
    )
    beyond = [(what, value, limit) for what, value, limit in lengths if value > limit]
    found = [f"{what.format(_mm(value))} (at most {_mm(limit)})" for what, value, limit in beyond]
    if seen.piled_area_m2 > settings.piled_area:
        area, most = (f"{1e4 * a:.0f} cm2" for a in (seen.piled_area_m2, settings.piled_area))
        found.insert(0, f"{area} stand more than {_mm(settings.extra_height)} too high (at most {most})")
    if seen.iou_aligned < settings.iou:
        found.insert(0, f"overlap {seen.iou_aligned:.2f} (at least {settings.iou:.2f})")
    if abs(seen.drift_rad) > settings.drift_angle:
        turned, most = (f"{np.rad2deg(a):.0f}" for a in (abs(seen.drift_rad), settings.drift_angle))
        found.append(f"turned by {turned} degrees (at most {most})")
    if not _edge_seen(seen) and seen.missing_layer > settings.missing_share:
        share, most = (f"{100 * a:.0f} %" for a in (seen.missing_layer, settings.missing_share))
        found.append(f"a target lacks {share} of its upper layer's height (at most {most})")
    return tuple(found)


def _mm(length: float) -> str:
    return f"{1e3 * length:.3g} mm"


def _edge_on_cloth(seen: Inspection, settings: InspectionSettings) -> tuple[FailureKind, float] | None:
    """What is wrong with the moved edge where it lies on other cloth, the larger defect first."""
    if seen.edge is None:
        return None
    corner, sag = seen.edge.corner / settings.edge_corner, seen.edge.sag / settings.edge_sag
    if not max(corner, sag) > 1.0:  # also when nobody can see either
        return None
    kind = FailureKind.DROPPED_CORNER if corner > sag else FailureKind.SAG
    return kind, _surety(max(corner, sag), 1.0)


def _edge_seen(seen: Inspection) -> bool:
    return seen.edge is not None and seen.edge.wholly_seen


def _surety(value: float, threshold: float) -> float:
    """1/2 at the threshold, towards 1 at twice of it."""
    return float(np.clip(0.5 * value / threshold, 0.0, 1.0))


def _lag(seen: Inspection) -> float:
    """How far the garment at one grasp lies behind that at the other [m]; NaN for a fold with one arm."""
    ends = [reach for name, reach in seen.left_behind.items() if name != "middle"]
    return max(ends) - min(ends) if len(ends) == 2 else float("nan")


def _least_left(seen: Inspection) -> float:
    """How far the garment lies behind everywhere along the fold [m]; NaN where that is not seen."""
    return min(seen.left_behind.values()) if seen.left_behind else float("nan")


def _edge_defect(seen: Inspection, step: FoldStep | None, settings: InspectionSettings) -> FailureKind:
    """Which defect a bad outline has: by what was left behind, then by where its edge is worst.

    A middle behind both ends sagged. A bad edge beside a target is a dropped corner, one between the targets
    sagged. The rest is off target.
    """
    if step is None or not step.targets:
        return FailureKind.OFF_TARGET
    ends = [reach for name, reach in seen.left_behind.items() if name != "middle"]
    if "middle" in seen.left_behind and seen.left_behind["middle"] - max(ends) > settings.sag:
        return FailureKind.SAG
    targets = np.array([t[:2] for t in step.targets.values()])
    near = float(np.linalg.norm(targets - seen.edge_place, axis=1).min())
    if near <= settings.corner_radius:
        return FailureKind.DROPPED_CORNER
    if len(targets) == 2:
        a, b = targets
        span = b - a
        share = float((seen.edge_place - a) @ span / max(float(span @ span), 1e-9))
        off = float(np.linalg.norm(a + np.clip(share, 0, 1) * span - seen.edge_place))
        if 0.15 < share < 0.85 and off < 2.0 * settings.corner_radius:
            return FailureKind.SAG
    return FailureKind.OFF_TARGET
