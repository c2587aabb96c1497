"""The posture of a hand: the degrees of freedom that a fold leaves to the arm, and the resulting tool poses.

The cloth can turn about the held line, the strip of cloth between the pads. The hand may therefore lean about this
line (pitch), and a little along it (roll). It may also turn by pi about its own axis, which does not change the
line.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from foldcell.robots.ports import Array
from foldcell.skills.plane import lengths_along
from foldcell.skills.vocabulary import GraspId, Table, ToolPath, tool_rotation

HALF_TURN = np.diag([-1.0, -1.0, 1.0])


@dataclass(frozen=True)
class Posture:
    """The posture of one arm.

    path: identifies the tool path that this arm takes, by its grasp in the plan. If the arms are swapped, this
    grasp was planned for the other arm. turned: whether the hand is turned by pi about its axis. pitch, roll: lean
    in addition to the lean of the tool path [rad], given for the hand before the turn by pi. pitch_change: smooth
    increase of the pitch from grasp to release [rad], so that in a long fold the hand can lean in opposite
    directions at the two ends.
    """

    path: GraspId
    turned: bool = False
    pitch: float = 0.0
    roll: float = 0.0
    pitch_change: float = 0.0

    def rotation(self, path: ToolPath) -> Array:
        """Compute R_table_tool (n, 3, 3) of this posture along a tool path."""
        lean = path.pitch + self.pitch
        if self.pitch_change:
            u = (path.t - path.t[0]) / max(path.t[-1] - path.t[0], 1e-9)
            lean = lean + self.pitch_change * u**2 * (3.0 - 2.0 * u)
        R = tool_rotation(path.heading, lean, path.roll + self.roll)
        return R @ HALF_TURN if self.turned else R


def angles_of(rotation: Array) -> tuple[Array, Array, Array]:
    """Compute heading, pitch, roll (n,) of R_table_tool (n, 3, 3): the inverse of `vocabulary.tool_rotation`."""
    R = rotation
    pitch = np.arcsin(np.clip(-R[:, 2, 1], -1.0, 1.0))
    heading = np.unwrap(np.arctan2(R[:, 0, 1], -R[:, 1, 1]))
    roll = np.arctan2(R[:, 2, 0], -R[:, 2, 2])
    return heading, pitch, roll


def blended(path: ToolPath, start: Array) -> ToolPath:
    """Shift a path so that it begins at `start` (3,) [m]. The offset fades out along the path."""
    travelled = lengths_along(path.position)
    u = travelled / max(travelled[-1], 1e-9)
    fade = 1.0 - u**2 * (3.0 - 2.0 * u)
    offset = start - path.position[0]
    return ToolPath(path.t, path.position + fade[:, None] * offset, path.heading, path.pitch, path.roll)


def with_ends(path: ToolPath, above: float, below: float, samples: int) -> ToolPath:
    """Sample a path at `samples` points that are evenly spaced along it, and add a straight descent by `above`
    before it and a straight rise by `below` after it [m]."""
    travelled = lengths_along(path.position)
    arc = path.at(np.interp(np.linspace(0.0, travelled[-1], samples), travelled, path.t))
    down, up = np.linspace(above, 0.0, 4)[:-1], np.linspace(0.0, below, 4)[1:]
    z = np.array([0.0, 0.0, 1.0])
    position = np.vstack([arc.position[0] + down[:, None] * z, arc.position, arc.position[-1] + up[:, None] * z])

    def pad(x: Array) -> Array:
        return np.concatenate([np.full(3, x[0]), x, np.full(3, x[-1])])

    return ToolPath(pad(arc.t), position, pad(arc.heading), pad(arc.pitch), pad(arc.roll))


def in_base(table: Table, position: Array) -> Array:
    """Convert positions (n, 3) [m] from the table frame to the base frame."""
    return position + np.array([0.0, 0.0, table.height])
