"""The effect that grasps: descend until the tips touch, push them down, close the pads, confirm what they hold."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial

import numpy as np

from foldcell.cell.control.motion import Motion
from foldcell.cell.control.motions.guarded_motions import (
    FingertipForceMonitor,
    GuardedHand,
    Lowering,
    guarded_descent,
    push_down,
)
from foldcell.cell.control.motions.hands import each_hand
from foldcell.cell.executive.effects.closing import UpperLayers, close_and_confirm
from foldcell.cell.hardware.workcell import Workcell
from foldcell.cell.states.fold_context import FoldContext
from foldcell.cell.states.recovery_table import Adjustment
from foldcell.cell.states.run_context import Result, RunContext, effect
from foldcell.cell.states.stages import Attempt, Plan, Repair
from foldcell.cell.states.transition_table import Event
from foldcell.robots.errors import Failure
from foldcell.robots.ports import JointState, Side
from foldcell.skills.garments.garment import Garment
from foldcell.skills.grasping.confirm import Expectation
from foldcell.skills.grasping.descend import Contact, DescentGoal, start_descent, yielding
from foldcell.skills.grasping.settings import GraspSettings
from foldcell.skills.grasping.standing import lower_tip, standing_height, to_stand_at
from foldcell.skills.grasping.tare import TareState, tare
from foldcell.skills.motion.kinematics.posture import Posture
from foldcell.skills.vocabulary import Grasp, Outcome

PUSH = 0.001
"""Depth by which the middle between the tips is lowered below the contact height [m], so that the pads close under
the cloth."""
DEEPER = 0.002
"""Additional depth for each adjustment LOWER [m], in a grasp of all layers down to the table."""
STOP = 0.65
"""If only upper layers are to be held, the descent stops at this height in the lowest of them, in layers. The tips
come to rest a little lower, near the middle of the layer."""
UP, DOWN = 0.25, 0.5
"""Shift of STOP for each adjustment HIGHER and LOWER, in layers. LOWER is the larger shift: a hand that held too
little has closed in the air above lofty or rumpled cloth, whose layers are not known well."""
LOWEST, HIGHEST = 0.3, 1.3
"""Range of the shifted STOP: above the table and above the lowest of the layers to be held, in layers."""
LEANING = 0.0005
"""If the tips of a hand differ in height by twice this, only one of them touches the table [m]."""
STRONGER = 1.4
"""Factor by which each adjustment STRONGER raises the grip force."""


LEARNED_ERROR = 0.08
"""Standard deviation of a layer's thickness that was measured in an earlier fold of the run, relative to it."""


def grip_settings(cell: Workcell, fold: FoldContext) -> GraspSettings:
    """Return the grasp settings with the grip force as raised by recoveries."""
    return replace(cell.grasp, grip_force=cell.grasp.grip_force * STRONGER ** fold.count(Adjustment.STRONGER))


@effect
def grasp(cell: Workcell, context: RunContext, plan: Plan, attempt: Attempt) -> Result:
    """Descend until the tips touch, push them into the stack, close the pads, and check how much they hold."""
    fold = context.fold
    settings = grip_settings(cell, fold)
    tares = {s: TareState(settings) for s in attempt.motion.descend}
    biases = context.need(each_hand(cell.loop, cell.hands, tares, lambda side, r, s: tare(r, s)))
    fold = replace(fold, biases=biases, touched=True)
    context = replace(context, fold=fold)
    lowering: dict[Side, Lowering] = {}
    stated = fold.planned_layer(plan)
    contacts = context.need(_descend(cell, attempt, fold, settings, lowering, stated))
    monitor = FingertipForceMonitor(cell.hands, fold.biases)
    # tips that are pushed into the upper layers would take the layers below them, too
    to_table = all(attempt.grasp_of(s).whole_stack(stated) for s in fold.biases)
    if to_table:
        heights = {s: _table_height(cell, attempt.motion.postures[s], c) for s, c in contacts.items()}
        fold = replace(fold, table_contact={**fold.table_contact, **heights})
    failure = _push(cell, partial(_pushed_height, cell, attempt, fold, stated), lowering, monitor)
    record: dict[str, object] = {
        "contact_height_m": {s.value: c.height for s, c in contacts.items()},
        "contact_by": {s.value: c.by for s, c in contacts.items()},
        "strongest_push_n": monitor.strongest,
    }
    context.require(failure, record)
    thickness, error = _layer_thickness(context, plan.garment, settings)
    counting = replace(settings, thickness_error=error)
    expected = {s: _expected(attempt.grasp_of(s), stated, thickness) for s in fold.biases}
    state = cell.ports.arms.state()
    upper = _upper_layers(cell, attempt, fold, stated, lowering)
    closed = close_and_confirm(cell, fold.biases, expected, counting, upper)
    if closed.failure and to_table:
        closed = Outcome(failure=_with_standing(cell, attempt, fold, stated, state, closed.failure))
    if upper.grips:
        record["held_before"] = {s.value: [[g.height, g.layers] for g in t] for s, t in upper.grips.items()}
    held = context.need(closed, record)
    planned = {s: attempt.grasp_of(s).layers for s in held}
    record["held"] = {
        s.value: {"grip_n": h.grip, "opening_m": h.opening, "layers": h.count.layers, "planned": planned[s]}
        for s, h in held.items()
    }
    # a pleat between the pads of one hand is not taken for thick fabric
    exact = [s for s, h in held.items() if h.count.layers == planned[s]] or list(held)
    measured = float(np.mean([(held[s].opening - settings.empty_opening) / planned[s] for s in exact]))
    fold = replace(fold, held=held, layer_thickness=measured)
    return Result(Event.DONE, replace(context, fold=fold), {**record, "layer_thickness_m": measured})


