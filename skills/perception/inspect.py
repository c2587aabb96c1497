"""After a fold: what lies on the table against what the simulation predicted."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from robots.ports import Array, frozen
from skills.perception.energy import Boundary, closest_segments
from skills.perception.moved_edge import MovedEdge, moved_edge
from skills.perception.perceive import (
    PerceptionSettings,
    camera_fault,
    height_above,
    segment,
    smooth_height,
    touches_border,
)
from skills.perception.template import polygon_area
from skills.perception.view import TableView
from skills.vocabulary import (
    CameraCalibration,
    CameraFrame,
    Failure,
    FailureKind,
    FoldStep,
    Outcome,
    PredictedShape,
    Table,
)

__all__ = ["Inspection", "InspectionSettings", "inspect"]


@dataclass(frozen=True)
class InspectionSettings:
    """When a fold is as predicted. Lengths [m], angles [rad], areas [m2]."""

    iou: float = 0.90
    """Overlap with the prediction, after rigid alignment."""
    drift: float = 0.030
    drift_angle: float = float(np.deg2rad(6.0))
    extra_height: float = 0.015
    piled_area: float = 0.0012
    """Area that may stand higher than predicted by `extra_height` before it is piled up."""
    fold_margin: float = 0.040
    """Heights nearer than this to a fold line are not judged: the fold's bulge is there."""
    deviation: float = 0.022
    """Boundary deviation that counts as a defect of the edge."""
    corner_radius: float = 0.07
    left_behind: float = 0.035
    """A corner that lies further behind than the other by this was dropped."""
    sag: float = 0.020
    """The middle of the fold that lies further behind than both ends by this sagged."""
    strip: float = 0.06
    """Half width of the strips, beside each grasp and between them, in which that is looked for."""
    missing_share: float = 0.45
    """A target that lacks this share of its upper layer's predicted height did not get it."""
    layer_height: float = 0.0018
    """Upper layers predicted thinner than this cannot be seen by depth."""
    hollow: float = 0.18
    """Share of the predicted height by which the middle of the moved edge may be lower than its ends."""
    edge_sag: float = 0.015
    edge_corner: float = 0.020
    """How far the moved edge's middle, and a corner of it, may lie behind the rest, on cloth (`moved_edge`)."""
    perception: PerceptionSettings = field(default_factory=PerceptionSettings)


@dataclass(frozen=True, eq=False)
class Inspection:
    """Observed against predicted.

    iou: as seen; iou_aligned: after the rigid motion that lays the prediction on what is seen. drift: (2,)
    [m] that motion of the prediction's centroid, drift_m its length, drift_rad its angle.
    extra_height_m: 95th percentile of height above the prediction, where both are and away from fold lines.
    piled_area_m2: area that stands too high. edge_deviation_m: largest boundary deviation after alignment,
    outside positive, at edge_place (2,). missing_layer: largest share of a target's upper layers that is
    not there (0..1), NaN when nobody can see it. hollow: by how much more of its height the moved edge lacks
    in the middle than at either end, NaN when nobody can see it. edge: where the edge that two arms
    moved came to lie on other cloth, None when nobody can see it. left_behind: for each grasp, and for the
    middle between two ('middle'), how much further than predicted the garment still reaches beyond the fold
    line there [m]; NaN where it is not seen. diagnosis: None when the fold is as predicted.
    contour: (n, 2) observed boundary. mask, predicted: (H, W) in `view`'s pixels.
    """

    iou: float
    iou_aligned: float
    drift: Array
    drift_m: float
    drift_rad: float
    extra_height_m: float
    piled_area_m2: float
    edge_deviation_m: float
    edge_place: Array
    missing_layer: float
    edge: MovedEdge | None
    hollow: float
    left_behind: Mapping[str, float]
    diagnosis: FailureKind | None
    confidence: float
    contour: Array
    mask: NDArray[np.bool_]
    predicted: NDArray[np.bool_]
    view: TableView
    rgb: NDArray[np.uint8]

    @property
    def accepted(self) -> bool:
        return self.diagnosis is None


