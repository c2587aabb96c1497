"""Effects that only decide: the recovery table or the operator chooses what to try after a failure."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from foldcell.cell.config.deciding_setting import deciding_setting, grasping_hint, setting_in_words
from foldcell.cell.control.checks import stopped
from foldcell.cell.control.motions.hold_position import wait
from foldcell.cell.control.ticks import TICK_S
from foldcell.cell.executive.effects.editing import refusal, with_plan_edit, without_edits
from foldcell.cell.executive.effects.grasping import DEEPER
from foldcell.cell.executive.effects.planning import INWARD
from foldcell.cell.executive.effects.recovery.estimating import SURE
from foldcell.cell.executive.effects.recovery.repairing import believed
from foldcell.cell.executive.effects.recovery.spreading import spreadable
from foldcell.cell.hardware.workcell import Workcell
from foldcell.cell.states.commands import ABORTED
from foldcell.cell.states.fold_context import FoldContext
from foldcell.cell.states.plan_edit import PlanEdit
from foldcell.cell.states.recovery_table import VERDICTS, WITHOUT_EDITS, Adjustment, choose_recovery
from foldcell.cell.states.run_context import Result, RunContext, effect
from foldcell.cell.states.situation import Situation, wait_before_look
from foldcell.cell.states.stages import Spread
from foldcell.cell.states.transition_table import Event
from foldcell.robots.errors import Failure, FailureKind
from foldcell.skills.perception.inspection.diagnosis import lasting_defect
from foldcell.skills.state_estimate.hypothesis import FoldState

DWELL_PARTS = 20
"""Number of parts into which interruptions of the joint state may divide one dwell."""


_NEXT_GRASP = {
    Adjustment.LOWER: f"it presses {1e3 * DEEPER:.0f} mm deeper",
    Adjustment.INWARD: f"it grasps {1e3 * INWARD:.0f} mm further inward",
    Adjustment.UPRIGHT: "it stands upright",
}


@effect
def choose_next(cell: Workcell, context: RunContext, failed: Failure) -> Result:
    """Carry out the recovery that the table chooses: wait, note it, and adjust the next attempt."""
    situation = assess(cell, context, failed)
    recovery = choose_recovery(situation)
    event, adjust = recovery.event, recovery.adjust
    chosen = {"recovery": event.value, "change": adjust.value}
    if recovery is WITHOUT_EDITS:
        cell.tell(f"the changed plan is not possible, and the plan before it is made again: {failed.what}")
        return Result(event, without_edits(context, failed.what), {"kind": failed.kind.value, **chosen})
    record = {
        "kind": failed.kind.value,
        "attempt": situation.attempt,
        **chosen,
        **_reason_of_change(failed, adjust),
    }
    dwell = max(recovery.dwell_s, cell.settings.recovery.dwell)
    if recovery.looks_only:
        wait, left = wait_before_look(situation.attempt, situation.patience_s)
        dwell = max(dwell, wait)
        then = f"and then for {left:.0f} s more" if left else "for the last time"
        cell.tell(f"{failed.what}: the cell looks again in {dwell:.0f} s, {then} ({failed.hint})")
    if dwell > 0:
        context.require(_dwell(cell, dwell))
    if recovery.reason:
        limit = setting_in_words(recovery.limit, cell.settings) if recovery.limit else ""
        reason = recovery.reason.format(tries=len(context.retries), limit=limit)
        told = replace(failed, hint=_hint(cell, context, failed))
        asking = replace(context, failure=told, asking=reason, setting=deciding_setting(failed, cell.settings))
        return Result(event, asking, {**record, "reason": reason})
    if recovery.not_made and context.fold.attempt is not None:
        context = context.with_attempt(replace(context.fold.attempt, carried=False))
    note = f"{failed.kind.value} -> {event.value}"
    if adjust is not Adjustment.NONE:
        note += f" ({adjust.value})"
    recoveries = (*context.recoveries, (context.fold.index, note))
    if adjust is Adjustment.OTHER_VARIANT:
        context = context.counted_anew()
    fold = replace(_adjusted(context.fold, adjust), held={})
    if event is Event.REPAIR and fold.repair is None and fold.attempt is not None:
        fold = replace(fold, refused=(*fold.refused, (failed.kind, fold.attempt.motion)))
    return Result(event, replace(context, recoveries=recoveries, fold=fold), record)


def _hint(cell: Workcell, context: RunContext, failed: Failure) -> str:
    """Return the failure's hint; if the hands took too little or too much, with the settings that change it."""
    plan, attempt = context.plan, context.fold.attempt
    grasped_amiss = failed.kind in {FailureKind.MISSED_GRASP, FailureKind.MISSED_LAYER}
    if not (failed.hint and grasped_amiss and plan and attempt):
        return failed.hint
    layer = context.fold.planned_layer(plan)
    whole_stack = all(grasp.whole_stack(layer) for grasp in attempt.step.grasps.values())
    return grasping_hint(failed, cell.settings, whole_stack)


