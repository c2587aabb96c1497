"""The effect that plans a pull: it spreads a garment in a heap, from its silhouette and heights alone. Then
recognition decides whether the garment lies flat, and the fold is planned anew from where it lies."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from foldcell.cell.hardware.workcell import Workcell
from foldcell.cell.states.fold_context import FoldContext
from foldcell.cell.states.run_context import Result, RunContext, effect
from foldcell.cell.states.stages import FirstLook, Plan, Spread
from foldcell.cell.states.transition_table import Event
from foldcell.robots.errors import Failure, FailureKind
from foldcell.robots.ports import Array, CameraFrame, frozen
from foldcell.skills.fold_plan.spreading import (
    AWAY,
    Pull,
    lies_on,
    plan_pulls,
    pulls_home,
    spread_arcs,
    spread_step,
)
from foldcell.skills.perception.monitoring.flat_placement import Placement, convex_corners, place_outline
from foldcell.skills.perception.outline import polygon_area
from foldcell.skills.perception.perceive import Perception
from foldcell.skills.perception.rectification.heights import smooth_height
from foldcell.skills.perception.registration.alignment import align
from foldcell.skills.perception.segmentation.table_model import KNOWN_SHARE
from foldcell.skills.state_estimate.observation import Observation, observe
from foldcell.skills.trajectory.arcs.paths import fold_duration
from foldcell.skills.vocabulary import Corner, GraspTrajectory, Outcome, Table

SPREAD_AREA = 0.95
"""A garment is spread if it covers at least this share of the area that it covered when it lay flat. Two pictures
of one flat garment agree within 2 %; a corner that is folded over as far as a hand can hold it covers 3 % less."""
GROWTH = 0.02
"""The covered area has grown if it differs by more than this share of the flat garment's: the noise of
pictures."""
TURNED = np.deg2rad(6.0)
"""A garment that is turned further than this against how it was laid does not lie there [rad]."""
AROUND = 0.015
"""Side of the square whose mean height decides whether a hand can take all cloth there [m]."""
_UNRECOGNISED = frozenset(
    {
        FailureKind.NOT_FLAT,
        FailureKind.LOW_CONFIDENCE,
        FailureKind.UNKNOWN_GARMENT,
        FailureKind.CATEGORY_MISMATCH,
    }
)
"""Failures of recognition that can be caused by a garment that is not entirely spread."""
_HINT = "lay the garment flat where it lay before this fold (its outline is in the report), then retry"


@dataclass(frozen=True, eq=False)
class _Places:
    """The corners of the flat garment where it would lie if it were spread, and where it was laid."""

    now: tuple[Corner, ...]
    home: tuple[Corner, ...]
    placement: Placement


def spreadable(cell: Workcell, context: RunContext, kind: FailureKind) -> bool:
    """Whether a pull may spread the garment after a failure of this kind.

    It may do so only in the first fold, because a pull moves all layers at a corner together and would not open
    earlier folds. The garment must have been seen flat, because its flat area shows when it is spread. After a
    failure of recognition, it is pulled only if it was pulled before: otherwise a person may have laid another
    garment. A fold that the inspection found good is no heap, although its claim is in doubt.
    """
    fold = context.fold
    seen = fold.attempt.inspection if fold.attempt is not None else None
    return (
        fold.index == 0
        and fold.spread
        and (seen is None or seen.diagnosis is not None)
        and fold.pulls < cell.settings.recovery.pulls
        and context.plan is not None
        and context.first_look is not None
        and cell.settings.inspection.enabled
        and (fold.pulls > 0 or kind not in _UNRECOGNISED)
    )


@effect
def choose_pull(cell: Workcell, context: RunContext, plan: Plan, first: FirstLook, frame: CameraFrame) -> Result:
    """Plan the next pull from the picture. Motion planning follows, as for a fold.

    After a pull that has not enlarged the covered area, the next best one is planned. Fails with HEAPED if no pull
    is possible; the cell then asks.
    """
    sight, fold = context.sight, context.fold

    def work() -> Outcome[tuple[Observation, _Places]]:
        seen = observe(
            frame,
            sight.calibration(cell.calibration),
            cell.table,
            sight.reference,
            sight.previous,
            settings=cell.perception,
        )
        if seen.failure:
            return Outcome(failure=seen.failure)
        return Outcome((seen.unwrap(), _places(seen.unwrap(), plan, first, cell.table)))

    seen, places = context.need(cell.compute(cell.settings.computing.inspection_s, work))
    covered, flat = abs(polygon_area(seen.contour)), abs(polygon_area(first.contour))
    record: dict[str, object] = {"covered_m2": covered, "flat_m2": flat}
    home = covered >= SPREAD_AREA * flat and _displaced(places)
    possible = partial(_possible, cell.table, seen)
    fruitless = _fruitless((*fold.covered, covered), GROWTH * flat)
    planned = (
        pulls_home(places.now, places.home, possible)
        if home
        else plan_pulls(
            seen.contour,
            convex_corners(seen.contour),
            places.placement.of(plan.flat.contour),
            places.now,
            possible,
            _takeable(cell, context, seen),
            fruitless,
        )
    )
    if planned.failure and fruitless and not home:
        failure = Failure(
            FailureKind.HEAPED,
            f"the last pull has not spread the garment: it covers {_cm2(covered)} of {_cm2(flat)}, "
            f"before the pull {_cm2(fold.covered[-1])}, and no other pull is left",
            _HINT,
            {"covered_m2": covered, "before_m2": fold.covered[-1]},
        )
        return _failed(context, failure, record)
    if planned.failure:
        # a flat garment that cannot be drawn back is folded where it lies, after another look
        kind = FailureKind.GARMENT_MOVED if home else planned.failure.kind
        return _failed(context, replace(planned.failure, kind=kind), record)
    pulls = planned.unwrap()
    step = spread_step(plan.steps[fold.index].name, fold.index, pulls, plan.garment.material.thickness)
    arcs = spread_arcs(step)
    trajectory = GraspTrajectory(
        arcs, fold_duration(arcs, cell.settings.motion.tool_speed), "pull", np.nan, np.nan
    )
    aim = np.column_stack([places.placement.of(plan.vertices[:, :2]), plan.vertices[:, 2]])
    if home:
        R, t = _way_home(plan, first)
        aim = np.column_stack([plan.vertices[:, :2] @ R.T + t, plan.vertices[:, 2]])
    cell.recorder.plan(cell.ports.clock.now(), step)
    spread = Spread(step, trajectory, seen.contour, frozen(aim), covered, home)
    begun = replace(fold, repair=spread, attempt=None, estimate=None, pulls=fold.pulls + 1)
    return Result(Event.DONE, replace(context, fold=begun), {**record, **_record(pulls, places, home)})


def not_spread(context: RunContext, perception: Perception) -> Failure | None:
    """Return NOT_FLAT if the garment is recognised after a pull but covers less than when it lay flat, because a
    part of it may be folded under. Return None if it is spread, or if no pull was planned."""
    if not context.fold.pulls or context.first_look is None:
        return None
    covered = abs(polygon_area(perception.view.to_table(perception.segmentation.contour)))
    flat = abs(polygon_area(context.first_look.contour))
    if covered >= SPREAD_AREA * flat:
        return None
    what = f"the garment is recognised but not spread: it covers {_cm2(covered)} of {_cm2(flat)}"
    return Failure(FailureKind.NOT_FLAT, what, _HINT, {"covered_m2": covered, "flat_m2": flat})


def lies_elsewhere(context: RunContext, contour: Array) -> bool:
    """Whether a garment that was spread lies elsewhere than it was laid, so that it may be drawn back there.
    contour: (n, 2) as recognised [m]."""
    if not context.fold.pulls or context.first_look is None:
        return False
    R, t = align(context.first_look.contour, contour)
    middle = np.mean(context.first_look.contour, axis=0)
    return bool(np.linalg.norm(R @ middle + t - middle) > AWAY or abs(np.arctan2(R[1, 0], R[0, 0])) > TURNED)


def _fruitless(covered: Sequence[float], least: float) -> int:
    """Return how many pulls in a row, the last one included, have not enlarged the covered area by `least` [m2].
    covered: before the first pull and after each [m2]."""
    grown = [after - before > least for before, after in itertools.pairwise(covered)]
    return sum(1 for _ in itertools.takewhile(lambda g: not g, reversed(grown)))


def _places(seen: Observation, plan: Plan, first: FirstLook, table: Table) -> _Places:
    """Return where the corners of the flat garment belong, on the table and in the camera's view."""
    flat = plan.flat.contour
    lay = convex_corners(flat)

    placement = place_outline(
        seen.contour, convex_corners(seen.contour), flat, lay, partial(_possible, table, seen)
    )
    R, t = _way_home(plan, first)
    return _Places(
        tuple(_moved(c, placement.R, placement.t) for c in lay), tuple(_moved(c, R, t) for c in lay), placement
    )


