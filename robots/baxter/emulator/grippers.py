"""Emulation of an electric gripper that receives EndEffectorCommands. It uses any gripper port."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from foldcell.robots.baxter.emulator.initial_state import NEW, InitialState
from foldcell.robots.baxter.ros.electric_gripper import (
    CALIBRATE,
    CLEAR_CALIBRATION,
    CONFIGURE,
    FULL_FORCE,
    GO,
    HARDWARE_ID,
    PARAMETERS,
    RESET,
    STOP,
)
from foldcell.robots.errors import DriverError
from foldcell.robots.ports import Gripper

NO_OP = "no_op"
GRIPPING = 3.0
"""If the pads rest and press with more than this force, the gripper reports a grip [%]."""


@dataclass(frozen=True)
class GripperReport:
    """Values of an EndEffectorState.

    stamp: cell time [s]; position, force [%]; refusal: the reason why the last command was refused. If the last
    command was not refused, it is the error that needs a reset, or empty without an error. command, sender,
    sequence: of the last handled command.
    """

    stamp: float
    calibrated: bool
    ready: bool
    moving: bool
    gripping: bool
    missed: bool
    position: float
    force: float
    refusal: str
    command: str
    sender: str
    sequence: int

    @property
    def state(self) -> str:
        """The content of the message's field `state`: the error as JSON."""
        return json.dumps({"error": self.refusal} if self.refusal else {})


class _RefusedError(Exception):
    """The reason why a command is refused."""


class ElectricGripper:
    """One gripper. A command with the same sender and sequence as the last command is a repetition and is not
    executed again. past: the initial state. If `past.calibrated` is true, `Emulator` calibrates the port."""

    def __init__(self, port: Gripper, past: InitialState = NEW) -> None:
        self._port = port
        self._parameters = dict(past.parameters)
        self._last = past.echo
        self._command = ""
        self._refusal = ""
        self._error = past.error
        """Error until the next reset."""
        self._cleared = False
        """Whether the port's calibration was cleared."""
        self._calibrating = False
        """Whether a calibration is under way. The port may then still report the earlier calibration."""
        self._handlers: Mapping[str, Callable[[str], None]] = {
            CALIBRATE: lambda _: self._calibrate(),
            CLEAR_CALIBRATION: lambda _: self._clear(),
            CONFIGURE: self._configure,
            GO: self._go,
            STOP: lambda _: self._stop(),
            RESET: lambda _: self._reset(),
            NO_OP: lambda _: None,
        }

    def hear(self, hardware: int, command: str, arguments: str, sender: str, sequence: int) -> None:
        """Handle a command. A command for another hardware id is ignored. A refused command counts as handled."""
        if hardware != HARDWARE_ID or (sender, sequence) == self._last:
            return
        self._last, self._command, self._refusal = (sender, sequence), command, ""
        try:
            if command not in self._handlers:
                raise _RefusedError(f"unknown command: {command!r}")
            if self._error and command in (CALIBRATE, CONFIGURE, GO):
                raise _RefusedError(f"in error: {self._error}")
            self._handlers[command](arguments)
        except DriverError as error:
            self._refusal = error.what
        except _RefusedError as error:
            self._refusal = str(error)

    def report(self) -> GripperReport:
        state = self._port.state()
        force = _share(state.force, FULL_FORCE)
        gripping = not state.moving and force > GRIPPING
        sender, sequence = self._last or ("", 0)
        return GripperReport(
            stamp=state.stamp,
            calibrated=self._calibrated(),
            ready=not (state.moving or self._calibrating),
            moving=state.moving,
            gripping=gripping,
            missed=self._command == GO and not (state.moving or gripping or self._refusal),
            position=_share(state.opening, self._port.max_opening),
            force=force,
            refusal=self._refusal or self._error,
            command=self._command,
            sender=sender,
            sequence=sequence,
        )

    def _configure(self, arguments: str) -> None:
        values = _values(arguments)
        known = {name: _percent(values[name], name) for name in PARAMETERS if name in values}
        self._parameters.update(known)

    def _go(self, arguments: str) -> None:
        values = _values(arguments)
        if "position" not in values:
            raise _RefusedError(f"go without a position: {arguments}")
        position = _percent(values["position"], "position")
        if not self._calibrated():
            raise _RefusedError("not calibrated")
        self._port.command(position / 100.0 * self._port.max_opening, self._holding())

    def _calibrated(self) -> bool:
        state = self._port.state()
        self._calibrating = self._calibrating and (state.moving or not state.calibrated)
        return state.calibrated and not (self._cleared or self._calibrating)

    def _calibrate(self) -> None:
        self._port.calibrate()
        self._cleared, self._calibrating = False, True

    def _clear(self) -> None:
        self._cleared = True

    def _reset(self) -> None:
        self._error = ""

    def _stop(self) -> None:
        state = self._port.state()
        if state.moving:
            self._port.command(state.opening, self._holding())

    def _holding(self) -> float:
        """Return the holding force [N]."""
        return self._parameters["holding_force"] / 100.0 * FULL_FORCE


def _share(value: float, full: float) -> float:
    return 100.0 * min(max(value / full, 0.0), 1.0)


def _values(arguments: str) -> dict[str, Any]:
    try:
        values = json.loads(arguments)
    except ValueError:
        values = None
    if not isinstance(values, dict):
        raise _RefusedError(f"the arguments are not a JSON object: {arguments!r}")
    return values


def _percent(value: Any, name: str) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        raise _RefusedError(f"{name} is not a number: {value!r}")
    return min(max(float(value), 0.0), 100.0)
