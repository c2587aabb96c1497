"""Effects that check, before the hands touch the garment, that it still lies where the plan expects it."""

from __future__ import annotations

from dataclasses import replace

from foldcell.cell.control.ticks import TICK_S
from foldcell.cell.executive.effects.moving import approach
from foldcell.cell.executive.effects.seeing import PICTURE_AGE, take_picture
from foldcell.cell.hardware.workcell import Workcell
from foldcell.cell.states.run_context import Result, RunContext, effect
from foldcell.cell.states.stages import Attempt
from foldcell.cell.states.transition_table import Event
from foldcell.robots.errors import DriverError, Failure, FailureKind
from foldcell.robots.ports import CameraFrame
from foldcell.skills.perception.camera_fault import repeated
from foldcell.skills.perception.inspection.result import MAX_PILED_AREA
from foldcell.skills.perception.monitoring.garment_motion import GarmentMotion, displaced_boundary, measure_motion
from foldcell.skills.perception.views import open_views
from foldcell.skills.vocabulary import Outcome

MOVED = 0.010
"""If no point of the garment has moved further than this, the garment lies where it was planned [m]. Grasps are at
least 12 mm inside the edge, and a fold may drift three times as far."""
RESHAPED = 0.015
"""Largest deviation between the outlines, after alignment, of a garment that has kept its shape [m]."""
DISPLACED = 0.080
"""A garment has moved under the hands if this length of its visible boundary has left its place [m]."""
_GONE = frozenset({FailureKind.NO_GARMENT, FailureKind.OUT_OF_VIEW})
"""Failures that show that somebody has moved the garment, because no hand of the cell was near it."""
GLANCE_S = 1.0
"""Longest wait for a picture without exposures [s]; after it, a still picture is taken."""


@effect
def check_place(cell: Workcell, context: RunContext, attempt: Attempt, planned: CameraFrame) -> Result:
    """Compare a fresh picture with the one that the fold was planned from, while the arms are parked.

    First, a picture is taken without waiting. If it shows everything in its place, the check ends. Otherwise a
    still picture is judged. If the still picture shows a hand or a garment that has moved, the failure leads to
    another look, and the fold is planned again where the garment then lies.
    """
    if not cell.settings.inspection.enabled:  # as in the paper, the cell relies on its first picture
        return Result(Event.DONE, context)
    glance = _glance(cell)
    if glance is not None and repeated(glance, context.sight.digests) is None:
        seen = _motion(cell, context, planned, glance)
        if seen.ok and _moved(cell, seen.unwrap()) is None:
            return Result(Event.DONE, context, _figures(seen.unwrap()))
    sight = context.need(take_picture(cell, context))
    assert sight.frame is not None
    seen = _motion(cell, context, planned, sight.frame)
    context = replace(context, sight=replace(context.sight, digests=sight.digests))
    if seen.failure:
        context = replace(context, sight=replace(context.sight, refused=sight.frame))
        context = replace(context, disturbed=context.disturbed or seen.failure.kind in _GONE)
        return context.failed(seen.failure)
    motion = seen.unwrap()
    failure = _moved(cell, motion)
    if failure is None:
        return Result(Event.DONE, context, _figures(motion))
    return replace(context, disturbed=True).failed(failure, _figures(motion))


def approach_watched(cell: Workcell, context: RunContext, attempt: Attempt) -> Result:
    """Move above the grasps. Then compare the visible part of the garment with the picture from which the fold was
    planned, because somebody may have moved the garment meanwhile."""
    result = approach(cell, context, attempt)
    sight, planned = context.sight, context.sight.frame
    if result.event is not Event.DONE or planned is None or sight.reference is None:
        return result
    if not cell.settings.inspection.enabled or (glance := _glance(cell)) is None:
        return result
    reference = sight.reference

    def displaced() -> float:
        calibration = sight.calibration(cell.calibration)
        views = [
            open_views(frame, calibration, cell.table, reference, None, cell.perception, arms_in_view=True)
            for frame in (planned, glance)
        ]
        before, after = (opened.value for opened in views)
        return 0.0 if before is None or after is None else displaced_boundary(before, after, cell.perception)

    length = cell.compute(cell.settings.computing.check_s, displaced)
    if length <= DISPLACED:
        return replace(result, record={**result.record, "displaced_boundary_m": length})
    failure = Failure(
        FailureKind.GARMENT_MOVED,
        f"{length * 1e3:.0f} mm of the garment's edge have left their place while the hands came",
        "keep hands off the table during a fold; the cell looks where the garment lies now",
        {"displaced_boundary_m": length},
    )
    return replace(result.context, disturbed=True).failed(failure, result.record)


def _glance(cell: Workcell) -> CameraFrame | None:
    """Return a picture without waiting for exposures, or None if the camera gives none within `GLANCE_S`."""
    deadline = cell.ports.clock.now() + GLANCE_S
    while True:
        try:
            frame = cell.ports.camera.glimpse()
        except DriverError as e:
            if e.kind is FailureKind.STOPPED:
                raise
            return None
        now = cell.ports.clock.now()
        if frame is not None and now - frame.stamp <= PICTURE_AGE:
            return frame
        if now >= deadline:
            return None
        cell.ports.clock.sleep_until(now + TICK_S)


def _motion(
    cell: Workcell, context: RunContext, planned: CameraFrame, frame: CameraFrame
) -> Outcome[GarmentMotion]:
    sight, settings = context.sight, cell.perception

    def compare() -> Outcome[GarmentMotion]:
        calibration = sight.calibration(cell.calibration)
        later = open_views(frame, calibration, cell.table, sight.reference, planned, settings)
        earlier = open_views(planned, calibration, cell.table, sight.reference, None, settings)
        for opened in (later, earlier):
            if opened.failure:
                return Outcome(failure=opened.failure)
        return measure_motion(earlier.unwrap(), later.unwrap(), settings)

    return cell.compute(cell.settings.computing.check_s, compare)


def _moved(cell: Workcell, motion: GarmentMotion) -> Failure | None:
    """Return GARMENT_MOVED if the plan does not fit the garment any more, else None."""
    hint = "keep hands off the table during a fold; the cell looks where the garment lies now"
    if motion.deviation_m > RESHAPED or motion.reshaped_m2 > MAX_PILED_AREA:
        off, area = f"{motion.deviation_m * 1e3:.0f} mm", f"{motion.reshaped_m2 * 1e4:.0f} cm2"
        what = (
            "the garment does not lie as it did when this fold was planned: "
            f"its edge is {off} off, and {area} have changed in height"
        )
        return Failure(FailureKind.GARMENT_MOVED, what, hint, _figures(motion))
    if motion.moved_m > MOVED:
        what = f"since this fold was planned, the garment was {motion.says()}"
        return Failure(FailureKind.GARMENT_MOVED, what, hint, _figures(motion))
    return None


def _figures(motion: GarmentMotion) -> dict[str, float]:
    return {
        "moved_m": motion.moved_m,
        "turned_rad": motion.turned_rad,
        "deviation_m": motion.deviation_m,
        "reshaped_m2": motion.reshaped_m2,
    }
