"""Pressing: fingers flatten the high places of a completed fold by short contacts (dabs)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from foldcell.cell.control.motion import Tick
from foldcell.cell.control.motions.guarded_motions import FingertipForceMonitor
from foldcell.cell.control.motions.hands import each_hand
from foldcell.cell.control.motions.trajectory import stream
from foldcell.cell.executive.effects.checked_motion import move, pausable, with_waiting_time
from foldcell.cell.hardware.workcell import Workcell
from foldcell.cell.states.run_context import Result, RunContext, effect
from foldcell.cell.states.stages import Attempt, Plan, PressPlan
from foldcell.cell.states.transition_table import Event
from foldcell.robots.errors import Failure, FailureKind
from foldcell.robots.ports import Array, Side
from foldcell.skills.fold_plan.folding import layers_at, outline_of, target_vertices
from foldcell.skills.fold_plan.pressing import OPENING, Dab, crease_dabs, press_paths, within_reach, within_time
from foldcell.skills.grasping.hand_reading import GripCommand
from foldcell.skills.grasping.release import RELEASE_FORCE
from foldcell.skills.grasping.tare import TactileBias, TareState, tare
from foldcell.skills.motion.moves.arc import plan_arc
from foldcell.skills.motion.moves.fold import FoldMotion, plan_hands_motion
from foldcell.skills.perception.inspection.diagnosis import lasting_defect
from foldcell.skills.perception.inspection.high_places import find_high_places
from foldcell.skills.perception.inspection.result import Inspection
from foldcell.skills.vocabulary import FoldLine, FoldStep, GraspId, Outcome, PredictedShape, ToolPath

YIELD_S = 0.06
"""Time in which a pressing hand comes to rest after a hard push [s]. It is short, to limit the force."""
GAIN = 0.0015
"""A fold is pressed again only if the previous pressing lowered it by at least this height [m]."""
PRESS_S = 10.0
"""Time that one pressing takes, with its planning and the look after it [s]; in 16 pressings 8 to 11."""
WRONG_S = 80.0
"""Time that a wrong claim costs [s]: a person notices it, and the garment is folded anew (assumed)."""
LEAST = 0.5
"""A fold that is not good with at least this probability even after pressing is not pressed."""


def plan_pressing(
    cell: Workcell, index: int, plan: Plan, attempt: Attempt, inspection: Inspection
) -> PressPlan | None:
    """Plan the pressing of the fold that was just inspected: the hands' paths and the arms' motion.

    Returns None if the fold is flat enough, if an earlier pressing did not help, or if no hand can press it. The
    fold is then accepted or rejected as it is.
    """
    step = plan.steps[index]
    if not _should_press(cell, index, plan, attempt, inspection):
        return None
    observed_plan = replace(plan, vertices=attempt.predicted.vertices).drifted(inspection)
    observed_step = observed_plan.steps[index]
    dabs, highest = _dabs(cell, observed_step, observed_plan, inspection)
    if not dabs:
        cell.tell(f"fold {step.name} is not pressed: its crease does not stand high where fingers have room")
        return None
    planned = _planned(cell, observed_step.line, dabs, highest)
    if planned.failure:
        cell.tell(f"fold {step.name} is not pressed: {planned.failure.what}")
        return None
    paths, motion = planned.unwrap()
    cell.recorder.arcs(cell.ports.clock.now(), {s: p.position for s, p in motion.tool_paths.items()})
    return PressPlan(inspection, paths, motion, len(dabs))


@effect
def press(cell: Workcell, context: RunContext, attempt: Attempt, plan: PressPlan) -> Result:
    """Move above the fold and dab it as planned. A push that is too hard ends the pressing: the hands stop, then
    rise."""
    # the claim was made about the fold as it was before
    motion, attempt = plan.motion, replace(attempt, press_tries=attempt.press_tries + 1, claim=None)
    context = context.with_attempt(attempt)
    for side in motion.postures:
        cell.hands.command(side, GripCommand(OPENING, RELEASE_FORCE))
    control = pausable(cell)
    failure = move(cell, motion.approach, control=control)
    context = with_waiting_time(context, control)
    context.require(failure)
    tares = {s: TareState(cell.grasp) for s in motion.postures}
    biases = context.need(each_hand(cell.loop, cell.hands, tares, lambda side, r, s: tare(r, s)))
    arc = context.need(
        plan_arc(
            cell.robot, cell.execution_checker, cell.table, plan.paths, motion.postures,
            cell.ports.arms.state().q, limits=cell.limits, tool_speed=cell.settings.motion.tool_speed,
            rng=cell.rng(),
        )
    )  # fmt: skip
    guard, control = _Guard(cell, biases), replace(pausable(cell), stop_s=YIELD_S)
    moved = stream(cell.loop, arc.fold, cell.hands.recording(guard.look), control)
    attempt = replace(attempt, pressed=(*attempt.pressed, plan.inspection))
    context = replace(
        with_waiting_time(context, control), fold=replace(context.fold, biases=biases, attempt=attempt)
    )
    record = {
        "hands": len(motion.postures),
        "strongest_n": guard.monitor.strongest,
        "stopped_by_force": guard.hard_push is not None,
    }
    context.require(None if moved.failure is guard.hard_push else moved.failure, record)
    return Result(Event.DONE, context, record)


def _should_press(cell: Workcell, index: int, plan: Plan, attempt: Attempt, inspection: Inspection) -> bool:
    """Whether to press. A last fold without a defect of its shape is pressed if this makes the claim so much surer
    that it is worth its time. Another fold is pressed if its height hides whether it is good. An unpressed crease
    that is as high as its fabric makes it is not pressed."""
    settings, before, claim = cell.settings.pressing, attempt.pressed, attempt.claim
    in_vain = bool(before) and before[-1].height_m - inspection.height_m < GAIN
    if attempt.unpressed or attempt.press_tries >= settings.max_attempts or in_vain:
        return False
    if not np.isfinite(inspection.height_m):
        return False
    step = plan.steps[index]
    if claim is not None and (claim.shape or claim.probable_pressed):
        left = claim.probable_pressed[: settings.max_attempts - attempt.press_tries]
        return any(
            after >= LEAST and (after - claim.probable) * WRONG_S > PRESS_S * presses
            for presses, after in enumerate(left, 1)
        )
    flat_height = float(_flat(step, plan).vertices[:, 2].max()) + 0.5 * plan.garment.material.thickness
    followed = index + 1 < len(plan.steps)
    defect = lasting_defect(inspection, step, cell.inspection) if followed else inspection.diagnosis
    return defect is not None and bool(inspection.height_m > flat_height + settings.min_excess_height)


def _flat(step: FoldStep, plan: Plan) -> PredictedShape:
    """Return the garment's shape after this step if its creases were perfectly flat."""
    mesh = plan.mesh
    target = target_vertices(mesh, step.lines, plan.garment.material)
    return PredictedShape(target, mesh.triangles, mesh.rest)