def _reason_of_change(failed: Failure, adjust: Adjustment) -> dict[str, object]:
    """Return in words what the last grasp has shown to be wrong, and what the next one changes; nothing if it has
    shown nothing."""
    if "too_high_m" not in failed.values or adjust not in _NEXT_GRASP:
        return {}
    stood = f"stood {1e3 * _value(failed, 'too_high_m', 0.0):.1f} mm too high"
    if _value(failed, "too_high_m", 0.0) <= 0.0:
        stood = "stood low enough, so the layers that it missed end beside its pads"
    return {"because": f"the {failed.values['side']} hand {stood}: {_NEXT_GRASP[adjust]}"}


def assess(cell: Workcell, context: RunContext, failed: Failure) -> Situation:
    """Return the situation after the failure."""
    fold, plan, bounds = context.fold, context.plan, cell.settings.recovery
    return Situation(
        kind=failed.kind,
        attempt=_attempt(context, failed.kind),
        patience_s=bounds.patience,
        attended=cell.attended,
        fold_tries_left=context.recoveries_in_step < bounds.attempts_per_step,
        run_tries_left=len(context.retries) < bounds.attempts_per_run,
        last_fold=bool(context.steps) and fold.index == len(context.steps) - 1,
        edited=bool(fold.edits) and fold.grasps == 0,
        other_variant=_other_variant(context),
        carried=fold.carried,
        held=bool(fold.held),
        repairing=fold.repair is not None,
        overlap=_value(failed, "iou_aligned", 1.0),
        deviation_m=max(
            abs(_value(failed, "edge_deviation_m", 0.0)),
            _value(failed, "left_behind_m", 0.0),
            _believed_deviation(fold),
        ),
        lasting_defect=_lasting_defect(cell, fold),
        stood_low=_value(failed, "too_high_m", math.inf) <= 0.0,
        too_many_layers=_value(failed, "layers", 0.0) > _value(failed, "layers_expected", math.inf),
        repairable=_repairable(fold, _value(failed, "iou_aligned", 0.0)),
        failed_alike=fold.failed_alike(failed.kind),
        lies_as_before=fold.estimate is not None and fold.estimate.state is FoldState.BEFORE,
        spreadable=spreadable(cell, context, failed.kind),
        table_seen=not _reference_missing(cell, context),
        recognised=context.recognition is not None,
        planned=plan is not None,
        trajectory=plan is not None and fold.trajectory is not None,
    )


def _attempt(context: RunContext, kind: FailureKind) -> int:
    """Return the number of failures of this kind in the present fold. Verdicts of inspections count together."""
    kinds = VERDICTS if kind in VERDICTS else {kind}
    return sum(context.attempts.get((context.fold.index, k.value), 0) for k in kinds)


def _lasting_defect(cell: Workcell, fold: FoldContext) -> bool:
    attempt = fold.attempt
    if attempt is None or attempt.inspection is None:
        return False
    return lasting_defect(attempt.inspection, attempt.step, cell.inspection) is not None


FARTHEST = 0.98
"""Quantile of the vertices' distances that counts: a corner that curls up is no fold that is half made."""


def _believed_deviation(fold: FoldContext) -> float:
    """Return how far the cloth of a fold that is surely half made lies off its predicted place by the estimate
    [m], 0 if it is not sure. The outline does not show a sleeve that one hand has dropped on the shirt. Estimate
    and prediction lie where the garment lay before the fold, so a drift does not count."""
    found, attempt = fold.estimate, fold.attempt
    if found is None or attempt is None or found.state is not FoldState.HALF_WAY or found.confidence < SURE:
        return 0.0
    lies = believed(fold, attempt)
    off = lies.hypothesis.shape.vertices - attempt.predicted.vertices if lies else np.zeros((1, 3))
    return float(np.quantile(np.linalg.norm(off[:, :2], axis=1), FARTHEST))


IN_SHAPE = 0.85
"""If the IoU of observed and predicted shape is at least this, a refused fold is no heap, whatever the estimate
says."""


def _repairable(fold: FoldContext, overlap: float) -> bool:
    """Whether the position of the garment is known well enough to repair the fold. The estimate need not tell
    whether the edge has come half the way or the whole way, because the best fit shows where the edge lies. After
    a repair that failed, the next picture will show it. overlap: IoU of observed and predicted shape, if an
    inspection refused the fold."""
    if fold.repair is not None:
        return not isinstance(fold.repair, Spread)
    found = fold.estimate
    if found is None or found.likeliest_shape is None:
        return False
    moved = sum(found.probabilities[state] for state in (FoldState.HALF_WAY, FoldState.AFTER))
    sure = found.best is not None and max(found.confidence, moved) >= SURE
    return sure or overlap >= IN_SHAPE


def _value(failed: Failure, name: str, otherwise: float) -> float:
    return float(failed.values.get(name, otherwise))