def inspect(
    frame: CameraFrame,
    calibration: CameraCalibration,
    table: Table,
    reference: CameraFrame | None,
    predicted: PredictedShape,
    step: FoldStep | None = None,
    settings: InspectionSettings | None = None,
    previous: CameraFrame | None = None,
    flat_top: float | None = None,
) -> Outcome[Inspection]:
    """Compare one picture with the predicted mesh, and name what went wrong.

    step: the fold that was made, which tells where its targets and lines are; without it only what shows
    in silhouette and height is judged. reference: as for `perceive`. previous: the picture before the fold, which
    shows what the fold laid on top of the cloth that lay there, and tells a frozen camera. flat_top:
    `Perception.top` of the flat garment, which tells how far creases and pile stand above the mesh's
    middle surface.

    Fails with CAMERA_FAULT, NO_GARMENT or OUT_OF_VIEW: then there is nothing to judge. A bad fold is not a
    failure of looking: it is the value's `diagnosis`.
    """
    settings = settings or InspectionSettings()
    fault = camera_fault(frame, calibration, previous, settings.perception)
    if fault is not None:
        return Outcome(failure=fault)
    view = TableView(calibration, table, settings.perception.pixel)
    seen = view.rectify(frame)
    empty = view.rectify(reference) if reference is not None else None
    height = height_above(seen, empty)
    found = segment(seen, empty, height, settings.perception)
    if not found.found:
        return Outcome(failure=Failure(FailureKind.NO_GARMENT, "the garment is not seen on the table any more"))
    if touches_border(found.mask, view.valid, 2):
        return Outcome(
            failure=Failure(FailureKind.OUT_OF_VIEW, "the garment reaches beyond the view", "move it by hand")
        )
    expected = draw_shape(view, predicted)
    if flat_top is not None:
        expected += np.float32(max(flat_top - float(predicted.vertices[:, 2].min()), 0.0))
    inspection = _compare(view, seen.rgb, found.mask, found.contour, height, expected, step, settings)
    if step is not None and len(step.grasps) == 2 and previous is not None:
        before = height_above(view.rectify(previous), empty)
        inspection = _with_edge(inspection, height, before, predicted, step, settings)
    notes: dict[str, float | int | str] = {
        "iou": inspection.iou, "iou_aligned": inspection.iou_aligned, "drift_m": inspection.drift_m,
        "drift_rad": inspection.drift_rad, "extra_height_m": inspection.extra_height_m,
        "edge_deviation_m": inspection.edge_deviation_m, "segmentation_confidence": found.confidence,
    }
    return Outcome(value=inspection, notes=notes)


def _with_edge(
    seen: Inspection,
    height: NDArray[np.float32],
    before: NDArray[np.float32],
    predicted: PredictedShape,
    step: FoldStep,
    settings: InspectionSettings,
) -> Inspection:
    """With the picture before the fold: where the moved edge lies, and what follows from it."""
    R, t = align(_outline(seen.view, seen.predicted), seen.contour)
    seen = replace(seen, edge=moved_edge(height, before, predicted, step, seen.view, R, t))
    kind, confidence = diagnose(seen, step, settings)
    return replace(seen, diagnosis=kind, confidence=confidence)


def draw_shape(view: TableView, shape: PredictedShape) -> NDArray[np.float32]:
    """Height of a predicted mesh as the camera sees it (H, W) [m], NaN where the mesh is not.

    Each triangle is drawn where it appears on the view (its parallax included), low ones first.
    """
    place = np.round(view.to_pixel(view.shadow_on_table(shape.vertices)) * 16).astype(np.int32)
    z = shape.vertices[shape.triangles, 2].mean(axis=1)
    image = np.full(view.shape, np.nan, np.float32)
    for i in np.argsort(z, kind="stable"):
        cv2.fillConvexPoly(image, place[shape.triangles[i]], float(z[i]), cv2.LINE_8, 4)
    return image


