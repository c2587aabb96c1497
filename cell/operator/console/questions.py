"""The texts beside the picture on the page: the question, the effect of each answer, and the plan's figures."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from foldcell.cell.record.words import capital, length, plain, sentences
from foldcell.cell.states.run_context import RunContext
from foldcell.cell.states.stages import Attempt, Plan, Repair, Spread
from foldcell.cell.states.transition_table import Event, State
from foldcell.skills.motion.validation.collision import BODY_MARGIN, TABLE_MARGIN

RECOGNISED = "Recognised"
"""Label of the fact that is also shown after the end of the run."""

HANDS_S = 6.0
"""Typical time of a fold's descents, grasps and releases, which is not known beforehand [s]."""
LOOK_S = 2.0
"""Typical time for taking the pictures after a fold [s]."""
PERCENTILE = 95.0
"""The height of a stack is this percentile of its vertices' heights, as in the score."""
UNPREDICTED = (
    "the garment lies in no known state, so the end of a pull cannot be predicted; the cell looks after it"
)


def question(state: State, context: RunContext) -> str:
    """Return the question that the cell asks in this state."""
    if state is State.ASKING:
        return _after_failure(context)
    fold, plan, attempt = context.fold, context.plan, context.fold.attempt
    this = capital(_step(plan, fold.index)) if plan and plan.steps else "The fold"
    if state is State.AWAITING_PRESSING:
        inspection = attempt.inspection if attempt else None
        height = f"{length(inspection.height_m, 0)} high" if inspection else "too high"
        return f"{this}. The fold is made and is {height}. Press it flat? Skip leaves it as it is."
    if attempt is None:
        return f"{this}."
    if isinstance(fold.repair, Spread):
        why = UNPREDICTED if not fold.repair.home else "the garment lies flat, but not where it was laid"
        return sentences(this, why, fold.repair.in_words())
    if fold.repair is not None:
        return f"{this}. The fold is not as planned and can be repaired: {fold.repair.in_words()}."
    change = ""
    if fold.refused_edit:
        change = f"your change is not possible ({fold.refused_edit}); this is the plan without it"
    elif fold.edits:
        change = f"changed: {fold.edits[-1].in_words()}"
    source = "taken from the library" if attempt.trajectory.source == "library" else "optimised now"
    error = attempt.dissimilarity_m
    far = f"; its predicted mean distance from the ideal fold is {length(error)}" if error >= 0.0 else ""
    return sentences(change, this, f"the arc was {source}{far}")


def _after_failure(context: RunContext) -> str:
    if context.failure is None:
        return "How should the run continue?"
    why = f"the cell asks because {context.asking}" if context.asking else ""
    limit = f"the limit is {context.setting}" if context.setting else ""
    lay = "before the cell looks again, lay the garment as it was before this fold" if context.steps else ""
    return sentences(context.failure.what, why, context.failure.hint, limit, lay)


def plan_facts(context: RunContext) -> list[tuple[str, str]]:
    """Return (label, value) for the planned fold; empty before there is a plan."""
    plan, fold = context.plan, context.fold
    if plan is None or not plan.steps:
        return []
    facts = [("Now", _step(plan, fold.index))]
    following = fold.index + 1
    facts.append(
        (
            "Next",
            _step(plan, following) if following < len(plan.steps) else "the fold is inspected; then the run ends",
        )
    )
    if context.recognition is not None:
        facts.append((RECOGNISED, context.recognition.in_words()))
    if fold.attempt is not None:
        facts += _attempt_facts(context, plan, fold.attempt)
    return facts


_END = "the hands let go, the arms park, and the run ends as not folded"
_LEFT_OUT = "this fold is not made; the run goes on and ends as not folded"
_CONSEQUENCES: Mapping[State, Mapping[Event, str]] = {
    State.AWAITING_APPROVAL: {
        Event.APPROVE: "the arms go to the garment and make this fold",
        Event.RETRY: "the cell looks and plans this fold again",
        Event.SKIP: _LEFT_OUT,
        Event.ABORT: _END,
    },
    State.AWAITING_PRESSING: {
        Event.APPROVE: "the hands press the crease",
        Event.RETRY: "the cell looks and inspects the fold again",
        Event.SKIP: "the fold stays as it is and is inspected",
        Event.ABORT: _END,
    },
    State.ASKING: {
        Event.RETRY: "the cell looks and makes this fold again: first lay the garment as it was before this fold",
        Event.SKIP: _LEFT_OUT,
        Event.ABORT: _END,
    },
}


def consequences(state: State, planned: bool, repair: Repair | Spread | None) -> Mapping[Event, str]:
    """Return the effect of each command that answers the question of a state: command -> text. Empty for a state
    without a question. planned: whether folds were planned. repair: planned repair of the present fold, or
    None."""
    if state is State.AWAITING_APPROVAL and repair is not None:
        again = "the cell looks again how the garment lies, and plans anew"
        return {Event.APPROVE: repair.in_words(), Event.RETRY: again, Event.ABORT: _END}
    if state is State.ASKING and not planned:
        return {**_CONSEQUENCES[state], Event.RETRY: "the cell looks at the table again"}
    return _CONSEQUENCES.get(state, {})


def _attempt_facts(context: RunContext, plan: Plan, attempt: Attempt) -> list[tuple[str, str]]:
    repair = context.fold.repair
    source = "from the library" if attempt.trajectory.source == "library" else "optimised in this run"
    height = float(np.percentile(attempt.predicted.vertices[:, 2], PERCENTILE))
    facts = [("Arc", source) if repair is None else ("Repair", repair.in_words())]
    if attempt.dissimilarity_m >= 0.0:
        aim = "the ideal fold" if repair is None else "the shape that is aimed at"
        facts.append(("Predicted error", f"{length(attempt.dissimilarity_m)} mean distance from {aim}"))
    if not isinstance(repair, Spread):  # a pull is not simulated
        facts.append(("Predicted height", length(height, 0)))
    facts.append(
        (
            "Clearance",
            f"the arms keep {length(BODY_MARGIN, 0)} from the robot, {length(TABLE_MARGIN, 0)} from the table",
        )
    )
    this = attempt.motion.duration + HANDS_S + LOOK_S
    left = this * (len(plan.steps) - context.fold.index)
    facts.append(("Time", f"about {this:.0f} s for this fold, {left:.0f} s to the end"))
    if context.recoveries_in_step:
        facts.append(("Attempts", f"{context.recoveries_in_step} failed before this one"))
    return facts


def _step(plan: Plan, index: int) -> str:
    step = plan.steps[index]
    name = ", ".join(plain(word) for word in (step.name, step.variant) if word)
    return f"fold {index + 1} of {len(plan.steps)}: {name}"
