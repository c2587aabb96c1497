"""State of the motors: enabling, the stop, its reset and the red button."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum, auto
from threading import Lock

from foldcell.robots.errors import DriverError
from foldcell.robots.ports import Arms, Array, Stop


class Button(Enum):
    """The emergency button. RELEASED: it was pressed and released, and the robot has not been reset since then."""

    UNPRESSED = auto()
    PRESSED = auto()
    RELEASED = auto()


@dataclass(frozen=True)
class MotorState:
    enabled: bool
    stopped: bool
    button: Button


class Motors:
    """The arms' motors and the stop circuit. `stop`, `press` and `release` may be called from any thread. The lock
    is only held for short times."""

    def __init__(self, arms: Arms, stop: Stop) -> None:
        self._arms, self._stop = arms, stop
        self._lock = Lock()
        self._enabled = False
        self._button = Button.UNPRESSED
        self._stops = 0

    def stop(self, reason: str) -> None:
        with self._lock:
            self._stops += 1
            self._stop.trigger(reason)

    def press(self) -> None:
        with self._lock:
            self._stops += 1
            self._button = Button.PRESSED
            self._stop.trigger("the emergency button was pressed")

    def release(self) -> None:
        with self._lock:
            if self._button is Button.PRESSED:
                self._button = Button.RELEASED

    @property
    def stops(self) -> int:
        """Number of stops so far. It identifies a reset that arrived before the last stop: such a reset must not
        lift that stop."""
        return self._stops

    def state(self) -> MotorState:
        with self._lock:
            return self._state()

    def _state(self) -> MotorState:
        stopped = self._stop.state().stopped
        self._enabled = self._enabled and not stopped
        return MotorState(self._enabled, stopped, self._button)

    def enable(self) -> bool:
        """Switch the motors on. Returns False if they were already on, or if the robot refuses or is stopped. The
        arms are enabled in any case, because a restored cell has its motors off."""
        with self._lock:
            state = self._state()
            if state.stopped:
                return False
            try:
                self._arms.enable()
            except DriverError:
                return False
            self._enabled = True
            return not state.enabled

    def disable(self) -> None:
        with self._lock:
            self._enabled = False

    def reset(self, stops: int) -> None:
        """Leave the stop with the motors off. stops: number of stops when the reset was requested."""
        with self._lock:
            if self._button is Button.PRESSED or stops != self._stops:
                return
            self._button = Button.UNPRESSED
            self._enabled = False
            self._stop.reset()

    def command(self, q: Array, qd: Array) -> None:
        """Send q, qd (14,) to the arms if the motors are on. A refusal by the arms switches the motors off."""
        with self._lock:
            if not self._state().enabled:
                return
            try:
                self._arms.command(q, qd)
            except DriverError:
                self._enabled = False
