"""The effect that lifts the garment a little and checks that every hand still holds it."""

from __future__ import annotations

from dataclasses import replace

from foldcell.cell.control.motions.hands import each_hand
from foldcell.cell.executive.effects.checked_motion import as_failure, move, pausable, with_waiting_time
from foldcell.cell.hardware.workcell import Workcell
from foldcell.cell.states.run_context import Result, RunContext, effect
from foldcell.cell.states.transition_table import Event
from foldcell.skills.grasping.confirm import LiftCheck, check_lift
from foldcell.skills.motion.moves.lift import plan_lift

__all__ = ["lift"]


@effect
def lift(cell: Workcell, context: RunContext) -> Result:
    """Lift the garment a little and check that every hand still holds it."""
    fold, q = context.fold, cell.ports.arms.state().q
    if fold.repair is None:  # how the garment lay before a repair is less certain than how it lies after it
        cell.hand_record.begin()
    up = plan_lift(
        cell.robot,
        cell.execution_checker,
        q,
        tuple(fold.held),
        cell.settings.grasp.lift_height,
        limits=cell.limits,
    )
    if up.ok:
        context = replace(context, fold=replace(fold, carrying=(up.unwrap(),)))
    control = pausable(cell)
    failure = up.failure or as_failure(lambda: move(cell, up.unwrap(), fingertips=True, control=control))
    context = with_waiting_time(context, control)
    context.require(failure)
    checks = {s: LiftCheck(cell.grasp, fold.biases[s], held) for s, held in fold.held.items()}
    held = context.need(each_hand(cell.loop, cell.hands, checks, lambda side, r, s: check_lift(r, s)))
    return Result(Event.DONE, replace(context, fold=replace(context.fold, held=held)))
