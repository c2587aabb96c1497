"""Guarded descent as a motion: hands move straight down until their fingertips touch."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

from cell.control.last_command import LastCommand
from cell.control.motion import Motion
from cell.control.motions.hands import Hands, control_hands
from cell.control.motions.lowering import Lowering, lowered_joints
from cell.control.ticks import TICK_S
from robots.ports import Array, JointState, Side
from skills.grasping.descend import Contact, DescentState, descend
from skills.grasping.hand_reading import HandReading
from skills.vocabulary import Outcome

__all__ = ["GuardedHand", "guarded_descent"]


@dataclass(frozen=True, eq=False)
class GuardedHand:
    """A descending hand: its set-point (`lowering`) and the initial state of its controller."""

    lowering: Lowering
    state: DescentState


def guarded_descent(
    hands: Hands,
    last_command: LastCommand,
    start: JointState,
    descending: Mapping[Side, GuardedHand],
    settles: bool = False,
    felt: Callable[[HandReading], None] = lambda reading: None,
) -> Motion[dict[Side, Contact]]:
    """Lower the hands until all have touched or one has failed. skills.grasping.descend controls each hand.

    settles: if true, a hand ends only when its set-point has come to rest at the height of contact. If false, a
    hand ends at its contact, and its set-point moves to the measured height while the other hand still descends.
    felt: called with every reading up to the contact.
    """
    lowering = {side: hand.lowering for side, hand in descending.items()}
    goals = {side: (hand.state.target, 0.0) for side, hand in descending.items()}
    """Goal of each hand: (height [m], downward speed [m/s])."""
    ended: dict[Side, Outcome[Contact]] = {}
    q0 = start.q + last_command.offset(start.q)

    def control(side: Side, reading: HandReading, before: DescentState) -> DescentState | Outcome[Contact]:
        if side in ended:
            return ended[side] if lowering[side].rests else before
        felt(reading)
        command, after = descend(reading, before)
        if not isinstance(after, Outcome):
            goals[side] = command.height, (goals[side][0] - command.height) / TICK_S
            return after
        goals[side] = lowering[side].height if settles else command.height, 0.0
        if not settles:
            return after
        ended[side] = after
        return before

    def arms() -> Array:
        for side, (height, speed) in goals.items():
            lowering[side].follow(lowering[side].top - height, speed)
        return lowered_joints(q0, lowering)

    states = {side: hand.state for side, hand in descending.items()}
    return (yield from control_hands(hands, last_command, start, states, control, arms))
