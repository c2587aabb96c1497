"""The effect that opens the pads just wide enough to release the garment."""

from __future__ import annotations

from dataclasses import replace

from foldcell.cell.control.motions.hands import commanding, each_hand
from foldcell.cell.executive.effects.recovery.parking import RELEASE_OPENING
from foldcell.cell.hardware.workcell import Workcell
from foldcell.cell.states.run_context import Result, RunContext, effect
from foldcell.cell.states.stages import Attempt
from foldcell.cell.states.transition_table import Event
from foldcell.skills.grasping.release import release, start_release

__all__ = ["release_garment"]


@effect
def release_garment(cell: Workcell, context: RunContext, attempt: Attempt) -> Result:
    """Open the pads just wide enough to release the garment."""
    context, hands, repair = context.with_attempt(replace(attempt, carried=True)), cell.hands, context.fold.repair
    state = cell.ports.arms.state()
    states = {s: start_release(RELEASE_OPENING, hands.read(s, state)) for s in context.fold.held}
    context.need(each_hand(cell.loop, hands, states, commanding(hands, release)))
    if repair is not None:
        made = (context.fold.index, f"{repair.name}: {repair.in_words()}")
        context = replace(context, repairs=(*context.repairs, made))
    return Result(Event.DONE, replace(context, fold=replace(context.fold, held={})))
