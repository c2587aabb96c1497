"""Initial state of the emulated robot: new, or as an earlier program left it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from foldcell.robots.baxter.ros.electric_gripper import PARAMETERS


@dataclass(frozen=True)
class InitialState:
    """Initial state of the emulated robot.

    calibrated: both grippers are calibrated; error: the error of both grippers until a reset, empty for none;
    parameters: the parameters of both grippers [%]; echo: sender and sequence of the last command that each
    gripper has handled, if any.

    enabled: the motors are on. stopped: the red button was pressed and released, and the robot was not reset.
    head_pan: angle of the head [rad], if it was moved. timeout: validity of a joint command [s]. speed_ratio:
    fraction of full speed of moves in position mode. state_rate: rate of the joint states [Hz].
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
    state_rate: int = 100


NEW = InitialState()
"""A new robot after power-on."""
USED = InitialState(
    calibrated=True,
    parameters={"velocity": 20.0, "moving_force": 100.0, "holding_force": 100.0, "dead_zone": 10.0},
    echo=("another_program_go", 1),
    enabled=True,
    head_pan=0.3,
    timeout=1.0,
    speed_ratio=0.1,
    state_rate=30,
)
