"""Follow a checked trajectory as a motion, which can pause anywhere on its path."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from foldcell.cell.control.checks import SETTLE_S, SETTLED, start_mismatch
from foldcell.cell.control.loop import ControlLoop
from foldcell.cell.control.motion import Motion, Order, SetPoint, Tick, Watch
from foldcell.cell.control.path_clock import PathClock, PathControl
from foldcell.cell.control.set_points import blend
from foldcell.cell.control.ticks import TICK_S
from foldcell.robots.ports import ArmTrajectory, JointState
from foldcell.skills.vocabulary import Outcome

OFF_PATH = 0.04
"""Arms that have come to rest without set-points are at most this far from the path [rad]. The joints brake
independently of each other, which leads arms at full speed off the path by about 0.02 rad."""


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
    the latest settle_s after the trajectory's end.

    After a tick that came so late that the arms have come to rest, the motion continues from where they stand. It
    ends with START_MISMATCH if they do not stand on the path.
    """
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
        if not feedback.late or path.resting:
            path.advance()
        elif feedback.fresh:
            joined = path.rejoin(feedback.state.q)
            offset, k, arrived = feedback.state.q - joined, 0, False
            failure = start_mismatch(feedback.state, joined, replace(loop.limits, start=OFF_PATH))
            if failure:
                path.rest()
                continue
        else:  # nothing is sent to arms whose position is unknown
            path.rest()
        if not feedback.fresh:
            continue
        failure = watch(Tick(path.t, feedback.state)) if watch else None  # also while the motion comes to rest
        settling += TICK_S if arrived and not failure else 0.0
        error = float(np.abs(feedback.state.q - trajectory.q[-1]).max())
        settled = error < SETTLED or settling >= SETTLE_S
        if arrived and settled and not failure:
            return Outcome(feedback.state)
