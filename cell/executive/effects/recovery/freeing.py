"""Leave the garment after the release. If cloth stays on a finger: back down, close and open the hand, leave
again."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial

import numpy as np

from foldcell.cell.control.checks import come_to_rest
from foldcell.cell.control.motion import Tick, Watch
from foldcell.cell.control.motions.hands import each_hand
from foldcell.cell.control.motions.hold_position import wait
from foldcell.cell.control.path_clock import PathControl
from foldcell.cell.executive.effects.checked_motion import move
from foldcell.cell.executive.effects.recovery.parking import LET_GO, OPENING_S, RELEASE_OPENING, still_closed
from foldcell.cell.executive.effects.recovery.ways_out import FREEING, FREEING_TRIES, Course, lead_out
from foldcell.cell.hardware.workcell import Workcell
from foldcell.robots.errors import DriverError, Failure, FailureKind
from foldcell.robots.ports import ArmTrajectory, Side
from foldcell.skills.grasping.empty_hand import MET, EmptyCheck, check_empty
from foldcell.skills.grasping.hand_reading import GripCommand, HandReading
from foldcell.skills.grasping.release import RELEASE_FORCE, RELEASE_TOLERANCE
from foldcell.skills.grasping.stuck_on_finger import (
    DragWatch,
    StuckCheck,
    check_stuck,
    watch_drag,
)
from foldcell.skills.grasping.tare import TactileBias
from foldcell.skills.motion.moves.retreat import Retreat
from foldcell.skills.vocabulary import Outcome

FREEING_SPEED = 0.25
"""Maximum speed of the tools while cloth may hang on a finger [m/s]."""
CAREFUL_SPEED = 0.09
"""The same up to CHECKED, where the fingers may still stand in the cloth that they have released [m/s]."""
CHECKED = 0.034
"""The hands stop this far above the release, close and open [m]. A corner of a small towel that is lifted by 40 mm
and laid back lies within 1 mm of its place; after a lift by 50 mm it lies within 13 mm, and after 100 mm 59 mm
beside it, because it drags the towel along. An earlier crease may stand up between the pads: when they met 28 mm
above the release, still rising, they took a layer of it along in 6 of 140 runs without a fault, and from 33 mm in
2 of 17. At rest at this height they did so in none of 55."""
OFF_ZERO = 0.001
"""Empty pads that seem to meet further apart than this are read by a gripper that needs a calibration [m]. With
layers of more than 3 mm, closing pads count as met (`MET`) when they are still further apart than this."""
WIDEST = RELEASE_OPENING + 0.005
"""A hand that is open wider than this has pressed a crease, which may stand up between its pads [m]."""
WEIGHED = 0.03
"""The weight on the pads is measured in this last part of the rise, where the hands slow down [m]."""


@dataclass(frozen=True, eq=False)
class Leaving:
    """How the hands have left the garment. felt: figures for each time that cloth was felt. off_zero: hands whose
    grippers misread the distance of their empty pads."""

    felt: tuple[Mapping[str, object], ...]
    off_zero: tuple[Side, ...]


def leave_freely(
    cell: Workcell,
    way: Retreat,
    biases: Mapping[Side, TactileBias],
    layer: float,
    control: PathControl,
) -> Outcome[Leaving]:
    """Lead the hands up and to the parked posture, and check that no cloth stays on a finger. A little above the
    garment, the hands stop, close and open. Further up, the weight on the pads is measured. The check goes on
    while they move away, because light cloth on the outside of a finger is felt only when it drags the garment
    along.

    If cloth stays on a finger, the hands go back along the same way, so that the cloth lies about as it was
    released. The caught hand closes and opens there, and both leave again.

    layer: smallest thickness of a layer between the pads [m].
    Failures: STUCK_ON_FINGER after FREEING_TRIES, those of the motions.
    """
    up, home = way.retreat, way.park
    felt: list[Mapping[str, object]] = []
    met: dict[Side, float] = {}
    failure = _rise(cell, up, biases, layer, control, met) or move(
        cell, home, control=control, watch=_dragging(cell, biases)
    )
    for _ in range(FREEING_TRIES):
        if failure is None or failure.kind is not FailureKind.STUCK_ON_FINGER:
            break
        caught = tuple(side for side in biases if side == failure.values.get("side"))
        risen = max((_risen(cell, up, side) for side in caught), default=0.0)
        felt.append({**failure.values, "risen_m": risen})
        cell.tell(f"{failure.what}: the hand goes back down, closes and opens")
        _open_others(cell, caught)
        failure = (
            _lead(cell, Course(np.vstack([up.q, home.q])[::-1], FREEING_SPEED), control)
            or _close_and_open(cell, caught)
            or _rise(cell, up, biases, layer, control, met)
            or _lead(cell, Course(home.q, FREEING_SPEED, False, _dragging(cell, biases)), control)
        )
    if failure:
        return Outcome(failure=failure)
    off_zero = tuple(side for side, apart in met.items() if apart > max(OFF_ZERO, MET * layer))
    return Outcome(Leaving(tuple(felt), off_zero))


def _risen(cell: Workcell, up: ArmTrajectory, side: Side) -> float:
    """Return how far a hand stands above the place where it released the cloth [m]."""
    return cell.hands.height(side, cell.ports.arms.state().q) - cell.hands.height(side, up.q[0])


def _rise(
    cell: Workcell,
    up: ArmTrajectory,
    biases: Mapping[Side, TactileBias],
    layer: float,
    control: PathControl,
    met: dict[Side, float],
) -> Failure | None:
    """Rise along the path of `up`. The hands stop at CHECKED, where they close and open. They are weighed at the
    end. met: filled here with the distance at which the empty pads of each hand met [m]."""
    heights = {side: np.array([cell.hands.height(side, q) for q in up.q]) for side in biases}
    risen = {side: height - height[0] for side, height in heights.items()}
    closing = tuple(side for side in biases if risen[side][-1] >= CHECKED and _may_close(cell, side))
    if closing:
        there = int(np.argmax(np.min([risen[side] for side in closing], axis=0) >= CHECKED))
        failure = _lead(cell, Course(up.q[: there + 1], CAREFUL_SPEED), control)
        if failure:
            return failure
        now = cell.ports.clock.now()
        checks = {side: EmptyCheck(cell.grasp, biases[side], layer, RELEASE_OPENING, now) for side in closing}
        closed = each_hand(cell.loop, cell.hands, checks, partial(_check_empty, cell))
        met |= closed.value or {}
        failure = closed.failure or still_closed(cell)
        if failure:
            return failure
    weighing = _Weighing(
        cell,
        {side: StuckCheck(cell.grasp, bias) for side, bias in biases.items()},
        {side: float(max(height[-1] - WEIGHED, height[0] + CHECKED)) for side, height in heights.items()},
    )
    return _lead(cell, Course(up.q, FREEING_SPEED, watch=weighing.look), control) or weighing.finish()


def _may_close(cell: Workcell, side: Side) -> bool:
    """Whether a hand obeys and is open as after a release."""
    gripper = cell.ports.grippers[side].state()
    return gripper.calibrated and not gripper.in_error and LET_GO <= gripper.opening <= WIDEST


def _check_empty(
    cell: Workcell, side: Side, reading: HandReading, state: EmptyCheck
) -> EmptyCheck | Outcome[float]:
    """One tick of a hand that closes and opens. A gripper that refuses, because it is in error or not calibrated,
    is no failure here: later the next grasp fails, or the hand is found closed. A stop is raised as usual."""
    command, after = check_empty(reading, state)
    try:
        cell.hands.command(side, command)
    except DriverError as e:
        if e.kind is FailureKind.STOPPED:
            raise
        return Outcome(np.nan)
    return after


@dataclass(eq=False)
class _Weighing:
    """Weighs the hands that rise. running: checks that have not ended. above: height of each hand from which it is
    weighed [m]."""

    cell: Workcell
    running: dict[Side, StuckCheck]
    above: Mapping[Side, float]
    at: float = -1.0
    """Path time of the last tick [s]."""

    def look(self, tick: Tick) -> Failure | None:
        """Watch a motion of the arms. In a pause, no hand is judged, because a person may touch it."""
        rests, self.at = tick.t <= self.at, tick.t
        for side, check in () if rests else tuple(self.running.items()):
            reading = self.cell.hands.read(side, tick.state)
            if not reading.height >= self.above[side]:
                continue
            after = check_stuck(reading, check)
            if not isinstance(after, Outcome):
                self.running[side] = after
                continue
            del self.running[side]
            if after.failure:
                return after.failure
        return None

    def finish(self) -> Failure | None:
        """Finish the checks with the arms at rest."""
        weigh = lambda side, reading, check: check_stuck(reading, check)  # noqa: E731
        return each_hand(self.cell.loop, self.cell.hands, self.running, weigh).failure if self.running else None


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


def _open_others(cell: Workcell, caught: tuple[Side, ...]) -> None:
    """Open the hand that was closing when the other one felt cloth, so that it goes down open."""
    for side in set(Side) - set(caught):
        if cell.ports.grippers[side].state().opening < RELEASE_OPENING - RELEASE_TOLERANCE:
            cell.hands.command(side, GripCommand(RELEASE_OPENING, RELEASE_FORCE))


def _close_and_open(cell: Workcell, sides: tuple[Side, ...]) -> Failure | None:
    """Close the hands and open them as far as at the release, with the force of a release."""
    for opening in (0.0, RELEASE_OPENING):
        for side in sides:
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
