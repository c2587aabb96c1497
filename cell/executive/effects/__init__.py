"""The effects: functions (workcell, context) -> result, which the runner calls on entering a state.

Most effects need values of the run's context as arguments. `EFFECTS` takes these values out of the context and
raises InternalError if one is missing. A missing value is a bug: the state machine has entered the state too
early.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TypeVar

from foldcell.cell.executive.effects import (
    checking,
    folding,
    grasping,
    inspecting,
    moving,
    planning,
    pressing,
    seeing,
)  # fmt: skip
from foldcell.cell.executive.effects.recovery import deciding, estimating, laying, repairing, spreading
from foldcell.cell.executive.runner import EffectFunction
from foldcell.cell.states.run_context import Result, RunContext
from foldcell.cell.states.stages import Attempt, Plan
from foldcell.cell.states.transition_table import Effect, Event
from foldcell.robots.errors import InternalError
from foldcell.robots.ports import CameraFrame

T = TypeVar("T")


def _required(value: T | None, name: str) -> T:
    if value is None:
        raise InternalError(f"there is no {name} yet")
    return value


def _frame(context: RunContext) -> CameraFrame:
    return _required(context.sight.frame, "picture")


def _plan(context: RunContext) -> Plan:
    return _required(context.plan, "plan")


def _attempt(context: RunContext) -> Attempt:
    return _required(context.fold.attempt, "planned motion")


EFFECTS: Mapping[Effect, EffectFunction] = {
    Effect.NOTHING: lambda cell, c: Result(Event.DONE, c),
    Effect.PREPARE: moving.prepare,
    Effect.REENTER: lambda cell, c: moving.reenter(cell, c, _required(c.reentry, "re-entry event")),
    Effect.PHOTOGRAPH_TABLE: seeing.photograph_table,
    Effect.AWAIT_GARMENT: seeing.await_garment,
    Effect.LOOK: seeing.look,
    Effect.ESTIMATE: lambda cell, c: estimating.estimate(cell, c, _plan(c), _attempt(c), _frame(c)),
    Effect.RECOGNISE: lambda cell, c: seeing.recognise(cell, c, _frame(c)),
    Effect.PLAN_FOLDS: lambda cell, c: planning.plan_steps(cell, c, _required(c.recognition, "garment")),
    Effect.CHOOSE_TRAJECTORY: lambda cell, c: planning.choose_trajectory(cell, c, _plan(c)),
    Effect.PLAN_MOTION: lambda cell, c: planning.plan_motion(
        cell, c, _plan(c), _required(c.fold.arcs, "trajectory")
    ),
    Effect.PLAN_REPAIR: lambda cell, c: repairing.choose_repair(cell, c, _plan(c), _attempt(c)),
    Effect.PLAN_SPREAD: lambda cell, c: spreading.choose_pull(
        cell, c, _plan(c), _required(c.first_look, "look at the flat garment"), _frame(c)
    ),
    Effect.ASK_APPROVAL: deciding.ask_approval,
    Effect.CHECK_PLACE: lambda cell, c: checking.check_place(cell, c, _attempt(c), _frame(c)),
    Effect.APPROACH: lambda cell, c: checking.approach_watched(cell, c, _attempt(c)),
    Effect.GRASP: lambda cell, c: grasping.grasp(cell, c, _plan(c), _attempt(c)),
    Effect.LIFT: folding.lift,
    Effect.FOLD: lambda cell, c: folding.fold(cell, c, _attempt(c)),
    Effect.RELEASE: lambda cell, c: folding.release_garment(cell, c, _attempt(c)),
    Effect.RETREAT: moving.retreat,
    Effect.INSPECT: lambda cell, c: inspecting.inspect_fold(cell, c, _plan(c), _attempt(c), _frame(c)),
    Effect.PRESS: lambda cell, c: pressing.press(
        cell, c, _attempt(c), _required(_attempt(c).press_plan, "plan for pressing")
    ),
    Effect.NEXT_STEP: inspecting.next_step,
    Effect.LAY_BACK: lambda cell, c: laying.lay_back(cell, c, _attempt(c)),
    Effect.CLEAR: moving.clear,
    Effect.CLEAR_AGAIN: moving.clear_again,
    Effect.CHOOSE_RECOVERY: lambda cell, c: deciding.choose_next(cell, c, _required(c.failure, "failure")),
    Effect.ASK_OPERATOR: deciding.ask_operator,
    Effect.WAIT: deciding.pause,
    Effect.HOLD: moving.hold_still,
    Effect.MAKE_SAFE: moving.make_safe,
}
