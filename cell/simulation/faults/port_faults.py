"""Faults at the ports: they alter what the ports of a simulated cell answer. The world itself is sound.

Every method returns its argument unchanged while no fault was injected.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from dataclasses import replace
from typing import Any, TypeVar

import numpy as np

from foldcell.cell.simulation.faults.board import FaultBoard
from foldcell.cell.simulation.faults.kinds import FaultKind
from foldcell.robots.ports import (
    Array,
    CameraFrame,
    GripperState,
    JointSetpoint,
    JointState,
    Side,
    StopState,
    TactileReading,
    frozen,
)

TICK_S = 0.01
"""While joint states arrive out of order, the port answers in turn with the present state and with an old one. It
changes between them after this time [s]."""

K = FaultKind
Stamped = TypeVar("Stamped", JointState, JointSetpoint, TactileReading, GripperState, CameraFrame, StopState)


class PortFaults:
    """The faults at the ports of one world."""

    def __init__(self, board: FaultBoard) -> None:
        self._board = board
        self._held: dict[tuple[FaultKind, Side | None], Any] = {}
        """Readings that an active fault repeats."""
        self._past: deque[JointState] = deque()
        """Joint states since readings began to arrive out of order."""

    # clock

    def cell_time(self) -> float:
        """Return the time that the cell's clock shows [s]."""
        self._step_clock()
        return self._board.now + self._board.clock_offset

    def wake_at(self, t: float) -> float:
        """Return the time of the world at which a sleep until the clock shows t [s] ends."""
        self._step_clock()
        stalled = self._board.take(K.PROGRAM_STALLED)
        return t - self._board.clock_offset + (stalled.extent if stalled else 0.0)

    def stamped(self, value: Stamped) -> Stamped:
        """Return a reading with the stamp that the cell's clock gives it."""
        offset = self._board.clock_offset
        return replace(value, stamp=value.stamp + offset) if offset else value

    def _step_clock(self) -> None:
        step = self._board.take(K.CLOCK_STEP)
        if step:
            self._board.clock_offset += step.extent

    # arms

    def delivers(self) -> bool:
        """Whether set-points reach the robot."""
        return self._board.active(K.SETPOINTS_STARVED) is None

    def silence(self) -> float:
        """Return the time since the last joint state arrived, if they do not arrive at present, else 0 [s]."""
        last: JointState | None = self._held.get((K.JOINT_STATE_STALE, None))
        if last is None or self._board.active(K.JOINT_STATE_STALE) is None:
            return 0.0
        return self._board.now - last.stamp

    def joint_state(self, state: JointState) -> JointState:
        state = self._out_of_order(self._duplicated(state))
        stale = self._repeated(K.JOINT_STATE_STALE, None, state)
        kept = self._repeated(K.JOINT_STATE_FROZEN, None, stale)
        state = kept if kept is stale else replace(kept, stamp=stale.stamp)
        if self._board.active(K.JOINT_STATE_NAN):
            nan = np.full_like(state.q, np.nan)
            state = replace(state, q=frozen(nan), qd=frozen(nan), effort=frozen(nan))
        return self.stamped(state)

    def _duplicated(self, state: JointState) -> JointState:
        fault, key = self._board.active(K.JOINT_STATE_DUPLICATED), (K.JOINT_STATE_DUPLICATED, None)
        if fault is None:
            return state
        last: JointState | None = self._held.get(key)
        if last is None or state.stamp - last.stamp >= fault.extent:
            last = self._held[key] = state
        return last

    def _out_of_order(self, state: JointState) -> JointState:
        fault = self._board.active(K.JOINT_STATE_OUT_OF_ORDER)
        if fault is None:
            self._past.clear()
            return state
        if not self._past or state.stamp > self._past[-1].stamp:
            self._past.append(state)
        while len(self._past) > 1 and self._past[1].stamp <= state.stamp - fault.extent:
            self._past.popleft()
        return self._past[0] if round(state.stamp / TICK_S) % 2 else state

    # hands

    def tactile(self, side: Side, read: Callable[[Side], TactileReading]) -> TactileReading:
        """Return the reading of one hand. read(side): the sound reading."""
        reading = read(side)
        if self._board.active(K.TACTILE_SWAPPED):
            reading = replace(read(side.other), side=side)
        reading = self._repeated(K.TACTILE_STALE, side, reading)
        kept = self._repeated(K.TACTILE_CONSTANT, side, reading)
        reading = kept if kept is reading else replace(kept, stamp=reading.stamp)
        saturated = self._board.active(K.TACTILE_SATURATED, side)
        if saturated:
            reading = _filled(reading, saturated.extent)
        if self._board.active(K.TACTILE_DEAD, side):
            reading = _filled(reading, 0.0)
        if self._board.active(K.TACTILE_NAN, side):
            reading = _filled(reading, np.nan)
        return self.stamped(reading)

    def gripper(self, state: GripperState) -> GripperState:
        scale = self._board.active(K.GRIPPER_SCALE, state.side)
        offset = self._board.active(K.GRIPPER_OFFSET, state.side)
        if scale or offset:
            opening = state.opening * (scale.extent if scale else 1.0) + (offset.extent if offset else 0.0)
            state = replace(state, opening=opening)
        return self.stamped(state)

    def calibrated(self, side: Side) -> None:
        """A calibration of this side's gripper begins, which ends its errors of offset and scale."""
        for kind in (K.GRIPPER_OFFSET, K.GRIPPER_SCALE):
            self._board.end(kind, side)

    # helpers

    def _repeated(self, kind: FaultKind, side: Side | None, reading: Stamped) -> Stamped:
        """Return the first reading since a fault of this kind began, or `reading` if there is none."""
        key = kind, side
        if self._board.active(kind, side) is None:
            self._held.pop(key, None)
            return reading
        first: Stamped = self._held.setdefault(key, reading)
        return first


def _filled(reading: TactileReading, value: float) -> TactileReading:
    def full(cells: Array) -> Array:
        return frozen(np.full_like(cells, value))

    return replace(reading, cells=full(reading.cells), tip=full(reading.tip))
