"""Series at 100 Hz. They are collected and written in batches, because a batch costs as much as a single row.

This module runs on the recorder's own thread only.
"""

from __future__ import annotations

import numpy as np
import rerun as rr

from cell.view.entries.entry import Columns, Entry
from cell.view.entries.robot import RobotFigure
from robots.ports import GripperState, JointState, Side, TactileReading, arm_slice

__all__ = ["Series"]

BATCH = 0.5
"""The waiting rows are written when they span this much cell time [s]."""
POSE_RATE = 25.0
"""Rate at which the robot's transforms are recorded [Hz]. At this rate motions look smooth, and the recording
needs only a quarter of the data of 100 Hz."""


class Series:
    """Collects rows of joints, grippers and tactile pads until they are written."""

    def __init__(self, robot: RobotFigure | None) -> None:
        self._robot = robot
        self._joints: list[JointState] = []
        self._grippers: dict[Side, list[GripperState]] = {s: [] for s in Side}
        self._tactile: dict[Side, list[TactileReading]] = {s: [] for s in Side}

    def joints(self, state: JointState) -> list[Entry]:
        self._joints.append(state)
        return self._flush_joints() if _full(self._joints) else []

    def gripper(self, state: GripperState) -> list[Entry]:
        rows = self._grippers[state.side]
        rows.append(state)
        return self._flush_gripper(state.side) if _full(rows) else []

    def tactile(self, reading: TactileReading) -> list[Entry]:
        rows = self._tactile[reading.side]
        rows.append(reading)
        return self._flush_tactile(reading.side) if _full(rows) else []

    def flush(self) -> list[Entry]:
        """Return the entries for all rows that are not yet written."""
        entries = self._flush_joints()
        for side in Side:
            entries += self._flush_gripper(side) + self._flush_tactile(side)
        return entries

    def _flush_joints(self) -> list[Entry]:
        rows, self._joints = self._joints, []
        if not rows:
            return []
        t, q = np.array([r.stamp for r in rows]), np.array([r.q for r in rows])
        entries: list[Entry] = [
            Columns(f"joints/{side}", t, tuple(rr.Scalars.columns(scalars=q[:, arm_slice(side, q.shape[1])])))
            for side in Side
        ]
        if self._robot is not None:
            k = _subsampled(t)
            entries += self._robot.joints(t[k], q[k], np.array([rows[i].head_pan for i in k]))
        return entries

    def _flush_gripper(self, side: Side) -> list[Entry]:
        rows, self._grippers[side] = self._grippers[side], []
        if not rows:
            return []
        t = np.array([r.stamp for r in rows])
        opening, force = np.array([r.opening for r in rows]), np.array([r.force for r in rows])
        entries: list[Entry] = [
            Columns(f"opening/{side}", t, tuple(rr.Scalars.columns(scalars=opening * 1000.0))),
            Columns(f"grip/{side}/gripper_N", t, tuple(rr.Scalars.columns(scalars=force))),
        ]
        if self._robot is not None:
            k = _subsampled(t)
            entries += self._robot.fingers(side, t[k], opening[k])
        return entries

    def _flush_tactile(self, side: Side) -> list[Entry]:
        rows, self._tactile[side] = self._tactile[side], []
        if not rows:
            return []
        t = np.array([r.stamp for r in rows])
        pads, tips = np.array([r.grip for r in rows]), np.array([r.tip.max() for r in rows])
        return [
            Columns(f"grip/{side}/pads_N", t, tuple(rr.Scalars.columns(scalars=pads))),
            Columns(f"grip/{side}/tip_N", t, tuple(rr.Scalars.columns(scalars=tips))),
        ]


def _full(rows: list) -> bool:
    return bool(rows[-1].stamp - rows[0].stamp >= BATCH)


def _subsampled(t: np.ndarray) -> np.ndarray:
    """Return the indices of rows at POSE_RATE, always including the last row."""
    slot = np.floor((t - t[0]) * POSE_RATE + 1e-6)
    keep = np.flatnonzero(np.diff(slot, prepend=-1.0) > 0)
    return np.union1d(keep, [len(t) - 1])