def _descend(
    cell: Workcell,
    attempt: Attempt,
    fold: FoldContext,
    settings: GraspSettings,
    lowering: dict[Side, Lowering],
    thickness: float,
) -> Outcome[dict[Side, Contact]]:
    """Lower the hands until their tips touch. lowering: filled here with the set-point of each descending hand;
    `_push` continues from these set-points. thickness: of a layer, as stated [m]."""

    def begin(start: JointState) -> Motion[dict[Side, Contact]]:
        descending = {}
        for s, descent in attempt.motion.descend.items():
            lowering[s] = Lowering(descent, cell.hands.height(s, start.q))
            lowest = lowering[s].top - float(descent.depth[-1])
            table, tactile = fold.table_contact.get(s, 0.0), cell.settings.grasp.tactile
            goal = _goal(attempt.grasp_of(s), lowest, tactile, thickness, table, _shift(fold))
            state = start_descent(settings, goal, fold.biases[s], cell.hands.read(s, start))
            descending[s] = GuardedHand(lowering[s], state)
        return guarded_descent(cell.hands, cell.last_command, start, descending)

    return cell.loop.run(begin)


def _goal(
    grasp: Grasp, lowest: float, tactile: bool, thickness: float, table: float = 0.0, shift: float = 0.0
) -> DescentGoal:
    """Return the heights at which a descent to `grasp` ends.

    Contact is expected on top of the stack under the hand. With tactile sensors, a descent without contact fails
    at the lowest height that the hand can reach, but not lower than 8 mm below the expected table. Without tactile
    sensors, it ends at the expected height of the table. If only upper layers are to be held, each `thickness` [m]
    thick, the descent ends at STOP in the lowest of them. It ends earlier if the cloth pushes harder than is
    needed to press it flat down to this height. A first touch does not end it, because it would stop on top of
    several thick layers. table: height at which this hand has felt the table [m]. shift: change of STOP by
    recoveries.
    """
    bottom = min(max(lowest, -0.008), grasp.height)
    whole = grasp.whole_stack(thickness)
    if whole:
        return DescentGoal(grasp.height, bottom, None if tactile else max(bottom, 0.0), through=grasp.height)
    stop = table + _height_in_stack(grasp, thickness, shift)
    return DescentGoal(grasp.height, min(bottom, stop), stop=stop, through=max(grasp.height + table - stop, 0.0))


def _shift(fold: FoldContext) -> float:
    """Return the change of STOP by recoveries, in layers."""
    return UP * fold.count(Adjustment.HIGHER) - DOWN * fold.count(Adjustment.LOWER)


def _height_in_stack(grasp: Grasp, thickness: float, shift: float) -> float:
    """Return the height above the table at which a hand takes only the upper layers [m]."""
    below = grasp.height / thickness - grasp.layers
    return max(below + min(STOP + shift, HIGHEST), LOWEST) * thickness


def _closed_below(cell: Workcell, attempt: Attempt, side: Side, thickness: float) -> float:
    """Return how far the lower tip is below the middle between the tips when the pads hold the planned layers
    [m]."""
    held = attempt.grasp_of(side).layers * thickness
    closed = cell.grasp.tip_distance - cell.settings.gripper.opening + held
    return lower_tip(closed, attempt.motion.postures[side].pitch)


def _table_height(cell: Workcell, posture: Posture, contact: Contact) -> float:
    """Return the height of the table as measured by the hand [m], from a contact with the table. A leaning hand
    touches the table with one tip. A descent that ended at its height is taken as one onto the table."""
    if contact.by == "height":
        return contact.height
    below = lower_tip(cell.grasp.tip_distance, posture.pitch)
    return contact.height - below + yielding(contact.force, tips=1 if below > LEANING else 2)


