"""What whoever was at the robot before has left of it: a program finds a used robot, not a new one."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from robots.baxter.ros.electric_gripper import PARAMETERS

__all__ = ["NEW", "USED", "InitialState"]


@dataclass(frozen=True)
class InitialState:
    """Of the grippers: whether they are calibrated; error: what is wrong with them until they are reset, empty for
    nothing; parameters [%]; echo: sender and sequence of the last order that each has handled, if any.

    enabled: the motors are on. stopped: the red button was pressed and released, and nobody has reset the robot.
    head_pan: where the head was turned to [rad], if anywhere. timeout: for so long a joint command holds [s].
    speed_ratio: of moves in position mode.
    """

    calibrated: bool = False
    error: str = ""
    parameters: Mapping[str, float] = field(default_factory=lambda: dict(PARAMETERS))
    echo: tuple[str, int] | None = None
    enabled: bool = False
    stopped: bool = False
    head_pan: float | None = None
    timeout: float = 0.2
    speed_ratio: float = 0.3


NEW = InitialState()
"""As it comes from the factory, just switched on."""
USED = InitialState(
    calibrated=True,
    parameters={"velocity": 20.0, "moving_force": 100.0, "holding_force": 100.0, "dead_zone": 10.0},
    echo=("another_program_go", 1),
    enabled=True,
    head_pan=0.3,
    timeout=1.0,
    speed_ratio=0.1,
)
