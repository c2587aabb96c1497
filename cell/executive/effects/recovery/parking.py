"""Open the hands and park the arms."""

from __future__ import annotations

from collections.abc import Collection

import numpy as np

from foldcell.cell.control.checks import SETTLED
from foldcell.cell.control.motions.hold_position import wait
from foldcell.cell.control.path_clock import PathControl
from foldcell.cell.control.ticks import TICK_S
from foldcell.cell.executive.effects.recovery.ways_out import PARKING, lead_out
from foldcell.cell.hardware.workcell import Workcell
from foldcell.robots.errors import DriverError, Failure, FailureKind
from foldcell.robots.ports import Side
from foldcell.skills.grasping.hand_reading import GRIPPER_STALE, GripCommand
from foldcell.skills.grasping.release import RELEASE_FORCE

RELEASE_OPENING = 0.020
"""Opening of the pads when they release the garment [m]. It is small, so that the fingers do not sweep the stack
aside."""
OPENING_S = 0.8
SLOW_OPENING_S = 2.0
"""Additional waiting time for a gripper that still moves [s]."""
CALIBRATION_S = 12.0
LET_GO = 0.010
"""If the pads are at least this far apart, they hold no cloth [m]."""


def open_hands(cell: Workcell, sides: Collection[Side] = tuple(Side)) -> None:
    for side in sides:
        gripper = cell.ports.grippers[side]
        cell.hands.command(side, GripCommand(gripper.max_opening, RELEASE_FORCE))


def let_go_and_park(cell: Workcell, control: PathControl, opening_s: float = OPENING_S) -> Failure | None:
    """Open the hands and park. Returns a failure if a hand may still hold cloth, or if the arms do not get home.

    A gripper that is in error or without calibration refuses commands until it is calibrated. A calibration closes
    the pads before it opens them. It is therefore made in the parked posture, and over the garment only if the
    hand cannot be opened otherwise.
    """
    refusing = _refusing(cell)
    open_hands(cell, tuple(side for side in Side if side not in refusing))
    failure = wait(cell.loop, opening_s, cell.hands.recording())
    if failure is None and any(_in_doubt(cell, side) for side in refusing):
        failure = _recalibrate(cell, refusing)
    if failure is None and still_closed(cell) and any(g.state().moving for g in cell.ports.grippers.values()):
        failure = wait(cell.loop, SLOW_OPENING_S, cell.hands.recording())
    failure = failure or still_closed(cell) or park(cell, control)
    return failure or recalibrate_parked(cell, _refusing(cell))


def recalibrate_parked(cell: Workcell, sides: Collection[Side]) -> Failure | None:
    """Calibrate grippers in the parked posture. If one stays in error, the next grasp fails, but parking does
    not."""
    failure = _recalibrate(cell, sides) if sides else None
    return None if failure and failure.kind is FailureKind.GRIPPER_FAULT else failure


def _refusing(cell: Workcell) -> tuple[Side, ...]:
    """Return the hands whose grippers refuse commands until they are calibrated."""
    states = {side: gripper.state() for side, gripper in cell.ports.grippers.items()}
    return tuple(side for side, state in states.items() if state.in_error or not state.calibrated)


def _in_doubt(cell: Workcell, side: Side) -> bool:
    """Whether a hand may hold cloth. Without a calibration, a gripper's opening says nothing about it."""
    state = cell.ports.grippers[side].state()
    return not state.calibrated or not state.opening >= LET_GO


def _recalibrate(cell: Workcell, sides: Collection[Side]) -> Failure | None:
    """Calibrate grippers and open them. One that stays in error keeps its opening."""
    for side in sides:
        cell.ports.grippers[side].calibrate()
        try:
            open_hands(cell, (side,))
        except DriverError as e:
            if e.kind is FailureKind.STOPPED:
                raise
    return calibrated(cell)


def calibrated(cell: Workcell) -> Failure | None:
    """Wait until all grippers are calibrated, because their pads move during a calibration. Returns a failure if
    that takes longer than CALIBRATION_S, or if the run is stopped."""
    deadline = cell.ports.clock.now() + CALIBRATION_S
    while True:
        busy = [side.value for side, g in cell.ports.grippers.items() if not g.state().calibrated]
        if not busy:
            return None
        if cell.ports.clock.now() > deadline:
            return Failure(
                FailureKind.GRIPPER_FAULT,
                f"the {' and the '.join(busy)} gripper is not calibrated after {CALIBRATION_S:.0f} s",
                "check that it is plugged in and free to move",
            )
        failure = wait(cell.loop, TICK_S)
        if failure:
            return failure


def still_closed(cell: Workcell) -> Failure | None:
    """Return a failure if a hand did not open or its opening is unknown. Such a hand may drag the garment
    along."""
    for side, gripper in cell.ports.grippers.items():
        state = gripper.state()
        opening, age = state.opening, cell.ports.clock.now() - state.stamp
        if not (age <= GRIPPER_STALE and np.isfinite(opening)):
            return Failure(
                FailureKind.GRIPPER_FAULT,
                f"the {side.value} gripper has sent no state for {age:.1f} s: it may hold the garment",
                "check its cable, and free the garment by hand",
                {"age_s": age},
            )
        if opening < LET_GO:
            return Failure(
                FailureKind.GRIPPER_FAULT,
                f"the {side.value} gripper does not open ({opening * 1e3:.0f} mm): it may hold the garment",
                "free the garment by hand, then check the gripper",
                {"opening_m": opening},
            )
    return None


def park(cell: Workcell, control: PathControl) -> Failure | None:
    """Move to the parked posture, on one of the ways out. Returns the last failure."""
    cell.hand_record.end()
    if np.abs(cell.ports.arms.state().q - cell.robot.q_park).max() < SETTLED:
        return None
    return lead_out(cell, PARKING, control)