def _pushed_height(
    cell: Workcell, attempt: Attempt, fold: FoldContext, thickness: float, side: Side, touched: float
) -> float:
    """Return the height to which a hand is pushed before it closes [m]. touched: its height after the descent [m].

    An upright hand that takes the whole stack goes a little below the contact; one that takes upper layers stays.
    A leaning hand stands on its lower tip, and the arm yields. It is pushed so far that, with closed pads, the
    middle between its tips stands on the table, or as high in the stack as wanted.
    """
    grasp, table = attempt.grasp_of(side), fold.table_contact.get(side, 0.0)
    whole, deeper = grasp.whole_stack(thickness), DEEPER * fold.count(Adjustment.LOWER)
    below = _closed_below(cell, attempt, side, thickness)
    if below <= LEANING:
        return touched - (PUSH + deeper if whole else 0.0)
    height = -deeper if whole else _height_in_stack(grasp, thickness, _shift(fold))
    return min(touched, table + to_stand_at(height, below))


def _with_standing(
    cell: Workcell, attempt: Attempt, fold: FoldContext, thickness: float, state: JointState, failure: Failure
) -> Failure:
    """Add to a failure of a hand how much too high it stood to take the lowest layer [m]; negative if it stood low
    enough. state: of the arms after the push."""
    side = failure.values.get("side")
    if side is None or not failure.values["layers"]:  # pads that closed on nothing say nothing about the layers
        return failure
    hand = Side(side)
    commanded = cell.hands.height(hand, state.q) - fold.table_contact[hand]
    stood = standing_height(commanded, _closed_below(cell, attempt, hand, thickness))
    return replace(failure, values={**failure.values, "too_high_m": stood - thickness})


def _push(
    cell: Workcell,
    height_of: Callable[[Side, float], float],
    lowering: Mapping[Side, Lowering],
    monitor: FingertipForceMonitor,
) -> Failure | None:
    """Move each hand further down, or up. height_of: (side, present height) -> height of the middle between its
    tips after the motion [m].

    Heights are measured from the contact of the first tip, because the table's height is known only to a few
    millimetres.
    """

    def begin(start: JointState) -> Motion[JointState]:
        strokes = {}
        for s, hand in lowering.items():
            depth, height = cell.hands.depth(s, hand.descent, start.q), cell.hands.height(s, start.q)
            strokes[s] = depth, depth + height - height_of(s, height)
        max_force = cell.grasp.press_force
        return push_down(cell.hands, cell.last_command, start, lowering, strokes, monitor, max_force)

    return cell.loop.run(begin).failure


def _upper_layers(
    cell: Workcell, attempt: Attempt, fold: FoldContext, thickness: float, lowering: Mapping[Side, Lowering]
) -> UpperLayers:
    """Return the hands that take only upper layers, and how they are moved."""

    below = {s: _closed_below(cell, attempt, s, thickness) for s in fold.biases}
    table = {s: fold.table_contact.get(s, 0.0) for s in fold.biases}

    def stands(side: Side) -> float:
        return standing_height(cell.hands.height(side, cell.ports.arms.state().q) - table[side], below[side])

    def move(heights: Mapping[Side, float]) -> Failure | None:
        goals = {s: table[s] + to_stand_at(height, below[s]) for s, height in heights.items()}
        monitor = FingertipForceMonitor(cell.hands, {s: fold.biases[s] for s in heights})
        return _push(cell, lambda side, _: goals[side], {s: lowering[s] for s in heights}, monitor)

    lowest = {s: LOWEST * thickness for s in fold.biases if not attempt.grasp_of(s).whole_stack(thickness)}
    return UpperLayers(stands, move, lowest, thickness)


def _layer_thickness(context: RunContext, garment: Garment, settings: GraspSettings) -> tuple[float, float]:
    """Return the thickness of a layer between the pads [m] and its relative error. It was measured in an earlier
    fold of this run, or for a repair also in this one. If not, it is the value of the garment's file, with the
    spread of the class of fabrics."""
    if isinstance(context.fold.repair, Repair) and context.measured_layer is not None:
        return garment.thickness_of(context.measured_layer), LEARNED_ERROR
    if context.layer_thickness is not None:
        return context.layer_thickness, LEARNED_ERROR
    stated = garment.material.thickness
    return stated, max(settings.thickness_error, garment.thickness_sigma(settings.thickness_error) / stated)


def _expected(grasp: Grasp, stated: float, thickness: float) -> Expectation:
    """Return the expected number of layers, each `thickness` [m] thick between the pads. It is the planned
    number. If the planned grasp, whose height follows from the `stated` thickness, holds the whole stack, more
    layers are also accepted."""
    return Expectation(thickness, grasp.layers, or_more=grasp.whole_stack(stated))