def _compare(
    view: TableView,
    rgb: NDArray[np.uint8],
    mask: NDArray[np.bool_],
    contour: Array,
    height: NDArray[np.float32],
    expected: NDArray[np.float32],
    step: FoldStep | None,
    settings: InspectionSettings,
) -> Inspection:
    where = np.isfinite(expected)
    outline, observed = _outline(view, where), view.to_table(contour)
    R, t = align(outline, observed)
    moved = _moved(view, expected, R, t)
    centre = outline.mean(axis=0)
    drift = R @ centre + t - centre
    excess = smooth_height(height, 7) - moved
    deviation, place = _edge_deviation(outline @ R.T + t, observed)
    inspection = Inspection(
        iou=_iou(mask, where),
        iou_aligned=_iou(mask, np.isfinite(moved)),
        drift=frozen(drift),
        drift_m=float(np.linalg.norm(drift)),
        drift_rad=float(np.arctan2(R[1, 0], R[0, 0])),
        extra_height_m=_extra(excess, mask, view, step, settings),
        piled_area_m2=_piled(excess, mask, view, step, settings),
        edge_deviation_m=deviation,
        edge_place=frozen(place),
        missing_layer=_missing_layer(height, moved, view, step, R, t, settings),
        edge=None,
        hollow=_hollow(height, moved, view, step, R, t, settings),
        left_behind=_left_behind(view, mask, where, step, settings),
        diagnosis=None,
        confidence=1.0,
        contour=frozen(observed),
        mask=frozen(mask),
        predicted=frozen(where),
        view=view,
        rgb=frozen(rgb),
    )
    kind, confidence = diagnose(inspection, step, settings)
    return replace(inspection, diagnosis=kind, confidence=confidence)


def diagnose(
    seen: Inspection, step: FoldStep | None, settings: InspectionSettings
) -> tuple[FailureKind | None, float]:
    """What went wrong, if anything, and how sure that is (0..1: how far beyond its threshold it lies)."""
    shape_good = seen.iou_aligned >= settings.iou and abs(seen.edge_deviation_m) <= settings.deviation
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
    if seen.edge is None and np.isfinite(seen.hollow) and seen.hollow > settings.hollow:
        return FailureKind.SAG, _surety(seen.hollow, settings.hollow)
    if np.isfinite(seen.missing_layer) and seen.missing_layer > settings.missing_share:
        return FailureKind.DROPPED_CORNER, 0.5 * _surety(seen.missing_layer, settings.missing_share) + 0.2
    if seen.drift_m > settings.drift or abs(seen.drift_rad) > settings.drift_angle:
        ratio = max(seen.drift_m / settings.drift, abs(seen.drift_rad) / settings.drift_angle)
        return FailureKind.DRIFT, _surety(ratio, 1.0)
    worst = max(
        (1 - seen.iou_aligned) / (1 - settings.iou), seen.drift_m / settings.drift,
        abs(seen.edge_deviation_m) / settings.deviation,
    )
    return None, float(np.clip(1.0 - 0.5 * worst, 0.5, 1.0))


def _edge_on_cloth(seen: Inspection, settings: InspectionSettings) -> tuple[FailureKind, float] | None:
    """What is wrong with the moved edge where it lies on other cloth, the larger defect first."""
    if seen.edge is None:
        return None
    corner, sag = seen.edge.corner / settings.edge_corner, seen.edge.sag / settings.edge_sag
    if not max(corner, sag) > 1.0:  # also when nobody can see either
        return None
    kind = FailureKind.DROPPED_CORNER if corner > sag else FailureKind.SAG
    return kind, _surety(max(corner, sag), 1.0)


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


# --- figures -------------------------------------------------------------------------------------------


def _iou(a: NDArray[np.bool_], b: NDArray[np.bool_]) -> float:
    union = np.count_nonzero(a | b)
    return float(np.count_nonzero(a & b) / union) if union else 0.0


