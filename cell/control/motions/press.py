"""Pressing to take hold as a motion: hands go down from their touch, no deeper once a tip is pushed too hard."""

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

__all__ = ["press_down"]

PRESS_S = 0.4


def press_down(
    hands: Hands,
    last_command: LastCommand,
    start: JointState,
    lowering: Mapping[Side, Lowering],
    strokes: Mapping[Side, tuple[float, float]],
    pushes: FingertipForceMonitor,
    most: float,
) -> Motion[JointState]:
    """lowering: where each hand's set-point is, kept up to date. strokes: from which depth to which [m]. most:
    push on a tip after which its hand brakes [N].

    Ends after PRESS_S, or with the failure of what reads the tips.
    """
    last, state, record = start.q + last_command.offset(start.q), start, hands.recording()
    enough: dict[Side, float] = {}
    """The depth at which each hand brakes that is pushed hard enough [m]."""
    for k in range(1, round(PRESS_S / TICK_S) + 1):
        left, left_before = blend(k, PRESS_S), blend(k - 1, PRESS_S)
        for side, hand in lowering.items():
            way = strokes[side][1] - strokes[side][0]
            depth, speed = strokes[side][1] - left * way, (left_before - left) * way / TICK_S
            hand.follow(enough.get(side, depth), 0.0 if side in enough else speed)
        q = lowered_joints(last, lowering)
        state = (yield SetPoint(q, (q - last) / TICK_S)).state
        last = q
        record(Tick(k * TICK_S, state))
        bad = pushes.look(state)
        if bad:
            return Outcome(failure=bad)
        for side, push in pushes.now.items():
            if push > most:
                enough.setdefault(side, lowering[side].brakes_at)
    return Outcome(state)
