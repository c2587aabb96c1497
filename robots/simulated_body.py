"""What the simulated cell needs of a robot: its body in a physics world, and its appearance for the camera."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

from robots.ports import Array, Side

__all__ = ["SimulatedBody", "Simulation"]


class SimulatedBody(Protocol):
    """A position-controlled robot in a PyBullet world, with the base at the origin. q, qd, effort: (n,) of both
    arms [rad], [rad/s], [Nm]; head_pan [rad], 0 for a robot without a head; openings of the grippers [m]."""

    def place(self, q: Array, head_pan: float, opening: Mapping[Side, float]) -> None:
        """Set the state at rest."""

    def drive(self, q: Array, qd: Array, head_pan: float, opening: Mapping[Side, float]) -> None:
        """Set the motor targets for the next physics step, which the caller performs."""

    def read(self) -> tuple[Array, Array, Array, float]:
        """Return the true q, qd, effort and head_pan, without sensor errors."""

    def tool_pose(self, side: Side) -> tuple[Array, Array]:
        """Return T_base_tool as position (3,) [m] and rotation (3, 3)."""

    def let_fingers_through(self, other: int) -> None:
        """Disable collisions between the fingers and body `other`."""


@dataclass(frozen=True)
class Simulation:
    """A robot in the simulated cell.

    body(client): loads the robot into the PyBullet world `client`. seen_urdf: path of a URDF with simplified
    visuals and no `package://` paths, which the render process loads. shoulder: place (x, y) [m] of each arm's
    shoulder in the base frame. drop_joint: index, in an arm, of the joint that gives way in a sudden drop.
    drop_sign: for each side, the sign of its rotation that lowers the arm. head_range: largest angle of the head
    to either side [rad].
    """

    body: Callable[[int], SimulatedBody]
    seen_urdf: Callable[[], Path]
    shoulder: Mapping[Side, tuple[float, float]]
    drop_joint: int
    drop_sign: Mapping[Side, float]
    head_range: float = 0.0