def _way_home(plan: Plan, first: FirstLook) -> tuple[Array, Array]:
    """Return the rigid motion p -> R p + t from where the garment was planned to where it was laid [m]."""
    return align(plan.flat.contour, first.contour)


def _moved(corner: Corner, R: Array, t: Array) -> Corner:
    return Corner(frozen(R @ corner.point + t), frozen(R @ corner.inward))


def _displaced(places: _Places) -> bool:
    here, there = (np.array([c.point for c in cs]) for cs in (places.now, places.home))
    way = there.mean(axis=0) - here.mean(axis=0)
    a, b = (cs[0].inward for cs in (places.now, places.home))
    turn = float(np.arctan2(a[0] * b[1] - a[1] * b[0], a @ b))
    return bool(np.linalg.norm(way) > 0.5 * AWAY or abs(turn) > 0.5 * TURNED)


def _takeable(cell: Workcell, context: RunContext, seen: Observation) -> Callable[[Array], bool]:
    """Return whether a hand can take all cloth at a point (2,): it may not stand higher than the pads reach up
    from the table, and its height must be known. The camera's bias is taken off."""
    pixels = 2 * round(0.5 * AROUND / seen.view.pixel) + 1
    height = smooth_height(seen.height, pixels, KNOWN_SHARE)
    bias = context.first_look.bias.value if context.first_look else 0.0
    highest = cell.settings.gripper.pads.depth

    def takeable(point: Array) -> bool:
        return bool(height[_pixels(seen, point[None])][0] - bias <= highest)

    return takeable


