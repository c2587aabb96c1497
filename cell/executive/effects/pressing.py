"""Pressing: where a fold that was made stands high it is dabbed flat."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from cell.control.motion import Tick
from cell.control.motions.fingertip_force_monitor import FingertipForceMonitor
from cell.control.motions.hands import each_hand
from cell.control.motions.trajectory import stream
from cell.executive.effects.drift import apply_drift
from cell.executive.effects.moving import move, pausable, with_waiting_time
from cell.hardware.workcell import Workcell
from cell.states.run_context import Result, RunContext
from cell.states.stages import Attempt, Plan, PressPlan
from cell.states.transition_table import Event
from robots.errors import Failure, FailureKind
from robots.ports import Array, Side
from skills.grasping.hand_reading import GripCommand
from skills.grasping.tare import TactileBias, start_tare, tare
from skills.motion.moves.arc import plan_arc
from skills.motion.moves.fold import FoldMotion, plan_hands_motion
from skills.perception.inspection.high_places import find_high_places
from skills.perception.inspection.inspect import Inspection
from skills.planning.folding import layers_at, outline_of, target_vertices
from skills.planning.pressing import OPENING, Dab, crease_dabs, press_paths, within_reach
from skills.vocabulary import FoldLine, FoldStep, GraspId, Outcome, PredictedShape, ToolPath

__all__ = ["plan_pressing", "press"]

YIELD_S = 0.06
"""In which a hand that presses comes to rest when it is told to [s]: it must not go on to where it was sent."""
GAIN = 0.0015
"""A fold that pressing did not lower by this much is not pressed again [m]."""


def plan_pressing(cell: Workcell, index: int, plan: Plan, made: Attempt, seen: Inspection) -> PressPlan | None:
    """The hands' paths and the arms' motion that press the fold just inspected.

    None where it lies flat enough, was pressed in vain, or no hand can press it: the fold stands as it is.
    """
    step = plan.steps[index]
    if not _wanted(cell, step, plan, made, seen):
        return None
    lying = apply_drift(replace(plan, vertices=made.predicted.vertices), seen)
    where = lying.steps[index]
    dabs, highest = _dabs(cell, where, lying, seen)
    if not dabs:
        cell.tell(f"fold {step.name} is not pressed: its crease does not stand high where fingers have room")
        return None
    planned = _planned(cell, where.line, dabs, highest)
    if planned.failure:
        cell.tell(f"fold {step.name} is not pressed: {planned.failure.what}")
        return None
    paths, motion = planned.unwrap()
    cell.recorder.arcs(cell.ports.clock.now(), {s: p.position for s, p in motion.tool_paths.items()})
    return PressPlan(seen, paths, motion, len(dabs))


def press(cell: Workcell, context: RunContext, made: Attempt, plan: PressPlan) -> Result:
    """To above the fold, and dab it as it was planned. A push that is too hard ends it: the hands come to rest on
    their way, and rise."""
    motion, made = plan.motion, replace(made, press_tries=made.press_tries + 1)
    context = context.with_attempt(made)
    for side in motion.postures:
        cell.hands.command(side, GripCommand(OPENING, cell.grasp.release_force))
    control = pausable(cell)
    failure = move(cell, motion.approach, control=control)
    if failure:
        return Result(Event.FAILED, with_waiting_time(context, control).with_failure(failure))
    tares = {s: start_tare(cell.grasp) for s in motion.postures}
    zeros = each_hand(cell.loop, cell.hands, tares, lambda side, r, s: tare(r, s))
    if zeros.failure:
        return Result(Event.FAILED, with_waiting_time(context, control).with_failure(zeros.failure))
    context = with_waiting_time(context, control)
    arc = plan_arc(
        cell.robot, cell.execution_checker, cell.table, plan.paths, motion.postures, cell.ports.arms.state().q,
        limits=cell.limits, tool_speed=cell.settings.motion.tool_speed, rng=cell.rng(),
    )  # fmt: skip
    if arc.failure:
        return Result(Event.FAILED, context.with_failure(arc.failure))
    guard, control = _Guard(cell, zeros.unwrap()), replace(pausable(cell), stop_s=YIELD_S)
    moved = stream(cell.loop, arc.unwrap().fold, cell.hands.recording(guard.look), control)
    pressed = replace(made, pressed=(*made.pressed, plan.seen))
    context = replace(
        with_waiting_time(context, control), fold=replace(context.fold, zeros=zeros.unwrap(), attempt=pressed)
    )
    ended = guard.pushed is not None
    record = {
        "hands": len(motion.postures),
        "strongest_n": guard.pushes.strongest,
        "stopped_by_force": ended,
    }
    if moved.failure and moved.failure is not guard.pushed:
        return Result(Event.FAILED, context.with_failure(moved.failure), record)
    return Result(Event.DONE, context, record)


def _wanted(cell: Workcell, step: FoldStep, plan: Plan, made: Attempt, seen: Inspection) -> bool:
    """Whether the fold is seen to stand higher than its layers, and pressing may help."""
    settings, before = cell.settings.pressing, made.pressed
    in_vain = bool(before) and before[-1].height_m - seen.height_m < GAIN
    if made.unpressed or made.press_tries >= settings.tries or in_vain:
        return False
    flat = float(_flat(step, plan).vertices[:, 2].max()) + 0.5 * plan.garment.material.thickness
    return bool(seen.height_m > flat + settings.above_flat)


def _flat(step: FoldStep, plan: Plan) -> PredictedShape:
    """The garment after this step if its creases had no height."""
    mesh = plan.mesh
    target = target_vertices(mesh, step.lines, plan.garment.material)
    return PredictedShape(target, mesh.triangles, mesh.rest)


def _dabs(cell: Workcell, step: FoldStep, lying: Plan, seen: Inspection) -> tuple[tuple[Dab, ...], float]:
    """Where to press, and how high the garment stands [m]. lying: the plan where the garment is seen to lie after
    this step."""
    mesh, thickness, above = lying.mesh, lying.garment.material.thickness, cell.settings.pressing.above_flat
    found = find_high_places(seen.height, seen.mask, seen.view, _flat(step, lying), thickness, above)
    if len(found.places) == 0:
        return (), 0.0
    outline, sheets = outline_of(mesh), int(mesh.layer.max()) + 1

    def flat(place: Array) -> float:
        return layers_at(step.lines, outline, place, sheets) * thickness

    highest = float(np.nanquantile(seen.height[seen.mask], 0.995))  # single pixels lie
    return crease_dabs(found.places, found.above, step.line, flat, found.inside), highest


def _planned(
    cell: Workcell, line: FoldLine, dabs: tuple[Dab, ...], highest: float
) -> Outcome[tuple[Mapping[GraspId, ToolPath], FoldMotion]]:
    """The hands' paths over the dabs and the arms' motion, for all of them or those that one hand reaches."""
    q_now = cell.ports.arms.state().q

    def plan() -> Outcome[tuple[Mapping[GraspId, ToolPath], FoldMotion]]:
        why: Failure | None = None
        for some in (dabs, within_reach(dabs)):
            paths = press_paths(line, some, highest)
            motion = plan_hands_motion(
                cell.robot, cell.checker, cell.table, paths, q_now, limits=cell.limits,
                tool_speed=cell.settings.motion.tool_speed, approach_height=0.0, rng=cell.rng(),
            )  # fmt: skip
            if motion.ok:
                return Outcome((paths, motion.unwrap()))
            why = why or motion.failure
        return Outcome(failure=why)

    return cell.compute(cell.settings.computing.motion_s, plan)


class _Guard:
    """Ends a pressing motion when a tip is pushed harder than the settings allow, or nobody can say how hard.

    pushed: that one was pushed too hard, which is no failure of the run's.
    """

    def __init__(self, cell: Workcell, zeros: Mapping[Side, TactileBias]) -> None:
        self.pushes, self._most = (
            FingertipForceMonitor(cell.hands, cell.grasp, zeros),
            cell.settings.pressing.force,
        )
        self.pushed: Failure | None = None

    def look(self, tick: Tick) -> Failure | None:
        bad = self.pushes.look(tick.state)
        if bad:
            return bad
        if self.pushed is None and self.pushes.strongest > self._most:
            what = f"a fingertip was pushed with {self.pushes.strongest:.0f} N"
            self.pushed = Failure(FailureKind.IN_COLLISION, what, "see what lies under the garment")
        return self.pushed
