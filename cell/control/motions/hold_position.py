"""Hold the arms in position as a motion, with the same checks as in any other motion."""

from __future__ import annotations

import numpy as np

from foldcell.cell.control.loop import ControlLoop
from foldcell.cell.control.motion import Motion, SetPoint, Tick, Watch
from foldcell.cell.control.set_points import LastCommand, blend
from foldcell.cell.control.ticks import TICK_S
from foldcell.robots.errors import Failure
from foldcell.robots.ports import JointState
from foldcell.skills.vocabulary import Outcome


def wait(loop: ControlLoop, seconds: float, watch: Watch | None = None) -> Failure | None:
    """Hold the arms for `seconds` of cell time. Ends early with a failure of the loop or of `watch`.

    If the arms' state is stale at the start, no set-points are sent, and the wait still runs. If the state is
    still stale when the next motion starts, that motion fails.
    """
    return loop.run(lambda start: stand(loop.last_command, start, seconds, watch), standing=True).failure


def stand(last_command: LastCommand, start: JointState, seconds: float, watch: Watch | None) -> Motion[JointState]:
    offset, state = last_command.offset(start.q), start
    for k in range(max(1, round(seconds / TICK_S))):
        state = (yield SetPoint(start.q + blend(k) * offset, np.zeros_like(start.q))).state
        failure = watch(Tick((k + 1) * TICK_S, state)) if watch else None
        if failure:
            return Outcome(failure=failure)
    return Outcome(state)
