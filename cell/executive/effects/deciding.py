"""Effects that only decide: what to try after a failure, by table or by the operator."""

from __future__ import annotations

from dataclasses import replace

from cell.control.checks import stopped
from cell.control.motions.hold_position import wait
from cell.control.ticks import TICK_S
from cell.hardware.workcell import Workcell
from cell.states.commands import ABORTED
from cell.states.fold_context import FoldContext
from cell.states.recovery_table import Adjustment, Recovery, choose_recovery
from cell.states.run_context import Result, RunContext
from cell.states.transition_table import Event
from robots.errors import Failure

__all__ = ["ask_approval", "ask_operator", "choose_next", "pause"]


def choose_next(cell: Workcell, context: RunContext, failed: Failure) -> Result:
    """The recovery for the failure at hand: the table's, where it is a try within the bounds of the settings."""
    kind, fold = failed.kind, context.fold
    attempt = context.attempts[(fold.index, kind.value)]
    bounds = cell.settings.recovery
    last_fold = bool(context.steps) and fold.index == len(context.steps) - 1
    overlap = float(failed.values.get("iou_aligned", 1.0))
    recovery = choose_recovery(kind, attempt, cell.attended, last_fold, overlap, _several_ways(context))
    if recovery.event is Event.CARRY_ON:  # no try that could be used up, but it takes a fold that was made
        possible = fold.carried
    else:
        possible = (
            context.recoveries_in_step < bounds.attempts_per_step
            and len(context.recoveries) < bounds.attempts_per_run
        )
    if not possible:
        recovery = Recovery(Event.ASK if cell.attended else Event.GIVE_UP)
    dwell = max(recovery.dwell_s, bounds.dwell)
    if dwell > 0:
        failure = wait(cell.loop, dwell, cell.hands.recording())
        if failure:
            return Result(Event.FAILED, context.with_failure(failure))
    record = {
        "kind": kind.value,
        "attempt": attempt,
        "recovery": recovery.event.value,
        "change": recovery.adjust.value,
    }
    if recovery.event in {Event.ASK, Event.GIVE_UP}:
        return Result(recovery.event, context, record)
    event: Event = recovery.event
    on_cloth = event in {Event.GRASP_AGAIN, Event.PLAN_AGAIN} and (fold.carried or fold.held)
    if event is Event.LOOK_AGAIN or on_cloth:
        event = _where_to_look(cell, context)  # what was held was let go wherever it was
    record["recovery"] = event.value
    note = f"{kind.value} -> {event.value}" + (
        f" ({recovery.adjust.value})" if recovery.adjust is not Adjustment.NONE else ""
    )
    recoveries = (*context.recoveries, (fold.index, note))
    again = replace(_adjusted(fold, recovery.adjust), held={})
    return Result(event, replace(context, recoveries=recoveries, fold=again), record)


def _several_ways(context: RunContext) -> bool:
    """Whether the plan knows more than one way for the fold at hand."""
    return context.plan is not None and len(context.plan.garment.plan[context.fold.index].variants) > 1


def _adjusted(fold: FoldContext, adjust: Adjustment) -> FoldContext:
    """The next try changed by `adjust`, too. Made in another way a fold is a new one: nothing of it was tried."""
    if adjust is Adjustment.NONE:
        return fold
    if adjust is not Adjustment.OTHER_VARIANT:
        return replace(fold, adjustments=(*fold.adjustments, adjust))
    ways = tuple(a for a in fold.adjustments if a is Adjustment.OTHER_VARIANT)
    return replace(fold, adjustments=(*ways, adjust), avoided=())


def _where_to_look(cell: Workcell, context: RunContext) -> Event:
    """To look again is to look at what one wanted to see: the empty table, the garment, or what came of a fold."""
    if _table_unseen(cell, context):
        return Event.START_OVER
    return Event.LOOK_AFTER if context.fold.carried else Event.LOOK_AGAIN


def _table_unseen(cell: Workcell, context: RunContext) -> bool:
    """Whether the empty table is still to be photographed: the garment is laid after that."""
    return cell.settings.camera.reference != "none" and context.sight.reference is None


def ask_approval(cell: Workcell, context: RunContext) -> Result:
    """Of a fold, or of pressing one that was made, which may also be left as it is."""
    answers, made = {Event.APPROVE, Event.RETRY, Event.ABORT}, context.fold.attempt
    if made is None or not made.carried:
        return _await_command(cell, context, answers)
    said = _await_command(cell, context, answers | {Event.SKIP})
    if said.event is not Event.SKIP:
        return said
    return replace(said, context=said.context.with_attempt(replace(made, unpressed=True)))


def ask_operator(cell: Workcell, context: RunContext) -> Result:
    said = _await_command(cell, context, {Event.RETRY, Event.SKIP, Event.ABORT})
    if said.event is not Event.RETRY:
        return said
    event = Event.START_OVER if _table_unseen(cell, context) else Event.RETRY
    # whoever says so has laid the garment as it was before the fold
    fold = replace(said.context.fold, attempt=None)
    return replace(said, event=event, context=replace(said.context, fold=fold))


def pause(cell: Workcell, context: RunContext) -> Result:
    return _await_command(cell, context, {Event.RESUME, Event.ABORT})


def _await_command(cell: Workcell, context: RunContext, wanted: set[Event]) -> Result:
    """Hold still until the operator says one of `wanted`. Waiting is not charged to the robot's time."""
    start = cell.ports.clock.now()
    while True:
        failure = stopped(cell.ports)
        if failure:
            return Result(Event.FAILED, _waited(cell, context.with_failure(failure), start))
        command = cell.commands.wait(frozenset(wanted), TICK_S)
        if command is not None:
            context = context.with_failure(ABORTED) if command is Event.ABORT else context
            return Result(command, _waited(cell, context, start), {"command": command.value})
        cell.ports.clock.sleep_until(cell.ports.clock.now() + TICK_S)


def _waited(cell: Workcell, context: RunContext, start: float) -> RunContext:
    return replace(context, waited_s=context.waited_s + cell.ports.clock.now() - start)
