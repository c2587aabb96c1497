"""How the hands moved with the cloth and when they lost it, as their sensors measured it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation, Slerp

from foldcell.robots.ports import Array
from foldcell.skills.cloth.predict import HANDS
from foldcell.skills.vocabulary import GraspId

AT_FIRST_S = 0.2
"""The hands are assumed to hold their cloth for this time after the beginning. The openings in this time are the
openings with cloth [s]."""
OPENED = 0.0015
"""A hand has let go if its opening exceeds its opening with cloth by more than this [m]."""
LONGEST_GAP_S = 0.5
"""If the time between two readings is longer than this, it counts as this long [s]."""
FASTEST = 2.0
"""Joints move no faster than this while the hands carry cloth [rad/s]: the limit of shoulders and elbows."""


@dataclass(frozen=True, eq=False)
class HandCourse:
    """The measured course of the hands of a fold, from the lift on. The mappings have the grasp of the hand as
    key.

    t: (n,) times [s] from 0; position: (n, 3) of the tool in the table frame [m]; rotation: (n, 3, 3)
    R_table_tool; until: the time until which the hand held its cloth [s].
    """

    t: Array
    position: Mapping[GraspId, Array]
    rotation: Mapping[GraspId, Array]
    until: Mapping[GraspId, float]

    def sampled(self, frame_s: float, heights: Mapping[GraspId, float]) -> tuple[Array, Array]:
        """Return the poses of both hands at the bounds of the frames until the last hand loses its cloth:
        positions (frames + 1, 2, 3), rotations (frames + 1, 2, 3, 3).

        heights: of each tool when it grasps [m]. Measured heights have errors of some millimetres, so only their
        rise since the beginning is used. It is added to `heights` and is never negative, because tips that press
        on the table press no cloth through it.
        """
        last = max(1, round(max(self.until.values()) / frame_s))
        t = np.minimum(np.arange(last + 1) * frame_s, self.t[-1])
        position = np.zeros((last + 1, len(HANDS), 3))
        rotation = np.tile(np.diag([1.0, -1.0, -1.0]), (last + 1, len(HANDS), 1, 1))
        for hand, grasp_id in enumerate(HANDS):
            if grasp_id not in self.position:
                continue
            p = self.position[grasp_id]
            position[:, hand] = np.column_stack([np.interp(t, self.t, p[:, k]) for k in range(3)])
            rise = np.maximum(position[:, hand, 2] - p[0, 2], 0.0)
            position[:, hand, 2] = heights[grasp_id] + rise
            rotation[:, hand] = Slerp(self.t, Rotation.from_matrix(self.rotation[grasp_id]))(t).as_matrix()
        return position, rotation


def without_gaps(stamps: Array, q: Array) -> Array:
    """Return times from 0 (n,) [s] whose steps are at most LONGEST_GAP_S, and at least as long as the joints q
    (n, joints) [rad] need at FASTEST. A hand does not move because a clock was set ahead; and if a clock was set
    back, readings are missing until it has caught up, while the hand moves on."""
    needed = np.abs(np.diff(q, axis=0)).max(axis=1) / FASTEST
    return np.asarray(np.concatenate([[0.0], np.cumsum(np.clip(np.diff(stamps), needed, LONGEST_GAP_S))]))


def held_until(t: Array, opening: Array, empty: float, slip_fraction: float) -> float:
    """Return the time at which a hand loses its cloth or opens [s]; the last time if it does neither.

    t: (n,) [s]; opening: (n,) between the pads [m]. empty: opening of closed, empty pads [m]. slip_fraction: the
    cloth is gone if the opening, less `empty`, is below this share of the opening with cloth, less `empty`.
    """
    known = np.isfinite(opening)
    if not known.any():
        return float(t[-1])
    t, opening = t[known], opening[known]
    confirmed = float(np.median(opening[t <= t[0] + AT_FIRST_S]))
    gone: NDArray[np.bool_] = (opening - empty < slip_fraction * (confirmed - empty)) | (
        opening > confirmed + OPENED
    )
    return float(t[gone.argmax()]) if gone.any() else float(t[-1])
