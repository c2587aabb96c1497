"""Effects that take pictures: of the empty table, the garment, and a completed fold."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

from foldcell.cell.control.checks import fresh_state
from foldcell.cell.executive.effects.inspecting import find_folded
from foldcell.cell.executive.effects.recovery.spreading import lies_elsewhere, not_spread, spreadable
from foldcell.cell.hardware.workcell import Workcell
from foldcell.cell.states.run_context import Result, RunContext, Sight, effect
from foldcell.cell.states.stages import FirstLook, Recognition, Spread
from foldcell.cell.states.transition_table import Event
from foldcell.robots.errors import Failure, FailureKind
from foldcell.robots.ports import CameraFrame
from foldcell.skills.perception.camera_fault import camera_fault, picture_digests, repeated
from foldcell.skills.perception.drawing import draw_fitting, draw_on_camera
from foldcell.skills.perception.inspection.height_expectation import estimate_camera_bias
from foldcell.skills.perception.perceive import Perception, perceive
from foldcell.skills.perception.rectification.camera_refinement import refine_calibration, tilted_table
from foldcell.skills.perception.rectification.table_view import TableView
from foldcell.skills.perception.segmentation.obstruction import obstructed
from foldcell.skills.perception.settings import VIEW_PIXEL
from foldcell.skills.vocabulary import CameraCalibration, Outcome

HEAD_TOLERANCE = 0.01
"""Largest accepted deviation of the head's pan from its calibrated value [rad]. A deviation of this size shifts
the picture by 10 mm on the table."""
PICTURE_AGE = 0.5
"""Largest accepted age of a picture [s]. An older picture is refused, because a frozen camera repeats its last
picture."""


def capture(cell: Workcell, refined: CameraCalibration | None = None) -> Outcome[CameraFrame]:
    """Take a picture with the head at its calibrated pan. refined: the refined calibration, for the recording.

    Fails with CAMERA_FAULT if the head is turned, its pan is unknown, or the picture is older than PICTURE_AGE.
    """
    read = fresh_state(cell.ports, cell.execution)
    if read.failure:  # the head may have been turned since the last known state
        what = f"the head's direction is not known: {read.failure.what}"
        return Outcome(failure=replace(read.failure, kind=FailureKind.CAMERA_FAULT, what=what))
    pan = read.unwrap().head_pan
    if not abs(pan - cell.calibration.head_pan) <= HEAD_TOLERANCE:  # also true for NaN
        return Outcome(
            failure=Failure(
                FailureKind.CAMERA_FAULT,
                f"the head stands at {pan:.3f} rad; the camera was calibrated at {cell.calibration.head_pan:.3f}",
                "turn the head back, or calibrate the camera with the head in this position",
                {"head_pan_rad": pan},
            )
        )
    frame = cell.ports.camera.capture()
    cell.recorder.camera(cell.ports.clock.now(), frame, refined or cell.calibration)
    age = cell.ports.clock.now() - frame.stamp
    if age > PICTURE_AGE:
        return Outcome(
            failure=Failure(
                FailureKind.CAMERA_FAULT,
                f"the camera's picture is {age:.1f} s old",
                "check the camera's cable and driver, then look again",
                {"age_s": age},
            )
        )
    return Outcome(frame)


def take_picture(cell: Workcell, context: RunContext) -> Outcome[Sight]:
    """Take a picture. Returns the sight with it as the latest picture. Fails as `capture` does, also for a picture
    that the camera has sent before: in an earlier look or during the present fold."""
    sight, attempt = context.sight, context.fold.attempt
    shot = capture(cell, sight.refined)
    if shot.failure:
        return Outcome(failure=shot.failure)
    frame = shot.unwrap()
    during = (digest for picture in (attempt.pictures if attempt else ()) for digest in picture_digests(picture))
    old = repeated(frame, (*sight.digests, *during))
    if old is not None:
        return Outcome(failure=old)
    digests = (*sight.digests, *picture_digests(frame))
    return Outcome(replace(sight, frame=frame, previous=sight.frame, digests=digests, refused=None))


@effect
def photograph_table(cell: Workcell, context: RunContext) -> Result:
    """Photograph the empty table: the reference for segmenting the garment."""
    if cell.settings.camera.reference == "none":
        return Result(Event.DONE, context)
    frame = context.need(capture(cell))
    unusable = repeated(frame, context.sight.digests) or camera_fault(
        frame, cell.calibration, None, cell.perception
    )
    if unusable is None:
        view = TableView(cell.calibration, cell.table, VIEW_PIXEL)
        unusable = obstructed(view, view.rectify(frame), None) or tilted_table(frame, cell.calibration, cell.table)
    seen = replace(context, sight=replace(context.sight, refused=frame))
    seen.require(unusable)
    refined = cell.compute(0.0, lambda: refine_calibration(frame, cell.calibration, cell.table))
    digests = (*context.sight.digests, *picture_digests(frame))
    sight = replace(context.sight, reference=frame, refined=refined.value, digests=digests, refused=None)
    context = replace(context, sight=sight)
    if refined.failure:  # the table is not visible well enough: the calibration stays as it is
        return Result(Event.DONE, context, {"refined": False, "why": refined.failure.what})
    return Result(Event.DONE, context, {"refined": True, **refined.notes})


def await_garment(cell: Workcell, context: RunContext) -> Result:
    """Wait until a person has laid the garment on the table."""
    began = cell.ports.clock.now()
    cell.ports.attendant.lay_garment()
    context = replace(context, first_look=None, fold=replace(context.fold, touched=False))
    if cell.ports.simulated and not cell.laid_by_person:  # the simulated attendant's time is robot time
        return Result(Event.DONE, context)
    return Result(Event.DONE, replace(context, waited_s=context.waited_s + cell.ports.clock.now() - began))


@effect
def look(cell: Workcell, context: RunContext) -> Result:
    """Take a picture of the garment. The event tells whether the garment may lie in any state of the fold, or was
    pulled to spread it. A repair and a pull end with this look."""
    sight = context.need(take_picture(cell, context))
    pulled = isinstance(context.fold.repair, Spread)
    context = replace(context, sight=sight, fold=context.fold.after_repair())
    if pulled:
        return Result(Event.SPREAD_ENDED, context)
    estimated = context.fold.uncertain and cell.settings.inspection.enabled
    return Result(Event.TOUCHED if estimated else Event.DONE, context)


@effect
def recognise(cell: Workcell, context: RunContext, frame: CameraFrame) -> Result:
    """Recognise the garment and its key points before the first fold. Before later folds, locate the garment."""
    plan, sight = context.plan, context.sight
    if plan is not None and context.fold.index > 0:
        return find_folded(cell, context, plan, frame)
    # after the first recognition, look only for the same garment
    expected = cell.expected or (plan.garment if plan else None)
    outcome = cell.compute(
        cell.settings.computing.perception_s,
        lambda: perceive(
            frame,
            sight.calibration(cell.calibration),
            cell.table,
            sight.reference,
            cell.garments,
            expected.name if expected else None,
            settings=cell.perception,
            previous=sight.previous,
        ),
    )
    perception = context.need(outcome, {"wall": dict(outcome.notes)})
    context.require(not_spread(context, perception))
    state = perception.state
    overlay = draw_on_camera(perception, frame.rgb)
    fitting = partial(draw_fitting, perception)
    cell.recorder.perception(cell.ports.clock.now(), state, perception.mask, overlay, fitting)
    record: dict[str, object] = {
        "garment": perception.garment,
        "category": state.category,
        "confidence": state.confidence,
        "keypoints_m": {k: [round(float(c), 4) for c in p] for k, p in state.keypoints.items()},
        "wall": dict(outcome.notes),
    }
    first_look = context.first_look
    if first_look is None or context.disturbed:
        first_look = _first_look(cell, perception)
        record |= {"camera_bias_m": first_look.bias.value, "camera_bias_measured": first_look.bias.measured}
    recognition = Recognition(perception, overlay)
    lasting = tuple(
        edit for edit in context.fold.edits if not (edit.grasps or edit.keypoints)
    )  # it may lie elsewhere
    fold = replace(context.fold, touched=False, edits=lasting)
    found = replace(context, recognition=recognition, first_look=first_look, disturbed=False, fold=fold)
    back = lies_elsewhere(found, state.contour) and spreadable(cell, found, FailureKind.HEAPED)
    return Result(Event.SPREAD if back else Event.DONE, found, record)


def _first_look(cell: Workcell, perception: Perception) -> FirstLook:
    """Return what later judgements need of the flat garment: its place, and the bias of the camera's heights."""
    garment = cell.expected or next(g for g in cell.garments if g.name == perception.garment)
    errors = cell.inspection.claim
    bias = estimate_camera_bias(
        perception.height, perception.mask, garment.layers, garment.material.thickness,
        garment.thickness_sigma(errors.thickness_spread), settings=errors,
    )  # fmt: skip
    return FirstLook(perception.state.contour, bias)
