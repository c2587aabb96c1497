"""The effect with which the ladder pulls cloth out of the hands, in the place of a fold."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from foldcell.cell.control.motion import Tick, Watch
from foldcell.cell.control.motions.hold_position import wait
from foldcell.cell.executive.effects.checked_motion import as_failure, move, pausable
from foldcell.cell.executive.effects.folding import all_of, slip_watch
from foldcell.cell.executive.runner import EffectFunction
from foldcell.cell.hardware.workcell import Workcell
from foldcell.cell.states.fold_context import FoldContext
from foldcell.cell.states.run_context import Result, RunContext, effect
from foldcell.cell.states.transition_table import Event
from foldcell.robots.errors import Failure, FailureKind
from foldcell.robots.ports import Array, Side
from foldcell.skills.grasping.confirm import Held
from foldcell.skills.grasping.hand_reading import GripCommand
from foldcell.skills.motion.kinematics.ik import tool_pose
from foldcell.skills.motion.moves.lift import plan_straight
from foldcell.skills.vocabulary import Outcome

LIGHT, SETTLE_S = 1.5, 0.5
"""Force with which the pads hold the cloth meanwhile [N], and how long they settle to it [s]."""
REACH, SPEED = 0.08, 0.02
"""How far each hand is led away from the other one [m], and how fast [m/s]."""


def pulling(figures: dict[str, float]) -> EffectFunction:
    """Return the effect: the hands hold the cloth lightly and go apart. It fails as SLIPPED if a hand reports that
    first; else as LIMIT_EXCEEDED: a joint's effort has changed by as much as in a contact, or no hand has reported
    a slip within the reach. figures: gets how far a hand was led, and the largest change of an effort."""

    @effect
    def pull(cell: Workcell, context: RunContext) -> Result:
        held = context.need(_held_lightly(cell, context.fold))
        q = cell.ports.arms.state().q
        begun = _tools(cell, q)
        away = begun[Side.RIGHT] - begun[Side.LEFT]
        away /= np.linalg.norm(away)
        ways = {Side.LEFT: -away, Side.RIGHT: away}
        apart = context.need(
            plan_straight(
                cell.robot, cell.execution_checker, q, ways, REACH, speed=SPEED, limits=cell.limits, name="pull"
            )
        )
        watch = all_of(_effort_limit(cell, figures), slip_watch(cell, replace(context.fold, held=held)))
        control = pausable(cell)
        ended = as_failure(lambda: move(cell, apart, fingertips=True, control=control, watch=watch))
        now = _tools(cell, cell.ports.arms.state().q)
        gone = max(float(np.linalg.norm(now[side] - begun[side])) for side in Side)
        figures["pulled_m"] = gone
        if ended is None:
            ended = Failure(
                FailureKind.LIMIT_EXCEEDED,
                f"no hand has felt the cloth slip, though each was led {1e3 * REACH:.0f} mm away",
                "calibrate the pads; look at the grip's curve",
            )
        if ended.kind in (FailureKind.SLIPPED, FailureKind.LIMIT_EXCEEDED):
            back = {side: -way for side, way in ways.items()}
            home = context.need(
                plan_straight(
                    cell.robot,
                    cell.execution_checker,
                    cell.ports.arms.state().q,
                    back,
                    gone,
                    limits=cell.limits,
                    name="way back",
                )
            )
            context.require(as_failure(lambda: move(cell, home, fingertips=True, control=control)))
        context.require(ended)
        return Result(Event.DONE, context)

    return pull


def _held_lightly(cell: Workcell, fold: FoldContext) -> Outcome[Mapping[Side, Held]]:
    """Loosen the grip of the hands, and return what they hold then."""
    for side in fold.held:
        cell.hands.command(side, GripCommand(0.0, LIGHT))
    failure = as_failure(lambda: wait(cell.loop, SETTLE_S, cell.hands.recording()))
    if failure:
        return Outcome(failure=failure)
    state, light = cell.ports.arms.state(), dict[Side, Held]()
    for side, held in fold.held.items():
        reading = cell.hands.read(side, state)
        grip = float(fold.biases[side].pads(reading).min())
        light[side] = replace(held, grip=grip, opening=reading.gripper.opening)
    return Outcome(light)


def _tools(cell: Workcell, q: Array) -> dict[Side, Array]:
    """Return the positions (3,) of the tools [m]."""
    return {side: tool_pose(cell.robot.chains[side], q[cell.robot.arm(side)])[:3, 3] for side in Side}


def _effort_limit(cell: Workcell, figures: dict[str, float]) -> Watch:
    first: list[Array] = []

    def look(tick: Tick) -> Failure | None:
        effort = tick.state.effort
        first.append(effort)
        change = float(np.abs(effort - first[0]).max())
        figures["effort_nm"] = max(change, figures.get("effort_nm", 0.0))
        if change < cell.grasp.contact_effort:
            return None
        return Failure(
            FailureKind.LIMIT_EXCEEDED,
            f"the effort of a joint has changed by {change:.1f} Nm before the cloth slipped",
            "lower the grip force; use a cloth that slips",
        )

    return look
