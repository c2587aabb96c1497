"""Press hands down before a grasp, as a motion: they move down from the contact, and brake if the force on a tip
is too large."""

from __future__ import annotations

from collections.abc import Mapping

from cell.control.last_command import LastCommand, blend
from cell.control.motion import Motion, SetPoint, Tick
from cell.control.motions.fingertip_force_monitor import FingertipForceMonitor
from cell.control.motions.hands import Hands
from cell.control.motions.lowering import Lowering, lowered_joints
from cell.control.ticks import TICK_S
from robots.ports import JointState, Side
from skills.vocabulary import Outcome

__all__ = ["push_down"]

PUSH_S = 0.4


def push_down(
    hands: Hands,
    last_command: LastCommand,
    start: JointState,
    lowering: Mapping[Side, Lowering],
    strokes: Mapping[Side, tuple[float, float]],
    monitor: FingertipForceMonitor,
    max_force: float,
) -> Motion[JointState]:
    """Press the hands of `lowering` down. A hand brakes if the force on one of its tips exceeds `max_force`. The
    motion ends after PUSH_S, or with a failure of `monitor`.

    lowering: set-point of each hand; the motion changes it. strokes: (start, end) depth of each hand [m].
    max_force: limit of the force on a tip [N].
    """
    last, state, record = start.q + last_command.offset(start.q), start, hands.recording()
    braking: dict[Side, float] = {}
    """Depth at which a braking hand comes to rest [m]."""
    for k in range(1, round(PUSH_S / TICK_S) + 1):
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
