"""What the runner does on entering a state: one function an effect, (workcell, context) -> result."""

from __future__ import annotations

from collections.abc import Mapping

from cell.executive.effects import deciding, gripping, inspecting, moving, planning, pressing, seeing
from cell.executive.runner import EffectFunction
from cell.hardware.workcell import Workcell
from cell.states.context import Context, Result
from cell.states.transition_table import Effect, Event

__all__ = ["EFFECTS"]


def _nothing(cell: Workcell, context: Context) -> Result:
    return Result(Event.DONE, context)


EFFECTS: Mapping[Effect, EffectFunction] = {
    Effect.NOTHING: _nothing,
    Effect.PREPARE: moving.prepare,
    Effect.REENTER: moving.reenter,
    Effect.PHOTOGRAPH_TABLE: seeing.photograph_table,
    Effect.AWAIT_GARMENT: seeing.await_garment,
    Effect.LOOK: seeing.look,
    Effect.RECOGNISE: seeing.recognise,
    Effect.PLAN_FOLDS: planning.plan_steps,
    Effect.CHOOSE_TRAJECTORY: planning.choose_trajectory,
    Effect.PLAN_MOTION: planning.plan_motion,
    Effect.ASK_APPROVAL: deciding.ask_approval,
    Effect.APPROACH: moving.approach,
    Effect.GRASP: gripping.grasp,
    Effect.LIFT: gripping.lift,
    Effect.FOLD: gripping.fold,
    Effect.RELEASE: gripping.release_garment,
    Effect.RETREAT: moving.retreat,
    Effect.INSPECT: inspecting.inspect_fold,
    Effect.PRESS: pressing.press,
    Effect.NEXT_STEP: inspecting.next_step,
    Effect.CLEAR: moving.clear,
    Effect.CHOOSE_RECOVERY: deciding.choose_next,
    Effect.ASK_OPERATOR: deciding.ask_operator,
    Effect.WAIT: deciding.pause,
    Effect.HOLD: moving.hold_still,
    Effect.MAKE_SAFE: moving.make_safe,
}
