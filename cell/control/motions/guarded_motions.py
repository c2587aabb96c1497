"""Guarded motions: hands move straight down until their fingertips touch, and push down before a grasp.

The force on each fingertip is monitored: it ends a descent, and brakes a push that is too hard.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import numpy as np

from foldcell.cell.control.motion import Motion, SetPoint, Tick
from foldcell.cell.control.motions.hands import Hands, control_hands
from foldcell.cell.control.set_points import LastCommand, blend
from foldcell.cell.control.ticks import TICK_S
from foldcell.robots.errors import Failure
from foldcell.robots.ports import Array, JointState, Side, arm_slice
from foldcell.skills.grasping.descend import Contact, DescentState, descend
from foldcell.skills.grasping.hand_reading import HandReading, validate_reading
from foldcell.skills.grasping.tare import TactileBias
from foldcell.skills.motion.moves.grasp import Descent
from foldcell.skills.motion.timing.jerk_limiter import JerkLimiter, step_towards
from foldcell.skills.vocabulary import Outcome

HAND_SPEED, HAND_ACCELERATION, HAND_JERK = 0.4, 0.6, 12.0
"""Limits of the set-point: speed [m/s], acceleration [m/s2], jerk [m/s3]."""


@dataclass(eq=False)
class Lowering:
    """Set-point of one descending hand. descent: the joints as a function of depth; top: height of depth 0 above
    the table [m]; hand: depth of the set-point [m], with its speed and acceleration."""

    descent: Descent
    top: float
    hand: JerkLimiter = field(default_factory=lambda: JerkLimiter(0.0))

    @property
    def height(self) -> float:
        """Height of the set-point above the table [m]."""
        return self.top - self.hand.position

    @property
    def rests(self) -> bool:
        return abs(self.hand.velocity) < 1e-4 and abs(self.hand.acceleration) < 1e-2

    @property
    def brakes_at(self) -> float:
        """Approximate depth at which the set-point would come to rest if it braked now [m]."""
        v = self.hand.velocity
        return self.hand.position + 0.5 * v * (abs(v) / HAND_ACCELERATION + HAND_ACCELERATION / HAND_JERK)

    def follow(self, depth: float, speed: float) -> None:
        """Advance the set-point by one tick towards `depth` [m], a goal that grows at `speed` [m/s]."""
        self.hand = step_towards(
            self.hand, depth, speed, TICK_S, speed=HAND_SPEED, acceleration=HAND_ACCELERATION, jerk=HAND_JERK
        )


def lowered_joints(q: Array, hands: Mapping[Side, Lowering]) -> Array:
    """Return q (joints,) [rad], in which the joints of each lowered arm are those at the depth of its
    set-point."""
    q = np.array(q)
    for side, hand in hands.items():
        q[arm_slice(side, len(q))] = hand.descent.at(hand.hand.position)
    return q


class FingertipForceMonitor:
    """Monitors the forces on the fingertips of hands that push or press.

    biases: tactile bias of each hand. now: largest force on a tip of each hand in its latest reading [N].
    strongest: largest force on a tip in all readings so far [N].
    """

    def __init__(self, hands: Hands, biases: Mapping[Side, TactileBias]) -> None:
        self._hands, self._biases = hands, biases
        self.now = dict.fromkeys(biases, 0.0)
        self.strongest = 0.0

    def look(self, state: JointState) -> Failure | None:
        """Read the tip forces of all hands. Returns a failure if a force cannot be measured."""
        for side, bias in self._biases.items():
            reading = self._hands.read(side, state)
            failure = validate_reading(reading)
            if failure:
                return failure
            self.now[side] = float(np.max(reading.tactile.tip - bias.tip))
            self.strongest = max(self.strongest, self.now[side])
        return None


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


PUSH_S = 0.4
LONGEST_PUSH_S = 1.0
"""Least and largest duration of a push [s]. A set-point that its limits delay is waited for."""


def push_down(
    hands: Hands,
    last_command: LastCommand,
    start: JointState,
    lowering: Mapping[Side, Lowering],
    strokes: Mapping[Side, tuple[float, float]],
    monitor: FingertipForceMonitor,
    max_force: float,
) -> Motion[JointState]:
    """Push the hands of `lowering` down, or raise those whose stroke ends at a smaller depth. A hand brakes if the
    force on one of its tips exceeds `max_force`. The motion ends when the set-points have come to rest, or with a
    failure of `monitor`.

    lowering: set-point of each hand; the motion changes it. strokes: (start, end) depth of each hand [m].
    max_force: limit of the force on a tip [N].
    """
    last, state, record = start.q + last_command.offset(start.q), start, hands.recording()
    braking: dict[Side, float] = {}
    """Depth at which a braking hand comes to rest [m]."""
    for k in range(1, round(LONGEST_PUSH_S / TICK_S) + 1):
        if k * TICK_S > PUSH_S + 0.5 * TICK_S and all(hand.rests for hand in lowering.values()):
            break
        left, left_before = blend(k, PUSH_S), blend(k - 1, PUSH_S)
        for side, hand in lowering.items():
            stroke = strokes[side][1] - strokes[side][0]
            depth, speed = strokes[side][1] - left * stroke, (left_before - left) * stroke / TICK_S
            hand.follow(braking.get(side, depth), 0.0 if side in braking else speed)
        q = lowered_joints(last, lowering)
        state = (yield SetPoint(q, (q - last) / TICK_S)).state
        last = q
        record(Tick(k * TICK_S, state))
        failure = monitor.look(state)
        if failure:
            return Outcome(failure=failure)
        for side, force in monitor.now.items():
            if force > max_force:
                braking.setdefault(side, lowering[side].brakes_at)
    return Outcome(state)