def _dabs(cell: Workcell, step: FoldStep, plan: Plan, inspection: Inspection) -> tuple[tuple[Dab, ...], float]:
    """Choose the dabs. Returns them with the observed height of the garment [m]. step, plan: moved by the observed
    drift."""
    mesh, thickness, above = plan.mesh, plan.garment.material.thickness, cell.settings.pressing.min_excess_height
    found = find_high_places(
        inspection.height, inspection.mask, inspection.view, _flat(step, plan), thickness, above
    )
    if len(found.places) == 0:
        return (), 0.0
    outline, sheets = outline_of(mesh), int(mesh.layer.max()) + 1

    def flat_height(place: Array) -> float:
        return layers_at(step.lines, outline, place, sheets) * thickness

    # a quantile, because single pixels may be outliers
    highest = float(np.nanquantile(inspection.height[inspection.mask], 0.995))
    dabs = crease_dabs(found.places, found.above, step.line, flat_height, found.inside)
    return within_time(step.line, dabs, highest), highest


def _planned(
    cell: Workcell, line: FoldLine, dabs: tuple[Dab, ...], highest: float
) -> Outcome[tuple[Mapping[GraspId, ToolPath], FoldMotion]]:
    """Plan the hands' paths over the dabs and the arms' motion. If no motion for all dabs is found, plan only the
    dabs that one hand reaches."""
    q_now = cell.ports.arms.state().q

    def plan() -> Outcome[tuple[Mapping[GraspId, ToolPath], FoldMotion]]:
        first_failure: Failure | None = None
        for subset in (dabs, within_reach(dabs)):
            paths = press_paths(line, subset, highest)
            motion = plan_hands_motion(
                cell.robot, cell.checker, cell.table, paths, q_now, limits=cell.limits,
                tool_speed=cell.settings.motion.tool_speed, approach_height=0.0, rng=cell.rng(),
            )  # fmt: skip
            if motion.ok:
                return Outcome((paths, motion.unwrap()))
            first_failure = first_failure or motion.failure
        return Outcome(failure=first_failure)

    return cell.compute(cell.settings.computing.motion_s, plan)


class _Guard:
    """Ends a pressing motion when a tip is pushed harder than the settings allow, or when its force is unknown.

    hard_push: the failure that is set after too hard a push. It ends the pressing motion but does not fail the
    run.
    """

    def __init__(self, cell: Workcell, biases: Mapping[Side, TactileBias]) -> None:
        self.monitor = FingertipForceMonitor(cell.hands, biases)
        self.hard_push: Failure | None = None
        self._max_force = cell.settings.pressing.force

    def look(self, tick: Tick) -> Failure | None:
        failure = self.monitor.look(tick.state)
        if failure:
            return failure
        if self.hard_push is None and self.monitor.strongest > self._max_force:
            what = f"a fingertip was pushed with {self.monitor.strongest:.0f} N"
            self.hard_push = Failure(FailureKind.IN_COLLISION, what, "check what lies under the garment")
        return self.hard_push