def _outline(view: TableView, mask: NDArray[np.bool_]) -> Array:
    contours, _ = cv2.findContours(mask.astype(np.uint8), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    if not contours:
        raise ValueError("the predicted shape lies outside of the view")
    return view.to_table(max(contours, key=len).reshape(-1, 2).astype(float))


def align(outline: Array, observed: Array, iterations: int = 20) -> tuple[Array, Array]:
    """The rigid motion p -> R p + t that lays one boundary (n, 2) on another (m, 2), R (2, 2), t (2,).

    Point to line, both ways, with Tukey's weights: a corner that hangs out does not turn the whole. The
    weights' scale shrinks from the whole misfit to 10 mm.
    """
    if polygon_area(outline) < 0:
        outline = outline[::-1]
    target = Boundary(observed if polygon_area(observed) > 0 else observed[::-1], 0.003, 0.010)
    source = Boundary(outline, 0.003, 0.010)
    q = source.samples
    R, t = np.eye(2), _middle(target.points) - _middle(source.points)
    for i in range(iterations):
        p = q @ R.T + t
        distance, normal = target.distance(p)
        X = source.points[::4] @ R.T + t
        _, _, foot = closest_segments(X, target.samples, target.sample_normals, 0.03)
        back = ((foot - target.samples) * target.sample_normals).sum(axis=1)
        points, normals = np.concatenate([p, foot]), np.concatenate([normal, target.sample_normals])
        r = np.concatenate([distance, back])
        scale = max(0.06 * 0.7**i, 3.0 * 1.4826 * float(np.median(np.abs(r))), 0.010)
        weight = np.clip(1.0 - (r / scale) ** 2, 0.0, None) ** 2
        centre = points.mean(axis=0)
        arm = points - centre
        J = np.column_stack([normals, arm[:, 0] * normals[:, 1] - arm[:, 1] * normals[:, 0]])
        A = (J * weight[:, None]).T @ J + np.diag([1e-6, 1e-6, 1e-6])
        dx, dy, turn = -np.linalg.solve(A, (J * weight[:, None]).T @ r)
        c, s = np.cos(turn), np.sin(turn)
        dR = np.array([[c, -s], [s, c]])
        R, t = dR @ R, dR @ (t - centre) + centre + (dx, dy)
        if max(abs(dx), abs(dy), 0.3 * abs(turn)) < 1e-5 and i > 8:
            break
    return R, t


def _middle(points: Array) -> Array:
    low, high = points.min(axis=0), points.max(axis=0)
    return 0.25 * (low + high) + 0.5 * points.mean(axis=0)


def _moved(view: TableView, image: NDArray[np.float32], R: Array, t: Array) -> NDArray[np.float32]:
    """A view image after the table motion p -> R p + t, NaN where nothing comes from."""
    corners = np.array([[0.0, 0.0], [view.shape[1], 0.0], [0.0, view.shape[0]]])
    to = view.to_pixel(view.to_table(corners) @ R.T + t)
    M = cv2.getAffineTransform(corners.astype(np.float32), to.astype(np.float32))
    size = (view.shape[1], view.shape[0])
    moved = cv2.warpAffine(
        image, M, size, flags=cv2.INTER_NEAREST, borderMode=cv2.BORDER_CONSTANT, borderValue=float("nan")
    )
    return moved.astype(np.float32, copy=False)


def _judged(
    mask: NDArray[np.bool_], view: TableView, step: FoldStep | None, settings: InspectionSettings
) -> NDArray[np.bool_]:
    """The part of a mask away from its rim and from the fold lines."""
    inner = cv2.erode(mask.astype(np.uint8), np.ones((7, 7), np.uint8)) > 0
    if step is not None:
        rows, columns = np.nonzero(inner)
        xy = view.to_table(np.stack([columns, rows], axis=1))
        near = np.zeros(len(xy), bool)
        for line in step.lines:
            near |= np.abs(line.signed_distance(xy)) < settings.fold_margin
        inner[rows[near], columns[near]] = False
    return inner


def _extra(
    excess: NDArray[np.float32],
    mask: NDArray[np.bool_],
    view: TableView,
    step: FoldStep | None,
    settings: InspectionSettings,
) -> float:
    samples = excess[_judged(mask, view, step, settings) & np.isfinite(excess)]
    return float(np.quantile(samples, 0.95)) if len(samples) > 100 else 0.0


def _piled(
    excess: NDArray[np.float32],
    mask: NDArray[np.bool_],
    view: TableView,
    step: FoldStep | None,
    settings: InspectionSettings,
) -> float:
    high = (excess > settings.extra_height) & _judged(mask, view, step, settings)
    return float(np.count_nonzero(high)) * view.pixel**2


def _edge_deviation(outline: Array, observed: Array) -> tuple[float, Array]:
    """Largest distance between two boundaries that holds over 3 cm of edge, signed, and where."""
    if polygon_area(outline) < 0:
        outline = outline[::-1]
    seen = Boundary(observed if polygon_area(observed) > 0 else observed[::-1], 0.003, 0.005)
    ours = Boundary(outline, 0.003, 0.005)
    candidates = []
    for samples, other, sign in ((seen.samples, ours, 1.0), (ours.samples, seen, -1.0)):
        distance, _ = other.distance(samples)
        window = np.lib.stride_tricks.sliding_window_view(np.r_[distance, distance[:5]], 6)
        held = np.where((window > 0).all(axis=1), window.min(axis=1), 0.0)
        held = np.where((window < 0).all(axis=1), window.max(axis=1), held)
        worst = int(np.argmax(np.abs(held)))
        candidates.append((sign * float(held[worst]), samples[(worst + 3) % len(samples)]))
    return max(candidates, key=lambda c: abs(c[0]))


def _missing_layer(
    height: NDArray[np.float32],
    moved: NDArray[np.float32],
    view: TableView,
    step: FoldStep | None,
    R: Array,
    t: Array,
    settings: InspectionSettings,
) -> float:
    """How much of the upper layers that were to come to a target is not there (0..1), the worst target.

    Mean height over a patch inside each target, where the prediction has folded cloth, against prediction.
    """
    if step is None:
        return float("nan")
    shares = []
    rows, columns = np.nonzero(np.isfinite(moved) & np.isfinite(height))
    if not len(rows):
        return float("nan")
    xy = view.to_table(np.stack([columns, rows], axis=1))
    want, have = moved[rows, columns], height[rows, columns]
    for target in step.targets.values():
        patch = np.linalg.norm(xy - (R @ target[:2] + t), axis=1) < 0.04
        if np.count_nonzero(patch) < 300:
            continue
        planned = float(want[patch].mean())
        if planned >= settings.layer_height:
            shares.append(1.0 - float(have[patch].mean()) / planned)
    return max(shares) if shares else float("nan")


def _hollow(
    height: NDArray[np.float32],
    moved: NDArray[np.float32],
    view: TableView,
    step: FoldStep | None,
    R: Array,
    t: Array,
    settings: InspectionSettings,
) -> float:
    """How much more of the predicted height the moved edge lacks in its middle than at its ends.

    Where the edge came to lie on cloth, a middle that stayed behind shows in no silhouette: only one layer less
    in a strip along the edge, which is less than the depth noise of a pixel, but not of the strip. After an
    earlier fold nothing is said: there a crease crosses the edge, and its bulge is higher than a layer.
    """
    if step is None or step.earlier or len(step.targets) != 2:
        return float("nan")
    a, b = (R @ target[:2] + t for target in step.targets.values())
    span = float(np.linalg.norm(b - a))
    along = (b - a) / max(span, 1e-9)
    inward = R @ step.line.normal
    rows, columns = np.nonzero(np.isfinite(moved) & np.isfinite(height))
    xy = view.to_table(np.stack([columns, rows], axis=1)) - a
    share, depth = xy @ along / max(span, 1e-9), xy @ inward
    parts = (np.abs(share - 0.5) < 0.25, np.abs(share - 0.05) < 0.1, np.abs(share - 0.95) < 0.1)
    hollows = []
    for near, far in ((-0.008, 0.025), (0.020, 0.050)):  # at the edge; further in, where a deep sag reaches
        lacks = []
        for part in parts:
            where = part & (depth > near) & (depth < far)
            planned = moved[rows[where], columns[where]]
            if np.count_nonzero(where) < 100 or float(planned.mean()) < settings.layer_height:
                return float("nan")
            lacks.append(1.0 - float(height[rows[where], columns[where]].mean() / planned.mean()))
        hollows.append(lacks[0] - max(lacks[1:]))
    return max(hollows)


def _left_behind(
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
    places = {str(side): float((g.point - line.point) @ line.direction) for side, g in step.grasps.items()}
    if len(places) == 2:
        places["middle"] = sum(places.values()) / 2
    reach = []
    for region in (mask, predicted):
        rows, columns = np.nonzero(region)
        xy = view.to_table(np.stack([columns, rows], axis=1))
        reach.append(((xy - line.point) @ line.direction, line.signed_distance(xy)))
    out = {}
    for name, place in places.items():
        seen, planned = (
            across[np.abs(along - place) < settings.strip] for along, across in reach
        )
        enough = min(len(seen), len(planned)) > 50
        out[name] = float(np.quantile(seen, 0.98) - np.quantile(planned, 0.98)) if enough else float("nan")
    return out
