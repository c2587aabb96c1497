"""What the cell did after a failure, in words."""

from __future__ import annotations

from collections.abc import Mapping

from cell.states.recovery_table import Adjustment, Laying
from cell.states.transition_table import Event

__all__ = ["laying_in_words", "recovery_in_words"]

_EVENTS: Mapping[Event, str] = {
    Event.START_OVER: "photographed the empty table again",
    Event.LOOK_AGAIN: "looked again",
    Event.LOOK_AFTER: "looked at the fold again",
    Event.PLAN_AGAIN: "planned the fold again",
    Event.OPTIMISE_AGAIN: "chose another arc",
    Event.GRASP_AGAIN: "planned the motion again, to grasp again",
    Event.REPAIR: "planned to put the moved cloth right",
    Event.SPREAD: "planned to spread the garment by a pull",
    Event.CARRY_ON: "went on: the next fold can build on it",
    Event.ASK: "asked the operator",
    Event.GIVE_UP: "ended the run",
}
_CHANGES: Mapping[Adjustment, str] = {
    Adjustment.LOWER: "with the tips pressed deeper",
    Adjustment.HIGHER: "with the tips less deep",
    Adjustment.INWARD: "with the grasp further inside the edge",
    Adjustment.STRONGER: "with a firmer grip",
    Adjustment.OPTIMISE: "optimised for this fold",
    Adjustment.PLAIN_ARC: "a plain arc",
    Adjustment.OTHER_SEARCH: "by another motion of the arms",
    Adjustment.OTHER_VARIANT: "by another fold variant of the garment file",
}
_LAYINGS: Mapping[Laying, str] = {
    Laying.BACK: "laid the cloth down where it was taken",
    Laying.ONWARD: "laid the cloth down at its target",
    Laying.RELEASE: "opened the hands where they were: they held no cloth",
}


def recovery_in_words(event: Event, record: Mapping[str, object]) -> str:
    """Return a recovery in words. record: the figures of the effect that chose it: `change`, and `reason` where
    the operator was asked or the run ended."""
    said = _EVENTS.get(event, event.value.replace("_", " "))
    if record.get("reason"):
        return f"{said}: {record['reason']}"
    change = Adjustment(str(record.get("change", Adjustment.NONE.value)))
    return f"{said}, {_CHANGES[change]}" if change in _CHANGES else said


def laying_in_words(record: Mapping[str, object]) -> str:
    """Return in words what the hands did with the cloth that they held. record: the figures of that effect."""
    return _LAYINGS[Laying(str(record["laying"]))] if "laying" in record else "laid the cloth down"
