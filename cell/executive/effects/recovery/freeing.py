"""Leave the garment after the release. If cloth stays on a finger: back down, close and open the hand, leave
again."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from foldcell.cell.control.checks import come_to_rest
from foldcell.cell.control.motion import Tick, Watch
from foldcell.cell.control.motions.hands import each_hand
from foldcell.cell.control.motions.hold_position import wait
from foldcell.cell.control.path_clock import PathControl
from foldcell.cell.executive.effects.checked_motion import move
from foldcell.cell.executive.effects.recovery.parking import LET_GO, OPENING_S, RELEASE_OPENING, still_closed
from foldcell.cell.executive.effects.recovery.ways_out import FREEING, FREEING_TRIES, Course, along, lead_out
from foldcell.cell.hardware.workcell import Workcell
from foldcell.robots.errors import DriverError, Failure, FailureKind
from foldcell.robots.ports import ArmTrajectory, Side
from foldcell.skills.grasping.empty_hand import EmptyCheck, check_empty
from foldcell.skills.grasping.hand_reading import GripCommand, HandReading
from foldcell.skills.grasping.release import RELEASE_FORCE, RELEASE_TOLERANCE
from foldcell.skills.grasping.stuck_on_finger import (
    Clear,
    DragWatch,
    StuckCheck,
    check_stuck,
    watch_drag,
)
from foldcell.skills.grasping.tare import TactileBias
from foldcell.skills.motion.moves.lift import CAREFUL_SPEED
from foldcell.skills.motion.moves.retreat import Retreat
from foldcell.skills.vocabulary import Outcome

FREEING_SPEED = 0.25
"""Maximum speed of the tools while cloth may hang on a finger [m/s]."""
ABOVE = 0.008
"""Height above the release at which the hands begin to close [m]. By the time the pads come near each other, the
hands have risen by 20 mm and are above the cloth that they have released."""
ABOVE_CREASE = 0.013
"""The same, where a crease of an earlier fold may stand up beside the pads [m]. From ABOVE, hands took one of its
layers along in 6 of 140 runs without a fault, all of towels, after their second fold. Five of the six were
performed again from here: one did so. From 18 mm, cloth on a finger was felt only after a lift of 52 to 59 mm, and
two of four such folds were spoilt (from here 42 to 45 mm, and none)."""
LEAST_RISE = 0.03
"""A hand that rises less than this does not close, because it might take cloth of the stack [m]."""
WIDEST = RELEASE_OPENING + 0.005
"""A hand that is open wider than this has pressed a crease, which may stand up between its pads [m]."""
WEIGHED = 0.03
"""The weight on the pads is measured in this last part of the rise, where the hands slow down [m]."""

Check = EmptyCheck | StuckCheck


@dataclass(frozen=True)
class ReleasedCloth:
    """layer: smallest thickness of a layer between the pads [m]. creased: whether a crease of an earlier fold may
    stand up beside the pads."""

    layer: float
    creased: bool


def leave_freely(
    cell: Workcell,
    way: Retreat,
    biases: Mapping[Side, TactileBias],
    cloth: ReleasedCloth,
    control: PathControl,
) -> Outcome[tuple[Mapping[str, object], ...]]:
    """Lead the hands up and to the parked posture, and check that no cloth stays on a finger. While the hands
    rise, they close and open in the air. Above the garment, the weight on the pads is measured. The check goes on
    while they move away, because light cloth on the outside of a finger is felt only when it drags the garment
    along.

    If cloth stays on a finger, the hands go back along the same way, so that the cloth lies about as it was
    released. The caught hand closes and opens there, and both leave again.

    Returns figures for each time that cloth was felt. Failures: STUCK_ON_FINGER after FREEING_TRIES, those of the
    motions.
    """
    up, home = way.retreat, way.park
    felt: list[Mapping[str, object]] = []
    failure = _rise(cell, up, biases, cloth, control) or move(
        cell, home, control=control, watch=_dragging(cell, biases)
    )
    for _ in range(FREEING_TRIES):
        if failure is None or failure.kind is not FailureKind.STUCK_ON_FINGER:
            break
        caught = tuple(side for side in biases if side == failure.values.get("side"))
        risen = max((_risen(cell, up, side) for side in caught), default=0.0)
        felt.append({**failure.values, "risen_m": risen})
        cell.tell(f"{failure.what}: the hand goes back down, closes and opens")
        failure = (
            _lead(cell, Course(np.vstack([up.q, home.q])[::-1], FREEING_SPEED), control)
            or _close_and_open(cell, caught)
            or _rise_again(cell, up, biases, cloth, control)
            or _lead(cell, Course(home.q, FREEING_SPEED, False, _dragging(cell, biases)), control)
        )
    return Outcome(failure=failure) if failure else Outcome(tuple(felt))


def _risen(cell: Workcell, up: ArmTrajectory, side: Side) -> float:
    """Return how far a hand stands above the place where it released the cloth [m]."""
    return cell.hands.height(side, cell.ports.arms.state().q) - cell.hands.height(side, up.q[0])


def _rise(
    cell: Workcell,
    up: ArmTrajectory,
    biases: Mapping[Side, TactileBias],
    cloth: ReleasedCloth,
    control: PathControl,
) -> Failure | None:
    """Rise, and check the hands on the way. They finish the checks at rest."""
    checks = _HandChecks(cell, biases, *_first_checks(cell, up, biases, cloth))
    return move(cell, up, fingertips=True, control=control, watch=checks.look) or checks.finish()


def _rise_again(
    cell: Workcell,
    up: ArmTrajectory,
    biases: Mapping[Side, TactileBias],
    cloth: ReleasedCloth,
    control: PathControl,
) -> Failure | None:
    unsettled = come_to_rest(cell.ports, cell.execution, cell.last_command)
    planned = along(cell, Course(up.q, CAREFUL_SPEED))
    failure = unsettled or planned.failure
    return failure or _rise(cell, planned.unwrap()[0][0], biases, cloth, control)


def _first_checks(
    cell: Workcell, up: ArmTrajectory, biases: Mapping[Side, TactileBias], cloth: ReleasedCloth
) -> tuple[dict[Side, Check], dict[Side, float]]:
    """Return the first check of each hand, and the height from which it is weighed [m]. A hand closes only if it
    rises far enough, and is open as after a release."""
    above = ABOVE_CREASE if cloth.creased else ABOVE
    checks: dict[Side, Check] = {}
    heights: dict[Side, float] = {}
    for side, bias in biases.items():
        low, high = cell.hands.height(side, up.q[0]), cell.hands.height(side, up.q[-1])
        gripper = cell.ports.grippers[side].state()
        ready = gripper.calibrated and not gripper.in_error and LET_GO <= gripper.opening <= WIDEST
        closes = ready and high - low >= LEAST_RISE
        checks[side] = (
            EmptyCheck(cell.grasp, bias, cloth.layer, low + above, RELEASE_OPENING)
            if closes
            else StuckCheck(cell.grasp, bias)
        )
        heights[side] = max(high - WEIGHED, low + LEAST_RISE)
    return checks, heights


@dataclass(eq=False)
class _HandChecks:
    """Checks of the hands that rise: each closes and opens, then its pads are weighed. running: checks that have
    not ended. weighed: height of each hand from which its pads are weighed [m]."""

    cell: Workcell
    biases: Mapping[Side, TactileBias]
    running: dict[Side, Check]
    weighed: Mapping[Side, float]
    unsure: set[Side] = field(default_factory=set)
    """Hands whose pads did not meet."""
    felt: Failure | None = None
    at: float = -1.0
    """Path time of the last tick [s]."""

    def look(self, tick: Tick) -> Failure | None:
        """Watch a motion of the arms. After a hand has felt cloth, and in a pause, no hand is commanded."""
        rests, self.at = tick.t <= self.at, tick.t
        if rests:
            return self.felt
        for side, check in () if self.felt else tuple(self.running.items()):
            reading = self.cell.hands.read(side, tick.state)
            if isinstance(check, StuckCheck) and not reading.height >= self.weighed[side]:
                continue
            after = self._step(side, reading, check)
            if not isinstance(after, Outcome):
                self.running[side] = after
                continue
            del self.running[side]
            self.felt = self.felt or after.failure
        return self.felt

    def finish(self) -> Failure | None:
        """Finish the checks with the arms at rest. A hand that has not begun to close is only weighed."""
        for side, check in self.running.items():
            if isinstance(check, EmptyCheck) and not check.begun:
                self.running[side] = StuckCheck(self.cell.grasp, self.biases[side])
        running = self.running
        failure = each_hand(self.cell.loop, self.cell.hands, running, self._step).failure if running else None
        return failure or (still_closed(self.cell) if self.unsure else None)

    def _step(self, side: Side, reading: HandReading, check: Check) -> Check | Outcome[Clear]:
        if isinstance(check, StuckCheck):
            return check_stuck(reading, check)
        command, after = check_empty(reading, check)
        refused = command is not None and self._refuses(side, command)
        if not isinstance(after, Outcome) and not refused:
            return after
        if isinstance(after, Outcome) and after.failure:
            return Outcome(failure=after.failure)
        if refused or (isinstance(after, Outcome) and not after.unwrap().met):
            self.unsure.add(side)
        return StuckCheck(self.cell.grasp, self.biases[side])

    def _refuses(self, side: Side, command: GripCommand) -> bool:
        """Command the gripper. Returns whether it refuses, because it is in error or not calibrated. A refusal is
        no failure here: later the next grasp fails, or the hand is found closed. A stop is raised as usual."""
        try:
            self.cell.hands.command(side, command)
        except DriverError as e:
            if e.kind is FailureKind.STOPPED:
                raise
            return True
        return False


def _dragging(cell: Workcell, biases: Mapping[Side, TactileBias]) -> Watch:
    """Return a watch that ends the motion of a hand that drags cloth along."""
    watches = {side: DragWatch(StuckCheck(cell.grasp, bias)) for side, bias in biases.items()}
    at = -1.0

    def look(tick: Tick) -> Failure | None:
        nonlocal at
        rests, at = tick.t <= at, tick.t
        if rests:  # in a pause, a person may touch the hands
            return None
        for side, watch in watches.items():
            after = watch_drag(cell.hands.read(side, tick.state), watch)
            if isinstance(after, Failure):
                return after
            watches[side] = after
        return None

    return look


def _close_and_open(cell: Workcell, sides: tuple[Side, ...]) -> Failure | None:
    """Close the hands and open them as far as at the release, with the force of a release. If the other hand was
    closing when cloth was felt, it opens, too."""
    narrow = RELEASE_OPENING - RELEASE_TOLERANCE
    others = tuple(s for s in Side if s not in sides and cell.ports.grippers[s].state().opening < narrow)
    for opening, hands in ((0.0, sides), (RELEASE_OPENING, (*sides, *others))):
        for side in hands:
            cell.hands.command(side, GripCommand(opening, RELEASE_FORCE))
        failure = wait(cell.loop, OPENING_S, cell.hands.recording())
        if failure:
            return failure
    for side in sides:
        cell.hand_record.freed(side)
    return still_closed(cell)


def _lead(cell: Workcell, course: Course, control: PathControl) -> Failure | None:
    unsettled = come_to_rest(cell.ports, cell.execution, cell.last_command)
    return unsettled or lead_out(cell, FREEING, control, course)