def _pixels(seen: Observation, points: Array) -> tuple[Array, Array]:
    """Return the rows and the columns (n,) of the pixels that show points (n, 2)."""
    columns, rows = np.round(seen.view.to_pixel(points)).astype(int).T
    height, width = seen.mask.shape
    return np.clip(rows, 0, height - 1), np.clip(columns, 0, width - 1)


def _possible(table: Table, seen: Observation, points: Array) -> bool:
    """Whether all points (n, 2) lie on the table, away from its edge, and in the camera's view."""
    return lies_on(table, points) and bool(seen.view.valid[_pixels(seen, points)].all())


def _failed(context: RunContext, failure: Failure, record: dict[str, object]) -> Result:
    """Return the failure. No other pull is tried until a person has laid the garment anew."""
    fold: FoldContext = replace(context.fold, spread=False)
    return replace(context, fold=fold).failed(failure, record)


def _record(pulls: Sequence[Pull], places: _Places, home: bool) -> dict[str, object]:
    return {
        "home": home,
        "pulls": [
            {"from": [round(float(c), 4) for c in p.grasp], "to": [round(float(c), 4) for c in p.target]}
            for p in pulls
        ],
        "coinciding_boundary": places.placement.share,
    }


def _cm2(area: float) -> str:
    return f"{area * 1e4:.0f} cm2"
