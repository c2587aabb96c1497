"""Series at 100 Hz. They are collected and written in batches, because a batch costs as much as a single row.

This module runs on the recorder's own thread only.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import rerun as rr

from foldcell.cell.view.entries.entry import Columns, Entry
from foldcell.cell.view.entries.robot import RobotFigure
from foldcell.robots.ports import Array, GripperState, JointState, Side, TactileReading, arm_slice

BATCH = 0.5
"""The waiting rows are written when they span this much cell time [s]."""
POSE_RATE = 25.0
"""Rate at which the robot's transforms are recorded [Hz]. At this rate motions look smooth, and the recording
needs only a quarter of the data of 100 Hz."""

Sample = JointState | GripperState | TactileReading
"""One row of a series."""


class Series:
    """Collects the rows of joints, grippers and tactile pads until they are written."""

    def __init__(self, robot: RobotFigure | None) -> None:
        self._robot = robot
        self._waiting: dict[tuple[type, Side | None], list[Any]] = {}
        """Rows of each kind of sample and, for grippers and pads, of each side."""

    def add(self, sample: Sample) -> Sequence[Entry]:
        """Add a row. Returns the entries of its batch if it is full."""
        key = type(sample), getattr(sample, "side", None)
        rows = self._waiting.setdefault(key, [])
        rows.append(sample)
        return self._written(self._waiting.pop(key)) if rows[-1].stamp - rows[0].stamp >= BATCH else []

    def flush(self) -> list[Entry]:
        """Return the entries for all rows that are not yet written."""
        waiting, self._waiting = self._waiting, {}
        return [entry for rows in waiting.values() for entry in self._written(rows)]

    def _written(self, rows: Sequence[Any]) -> list[Entry]:
        t, first = np.array([r.stamp for r in rows]), rows[0]
        k = _subsampled(t)
        if isinstance(first, JointState):
            q, pan = np.array([r.q for r in rows]), np.array([r.head_pan for r in rows])
            arms = [_columns(f"joints/{side}", t, q[:, arm_slice(side, q.shape[1])]) for side in Side]
            return arms + (self._robot.joints(t[k], q[k], pan[k]) if self._robot else [])
        if isinstance(first, GripperState):
            opening, force = np.array([r.opening for r in rows]), np.array([r.force for r in rows])
            return [
                _columns(f"opening/{first.side}", t, opening * 1000.0),
                _columns(f"grip/{first.side}/gripper_N", t, force),
                *(self._robot.fingers(first.side, t[k], opening[k]) if self._robot else []),
            ]
        return [
            _columns(f"grip/{first.side}/pads_N", t, np.array([r.grip for r in rows])),
            _columns(f"grip/{first.side}/tip_N", t, np.array([r.tip.max() for r in rows])),
        ]


def _columns(path: str, t: Array, values: Array) -> Entry:
    return Columns(path, t, tuple(rr.Scalars.columns(scalars=values)))


def _subsampled(t: Array) -> Array:
    """Return the indices of rows at POSE_RATE, always including the last row."""
    slot = np.floor((t - t[0]) * POSE_RATE + 1e-6)
    keep = np.flatnonzero(np.diff(slot, prepend=-1.0) > 0)
    return np.union1d(keep, [len(t) - 1])