def _dwell(cell: Workcell, seconds: float) -> Failure | None:
    """Hold the arms for `seconds`. If their state becomes stale, the wait goes on without set-points, because the
    state may come back. The next motion checks whether it has."""
    clock = cell.ports.clock
    until = clock.now() + seconds
    for _ in range(DWELL_PARTS):
        failure = wait(cell.loop, until - clock.now(), cell.hands.recording())
        if failure is None or failure.kind is not FailureKind.STALE_STATE:
            return failure
        if clock.now() >= until:
            return None
    return failure


def _other_variant(context: RunContext) -> bool:
    """Whether the garment file has a variant of the present fold that was not tried."""
    if context.plan is None or context.fold.repair is not None:
        return False
    variants = len(context.plan.garment.plan[context.fold.index].variants)
    return context.fold.count(Adjustment.OTHER_VARIANT) < variants - 1


def _adjusted(fold: FoldContext, adjust: Adjustment) -> FoldContext:
    """Return the fold's context with one more adjustment for the next attempt. A new variant of the fold starts
    without the adjustments and postures of the previous variant."""
    if adjust is Adjustment.NONE:
        return fold
    if adjust is not Adjustment.OTHER_VARIANT:
        return replace(fold, adjustments=(*fold.adjustments, adjust))
    variant_changes = tuple(a for a in fold.adjustments if a is Adjustment.OTHER_VARIANT)
    return replace(fold, adjustments=(*variant_changes, adjust), avoided=())


def _reference_missing(cell: Workcell, context: RunContext) -> bool:
    """Whether the empty table must be photographed before the garment is laid on it."""
    return cell.settings.camera.reference != "none" and context.sight.reference is None


def ask_approval(cell: Workcell, context: RunContext) -> Result:
    """Ask the operator to approve a fold, or the pressing of a completed fold. Both may be skipped, and the plan
    of a fold may be changed. A repair can be neither skipped nor changed."""
    commands, attempt = {Event.APPROVE, Event.RETRY, Event.SKIP, Event.ABORT}, context.fold.attempt
    if context.fold.repair is not None:
        return _await_command(cell, context, commands - {Event.SKIP})
    if attempt is None or not attempt.carried:
        return _await_approval_of_fold(cell, context, commands | {Event.EDIT})
    answer = _await_command(cell, context, commands)
    if answer.event is not Event.SKIP:
        return answer
    return replace(answer, context=answer.context.with_attempt(replace(attempt, unpressed=True)))


def _await_approval_of_fold(cell: Workcell, context: RunContext, commands: set[Event]) -> Result:
    """Wait for the answer to a planned fold. An edit that cannot be made is refused, and the wait goes on."""
    while True:
        answer = _await_command(cell, context, commands)
        context = answer.context
        if answer.event is not Event.EDIT:
            return answer
        edit = PlanEdit.read(cell.commands.edit())
        reason = refusal(edit, context)
        if reason is None:
            cell.tell(f"the plan is changed ({edit.in_words()})")
            return replace(
                answer, context=with_plan_edit(context, edit), record={**answer.record, "edit": edit.record()}
            )
        cell.tell(f"this change is not possible: {reason}")


def ask_operator(cell: Workcell, context: RunContext) -> Result:
    answer = _await_command(cell, context, {Event.RETRY, Event.SKIP, Event.ABORT})
    if answer.event is not Event.RETRY:
        return answer
    event = Event.START_OVER if _reference_missing(cell, context) else Event.RETRY
    # before answering RETRY, the operator lays the garment as it was before the fold, so the attempt is forgotten
    fold = replace(
        answer.context.fold, attempt=None, repair=None, tried=(), estimate=None, touched=False, pulls=0,
        covered=(), spread=True, refused=(),
    )  # fmt: skip
    context = replace(answer.context.counted_anew(), fold=fold, forgiven=len(context.recoveries))
    return replace(answer, event=event, context=context)


def pause(cell: Workcell, context: RunContext) -> Result:
    return _await_command(cell, context, {Event.RESUME, Event.ABORT})


def _await_command(cell: Workcell, context: RunContext, expected: set[Event]) -> Result:
    """Hold still until the operator gives one of the expected commands. The waiting time is not part of the robot
    time."""
    start = cell.ports.clock.now()
    while True:
        failure = stopped(cell.ports)
        if failure:
            return _add_waiting_time(cell, context, start).failed(failure)
        command = cell.commands.wait(frozenset(expected), TICK_S)
        if command is not None:
            context = context.with_failure(ABORTED) if command is Event.ABORT else context
            return Result(command, _add_waiting_time(cell, context, start), {"command": command.value})
        cell.ports.clock.sleep_until(cell.ports.clock.now() + TICK_S)


def _add_waiting_time(cell: Workcell, context: RunContext, start: float) -> RunContext:
    return replace(context, waited_s=context.waited_s + cell.ports.clock.now() - start)
