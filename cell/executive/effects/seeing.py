"""Effects that look: the empty table, the garment, and what a fold has come to."""

from __future__ import annotations

from dataclasses import replace

from cell.control.checks import fresh_state
from cell.executive.effects.inspecting import find_folded
from cell.hardware.workcell import Workcell
from cell.states.run_context import Result, RunContext
from cell.states.stages import Recognition
from cell.states.transition_table import Event
from robots.errors import Failure, FailureKind
from robots.ports import CameraFrame
from skills.perception.overlay import draw_on_camera
from skills.perception.perceive import camera_fault, perceive
from skills.perception.rectification.camera_refinement import refine_calibration
from skills.vocabulary import CameraCalibration, Outcome

__all__ = ["await_garment", "capture", "look", "photograph_table", "recognise"]

HEAD_TOLERANCE = 0.01  # [rad]: a turned head moves the picture by 10 mm on the table
PICTURE_AGE = 0.5  # [s]: what is older shows another moment; a camera that hangs gives its last picture for ever


def capture(cell: Workcell, refined: CameraCalibration | None = None) -> Outcome[CameraFrame]:
    """A fresh picture, if the head stands where the camera was calibrated. refined: what is believed of the camera
    by now, for the view."""
    read = fresh_state(cell.ports, cell.execution)
    if read.failure:  # the head may have been turned since
        what = f"where the head stands is not known: {read.failure.what}"
        return Outcome(failure=replace(read.failure, kind=FailureKind.CAMERA_FAULT, what=what))
    pan = read.unwrap().head_pan
    if not abs(pan - cell.calibration.head_pan) <= HEAD_TOLERANCE:  # also where nobody knows
        return Outcome(
            failure=Failure(
                FailureKind.CAMERA_FAULT,
                f"the head stands at {pan:.3f} rad; the camera was calibrated at {cell.calibration.head_pan:.3f}",
                "turn the head back, or calibrate the camera where the head stands",
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
                f"the camera gives a picture of {age:.1f} s ago",
                "check the camera's cable and driver, then look again",
                {"age_s": age},
            )
        )
    return Outcome(frame)


def photograph_table(cell: Workcell, context: RunContext) -> Result:
    """The empty table, against which the garment is told from it."""
    if cell.settings.camera.reference == "none":
        return Result(Event.DONE, context)
    shot = capture(cell)
    if shot.failure:
        return Result(Event.FAILED, context.with_failure(shot.failure))
    frame = shot.unwrap()
    unusable = camera_fault(frame, cell.calibration, settings=cell.perception)
    if unusable:
        return Result(Event.FAILED, context.with_failure(unusable))
    refined = cell.compute(0.0, lambda: refine_calibration(frame, cell.calibration, cell.table))
    context = replace(context, sight=replace(context.sight, reference=frame, refined=refined.value))
    if refined.failure:  # the table does not show well enough: the calibration stands as it is
        return Result(Event.DONE, context, {"refined": False, "why": refined.failure.what})
    return Result(Event.DONE, context, {"refined": True, **refined.notes})


def await_garment(cell: Workcell, context: RunContext) -> Result:
    """Somebody lays the garment on the table."""
    began = cell.ports.clock.now()
    cell.ports.attendant.lay_garment()
    if cell.ports.simulated:  # takes the time that a person takes, as it is declared
        return Result(Event.DONE, context)
    return Result(Event.DONE, replace(context, waited_s=context.waited_s + cell.ports.clock.now() - began))


def look(cell: Workcell, context: RunContext) -> Result:
    sight = context.sight
    shot = capture(cell, sight.refined)
    if shot.failure:
        return Result(Event.FAILED, context.with_failure(shot.failure))
    seen = replace(sight, frame=shot.unwrap(), previous=sight.frame)
    return Result(Event.DONE, replace(context, sight=seen))


def recognise(cell: Workcell, context: RunContext, frame: CameraFrame) -> Result:
    """Before the first fold: which garment, and where its key points are. Later: where the folded garment lies."""
    plan, sight = context.plan, context.sight
    if plan is not None and context.fold.index > 0:
        return find_folded(cell, context, plan, frame)
    expected = cell.expected or (
        plan.garment if plan else None
    )  # what was recognised once is not taken for another one later
    seen = cell.compute(
        cell.settings.computing.perception_s,
        lambda: perceive(
            frame,
            sight.calibration(cell.calibration),
            cell.table,
            sight.reference,
            cell.garments,
            expected.name if expected else None,
            cell.perception,
            sight.previous,
        ),
    )
    if seen.failure:
        return Result(Event.FAILED, context.with_failure(seen.failure), {"wall": dict(seen.notes)})
    perception = seen.unwrap()
    state = perception.state
    overlay = draw_on_camera(perception, frame.rgb)
    cell.recorder.perception(cell.ports.clock.now(), perception, overlay)
    record = {
        "garment": perception.garment,
        "category": state.category,
        "confidence": state.confidence,
        "keypoints_m": {k: [round(float(c), 4) for c in p] for k, p in state.keypoints.items()},
        "wall": dict(seen.notes),
    }
    return Result(Event.DONE, replace(context, recognition=Recognition(perception, overlay)), record)
