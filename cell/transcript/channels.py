"""The table of questions that the executive asks its cell. Port recorder and replay both come from this table."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from enum import Enum
from types import SimpleNamespace
from typing import Any

import numpy as np

from foldcell.robots.ports import Ports, Side, Stop


class Channel(Enum):
    """The kinds of question: port and method (robots/ports.py, `CommandQueue`), and the question in words."""

    NOW = "clock.now", "a reading of the clock"
    SLEEP = "clock.sleep_until", "waiting until {} s"
    ARMS = "arms.state", "a reading of the arms"
    ENABLE = "arms.enable", "the arms' motors on"
    SET_POINT = "arms.command", "a set-point for the arms: ({}) rad"
    HEAD = "head.command_pan", "the head to {} rad"
    CALIBRATE = "grippers.calibrate", "calibrating the {} gripper"
    GRIP = "grippers.command", "the {} gripper to {} m with {} N"
    GRIPPER = "grippers.state", "a reading of the {} gripper"
    TACTILE = "tactile.reading", "a tactile reading of the {} hand"
    CAPTURE = "camera.capture", "a picture"
    GLIMPSE = "camera.glimpse", "a picture for display"
    STOP = "stop.state", "a reading of the stop"
    LAY = "attendant.lay_garment", "asking for the garment to be laid"
    BOARD = "attendant.bring_board", "asking for the board: {}"
    TAKE = "commands.take", "a check for a command of the operator ({})"
    WAIT = "commands.wait", "waiting for a command of the operator ({})"
    EDIT = "commands.edit", "reading the operator's change of the plan"
    END = "end", "the end of the run"  # the last exchange

    def __init__(self, call: str, words: str) -> None:
        self.port, _, self.method = call.partition(".")
        self.call, self._words = call, words

    def in_words(self, arguments: list[Any]) -> str:
        """Return the question in words. arguments: as `unpack` returns them."""
        try:
            return self._words.format(*map(_shown, arguments))
        except IndexError:
            return self.call


def _shown(argument: Any) -> str:
    if isinstance(argument, np.ndarray):
        return ", ".join(f"{number:.4f}" for number in argument.flat)
    return ", ".join(map(str, argument)) if isinstance(argument, list) else str(argument)


@dataclass(frozen=True)
class CellConstants:
    """Constants of a cell's ports. command_timeout [s]; max_opening of each gripper [m]."""

    driver: str
    simulated: bool
    command_timeout: float
    max_opening: Mapping[Side, float]

    @classmethod
    def of(cls, ports: Ports) -> CellConstants:
        openings = {side: float(gripper.max_opening) for side, gripper in ports.grippers.items()}
        return cls(ports.driver, ports.simulated, float(ports.arms.command_timeout), openings)


def build_ports(
    constants: CellConstants, method: Callable[[Channel, tuple[Side, ...]], Callable[..., Any]], stop: Stop
) -> Ports:
    """Build ports from the table. A channel is one kind of question to a port.

    method(channel, sides): returns the function that asks the channel's question; sides: the side of the gripper
    or tactile sensors, else empty. stop: the stop that is triggered and reset.
    """

    def port(name: str, *sides: Side, **attributes: Any) -> Any:
        methods = {c.method: method(c, sides) for c in Channel if c.port == name}
        return SimpleNamespace(**methods, **attributes)

    openings = constants.max_opening
    return Ports(
        driver=constants.driver,
        simulated=constants.simulated,
        clock=port("clock"),
        arms=port("arms", command_timeout=constants.command_timeout),
        head=port("head"),
        grippers={
            side: port("grippers", side, side=side, max_opening=opening) for side, opening in openings.items()
        },
        tactile={side: port("tactile", side, side=side) for side in openings},
        camera=port("camera"),
        stop=port("stop", trigger=stop.trigger, reset=stop.reset),
        attendant=port("attendant"),
    )
