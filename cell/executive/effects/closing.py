"""Close the pads of hands that stand in the garment, and count the layers that they hold.

A hand that is to take only upper layers, and holds too many or too few, opens and closes again at another height:
what it held shows where.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, field

from foldcell.cell.control.motions.hands import commanding, each_hand
from foldcell.cell.hardware.workcell import Workcell
from foldcell.robots.errors import Failure, FailureKind
from foldcell.robots.ports import Side
from foldcell.skills.grasping.close import close, start_close
from foldcell.skills.grasping.confirm import Confirmation, Expectation, Held, confirm
from foldcell.skills.grasping.hand_reading import HandReading
from foldcell.skills.grasping.release import release, start_release
from foldcell.skills.grasping.settings import GraspSettings
from foldcell.skills.grasping.tare import TactileBias
from foldcell.skills.grasping.upper_layers import Grip, next_height
from foldcell.skills.vocabulary import Outcome, refuse, skill

REGRIPS = 4
"""Largest number of times that a hand closes again in one grasp."""
NO_LOWER = 0.0001
"""A hand within this of its least height is not lowered again [m]."""
_MISCOUNTED = frozenset({FailureKind.MISSED_GRASP, FailureKind.MISSED_LAYER})


@dataclass(frozen=True, eq=False)
class UpperLayers:
    """Hands that take only upper layers. stands: height of a hand above the table [m]. move: moves hands to these
    heights. lowest: least height of each hand [m]; thickness: of a layer [m]. grips: what each hand has held
    wrongly, filled while it closes."""

    stands: Callable[[Side], float]
    move: Callable[[Mapping[Side, float]], Failure | None]
    lowest: Mapping[Side, float]
    thickness: float
    grips: dict[Side, tuple[Grip, ...]] = field(default_factory=dict)

    def next_height(self, side: Side, failure: Failure) -> float:
        """Note what a hand holds. Return where it closes next [m]; raises Failed if no other height will do."""
        planned, layers = (int(failure.values[name]) for name in ("layers_expected", "layers"))
        if failure.kind is FailureKind.MISSED_GRASP:  # it may feel no force although its pads do not meet
            layers = min(layers, planned - 1)
        grips = self.grips[side] = (*self.grips.get(side, ()), Grip(self.stands(side), layers))
        height = next_height(grips, planned, self.thickness) if len(grips) <= REGRIPS else None
        at_bottom = grips[-1].height < self.lowest[side] + NO_LOWER
        if height is None or (height <= self.lowest[side] and at_bottom):
            refuse(failure)
        assert height is not None
        return max(height, self.lowest[side])


@skill
def close_and_confirm(
    cell: Workcell,
    biases: Mapping[Side, TactileBias],
    expected: Mapping[Side, Expectation],
    settings: GraspSettings,
    upper: UpperLayers,
) -> Outcome[dict[Side, Held]]:
    """Close the hands and count the layers that they hold. A hand that takes only upper layers closes again at
    other heights until it holds the expected ones; a hand that holds its layers waits meanwhile.

    Failures: those of the first hand that does not come to hold its layers.
    """
    held: dict[Side, Held] = {}
    waiting = dict(biases)
    while waiting:
        counted = _count(cell, waiting, expected, settings, upper.lowest.keys()).unwrap()
        held |= {side: found.unwrap() for side, found in counted.items() if found.ok}
        goals = {s: upper.next_height(s, found.failure) for s, found in counted.items() if found.failure}
        waiting = {side: biases[side] for side in goals}
        if goals:
            refuse(_open(cell, goals.keys()) or upper.move(goals))
    return Outcome(held)


def _count(
    cell: Workcell,
    biases: Mapping[Side, TactileBias],
    expected: Mapping[Side, Expectation],
    settings: GraspSettings,
    upper: Collection[Side],
) -> Outcome[dict[Side, Outcome[Held]]]:
    """Close hands and count. A wrong number of layers in the hands `upper` is not a failure of the whole."""
    hands, state = cell.hands, cell.ports.arms.state()
    states = {s: start_close(settings, bias, hands.read(s, state)) for s, bias in biases.items()}
    refuse(each_hand(cell.loop, hands, states, commanding(hands, close)).failure)

    def counting(side: Side, reading: HandReading, before: Confirmation) -> Confirmation | Outcome[Outcome[Held]]:
        after = confirm(reading, before)
        if isinstance(after, Confirmation):
            return after
        ends = after.failure is not None and not (side in upper and after.failure.kind in _MISCOUNTED)
        return Outcome(failure=after.failure) if ends else Outcome(after)

    confirmations = {s: Confirmation(settings, bias, expected[s]) for s, bias in biases.items()}
    return each_hand(cell.loop, hands, confirmations, counting)


def _open(cell: Workcell, sides: Collection[Side]) -> Failure | None:
    """Open hands as wide as for an approach."""
    hands, state = cell.hands, cell.ports.arms.state()
    wide = cell.settings.gripper.opening
    states = {side: start_release(wide, hands.read(side, state)) for side in sides}
    return each_hand(cell.loop, hands, states, commanding(hands, release)).failure
