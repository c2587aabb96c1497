"""Follow a checked trajectory as a motion, which can pause anywhere on its path."""

from __future__ import annotations

import numpy as np

from cell.control.last_command import blend
from cell.control.loop import ControlLoop
from cell.control.motion import Motion, Order, SetPoint, Tick, Watch
from cell.control.path_clock import PathClock, PathControl
from cell.control.ticks import TICK_S
from robots.ports import ArmTrajectory, JointState
from skills.vocabulary import Outcome

__all__ = ["follow", "stream"]


def stream(
    loop: ControlLoop, trajectory: ArmTrajectory, watch: Watch | None, control: PathControl
) -> Outcome[JointState]:
    """Execute the trajectory. Returns the state in which the arms came to rest.

    A pause slows the motion's clock to a stop, so that the arms rest on the path. `watch` is also called during
    the pause. A resume command continues the motion, if nobody has moved the arms meanwhile. A failure of `watch`,
    a stale state and an abort also bring the arms to rest on the path before the motion ends. Failures: those of
    the loop and of `watch`.
    """
    return loop.run(lambda _: follow(loop, trajectory, watch, control), control)


def follow(
    loop: ControlLoop, trajectory: ArmTrajectory, watch: Watch | None, control: PathControl
) -> Motion[JointState]:
    """Follow the trajectory. The motion ends when the arms are within `settled` of the trajectory's last point, at
    the latest settle_s after the trajectory's end."""
    path, offset = PathClock(trajectory, control), loop.last_command.offset(trajectory.q[0])
    settling, failure, k = 0.0, None, 0
    while True:
        q, qd = path.setpoint()
        feedback = yield SetPoint(q + blend(k) * offset, qd, trajectory.q[0], path.t, path.resting, failure)
        k += 1
        if feedback.order is Order.REST:
            path.stop()
        if feedback.order is Order.GO:
            path.go()
        arrived = path.arrived
        if not (feedback.late and path.begin_again()):
            path.advance()
        if not feedback.fresh:
            continue
        failure = watch(Tick(path.t, feedback.state)) if watch else None  # also while the motion comes to rest
        settling += TICK_S if arrived and not failure else 0.0
        error = float(np.abs(feedback.state.q - trajectory.q[-1]).max())
        settled = error < loop.limits.settled or settling >= loop.limits.settle_s
        if arrived and settled and not failure:
            return Outcome(feedback.state)
