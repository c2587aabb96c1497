"""The robot in the recording: its meshes once, then the transforms of its moving joints."""

from __future__ import annotations

import numpy as np
import rerun as rr
import rerun.urdf
from numpy.typing import NDArray

from foldcell.cell.view.entries.entry import Columns, Entry, Log, Robot
from foldcell.robots.ports import Array, Side
from foldcell.robots.robot import RobotVisual

FRAMES = "robot/"
"""Prefix of the robot's frame names, so that a link named 'base' does not clash with another frame."""


class RobotFigure:
    """Converts joint values into transforms. Only the recorder's own thread uses it."""

    def __init__(self, visual: RobotVisual) -> None:
        self._visual = visual
        self._tree = rerun.urdf.UrdfTree.from_file_path(
            visual.urdf, entity_path_prefix="world", frame_prefix=FRAMES, static_transform_entity_path="/tf_static"
        )
        self._joints = {joint.name: joint for joint in self._tree.joints()}

    def scene(self) -> list[Entry]:
        """Return the meshes and fixed frames. The root link is fixed to the base frame, which is `world`."""
        root = FRAMES + self._tree.root_link().name
        fixed = rr.Transform3D(parent_frame="tf#/world", child_frame=root)
        return [Robot(self._tree), Log("tf/base", None, (fixed,), essential=True)]

    def joints(self, t: Array, q: Array, head_pan: Array) -> list[Entry]:
        """Return one batch of transforms for each joint. t (n,) [s], q (n, joints) [rad], head_pan (n,) [rad]."""
        values = {name: q[:, k] for k, name in enumerate(self._visual.joint_names)}
        if self._visual.head_joint is not None:
            values[self._visual.head_joint] = head_pan
        return self._transforms(t, values)

    def fingers(self, side: Side, t: Array, opening: Array) -> list[Entry]:
        """Return one batch of transforms for each finger joint. t (n,) [s], opening between the pads (n,) [m]."""
        return self._transforms(t, {name: opening * share for name, share in self._visual.finger_joints[side]})

    def _transforms(self, t: Array, values: dict[str, NDArray]) -> list[Entry]:
        """A joint whose reading is not a number stays where it was drawn last."""
        entries: list[Entry] = []
        for name, positions in values.items():
            joint, known = self._joints[name], np.isfinite(positions)
            if known.any():
                # the library warns if a value is outside
                inside = positions[known].clip(joint.limit_lower, joint.limit_upper)
                columns = tuple(joint.compute_transform_columns(inside.tolist()))
                entries.append(Columns(f"tf/{name}", t[known], columns))
        return entries
