"""Ports and commands that answer from a transcript while the executive asks the recorded questions in order."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator, Set
from contextlib import suppress
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from cell.journal.frame_store import FRAMES, FrameStore
from cell.states.commands import CommandQueue
from cell.states.transition_table import Event
from cell.transcript.port_recorder import wanted_names
from cell.transcript.transcript import Transcript
from cell.transcript.transcript_codec import Channel, Exchange, Picture, Raised, pack, unpack
from robots.errors import CellError, StorageError
from robots.ports import (
    Array,
    BoardPlace,
    CameraFrame,
    GripperState,
    JointSetpoint,
    JointState,
    Ports,
    Side,
    StopState,
    TactileReading,
)

__all__ = ["NoRecordedAnswer", "RecordedAnswers", "asked_in_words"]


class NoRecordedAnswer(BaseException):
    """The transcript has no answer. This is a BaseException, so that no handler of the run catches it."""

    def __init__(self, then: str = "", now: str = "", trouble: CellError | None = None) -> None:
        """then, now: the recorded and the present question; both are empty if the transcript has ended. trouble:
        the error if the transcript or one of its pictures cannot be read."""
        super().__init__(now)
        self.then, self.now, self.trouble = then, now, trouble


@dataclass(eq=False)
class RecordedAnswers:
    """Reads the answers of a transcript in order. Create it on the thread of the executive."""

    transcript: Transcript
    cell_time: float = 0.0
    """Latest known time of the recorded clock [s]."""
    count: int = 0
    """Number of answered questions. Each was equal to the recorded question."""
    asked: dict[Channel, int] = field(default_factory=dict)
    """Number of answered questions of each channel."""
    abandoned: bool = False
    """Set this to true if the outcome is no longer needed. `stop_ahead` then reports a stop, so that computations
    end early. It also reports a stop at the end of the transcript, because nothing is left to compare."""

    def __post_init__(self) -> None:
        self._frames = FrameStore(self.transcript.path.parent / FRAMES)
        self._thread = threading.get_ident()
        self._stop = StopState(0.0, False)
        self._left: Iterator[Exchange] = iter(self.transcript)
        self._next = self._read()

    @property
    def next(self) -> Exchange | None:
        """The next recorded exchange; None: the transcript has ended."""
        return self._next

    def answer(self, channel: Channel, *arguments: object) -> Any:
        """Return the recorded answer. Raises the recorded exception, or NoRecordedAnswer if the recorded question
        is different."""
        question, exchange = pack(arguments), self._next
        if exchange is None:
            raise NoRecordedAnswer()
        if exchange.channel is not channel or exchange.question != question:
            raise NoRecordedAnswer(*_both_in_words(exchange, channel, arguments))
        self.count += 1
        self.asked[channel] = self.asked.get(channel, 0) + 1
        try:
            answer = unpack(exchange.answer)
            if isinstance(answer, Picture):
                answer = self._frames.get(answer.name)
        except ValueError as e:
            raise NoRecordedAnswer(trouble=self._damaged(e)) from None
        except StorageError as e:
            raise NoRecordedAnswer(trouble=e) from None
        if channel is Channel.NOW and isinstance(answer, float):
            self.cell_time = answer
        elif channel is Channel.SLEEP:
            self.cell_time = max(self.cell_time, *map(float, unpack(question)))
        elif isinstance(answer, StopState):
            self._stop = answer
        self._next = self._read()
        if isinstance(answer, Raised):
            raise answer.error
        return answer

    def stop_ahead(self) -> StopState:
        """Return the state of the stop without asking a recorded question: the next recorded answer if it is a
        state of the stop, else the last state."""
        exchange = self._next
        if exchange is None or self.abandoned:
            return StopState(self.cell_time, True, "the outcome is no longer needed")
        if exchange.channel is Channel.STOP:
            with suppress(ValueError):
                state = unpack(exchange.answer)
                if isinstance(state, StopState):
                    return state
        return self._stop

    @property
    def on_its_thread(self) -> bool:
        return threading.get_ident() == self._thread

    def ports(self) -> Ports:
        constants = self.transcript.constants
        openings = dict(constants.max_opening)
        return Ports(
            driver=constants.driver,
            simulated=constants.simulated,
            clock=_Clock(self),
            arms=_Arms(self, constants.command_timeout),
            head=_Head(self),
            grippers={side: _Gripper(self, side, opening) for side, opening in openings.items()},
            tactile={side: _Tactile(self, side) for side in openings},
            camera=_Camera(self),
            stop=_Stop(self),
            attendant=_Attendant(self),
        )

    def commands(self) -> CommandQueue:
        return _Commands(self)

    def watched_stop(self) -> _WatchedStop:
        return _WatchedStop(self)

    def _read(self) -> Exchange | None:
        try:
            return next(self._left, None)
        except StorageError as e:
            raise NoRecordedAnswer(trouble=e) from None

    def _damaged(self, why: Exception) -> StorageError:
        return StorageError(
            f"the transcript {self.transcript.path} is damaged after {self.count} exchanges: {why}",
            "use a copy from a backup, or another run",
        )


class _Port:
    def __init__(self, answers: RecordedAnswers) -> None:
        self._answers = answers


class _Clock(_Port):
    def now(self) -> float:
        return self._answers.answer(Channel.NOW)

    def sleep_until(self, t: float) -> None:
        self._answers.answer(Channel.SLEEP, t)


class _Arms(_Port):
    def __init__(self, answers: RecordedAnswers, command_timeout: float) -> None:
        super().__init__(answers)
        self.command_timeout = command_timeout

    def state(self) -> JointState:
        return self._answers.answer(Channel.ARMS)

    def enable(self) -> None:
        self._answers.answer(Channel.ENABLE)

    def command(self, q: Array, qd: Array) -> JointSetpoint:
        return self._answers.answer(Channel.SET_POINT, q, qd)


class _Head(_Port):
    def command_pan(self, angle: float) -> None:
        self._answers.answer(Channel.HEAD, angle)


class _Gripper(_Port):
    def __init__(self, answers: RecordedAnswers, side: Side, max_opening: float) -> None:
        super().__init__(answers)
        self.side, self.max_opening = side, max_opening

    def calibrate(self) -> None:
        self._answers.answer(Channel.CALIBRATE, self.side)

    def command(self, opening: float, force: float) -> None:
        self._answers.answer(Channel.GRIP, self.side, opening, force)

    def state(self) -> GripperState:
        return self._answers.answer(Channel.GRIPPER, self.side)


class _Tactile(_Port):
    def __init__(self, answers: RecordedAnswers, side: Side) -> None:
        super().__init__(answers)
        self.side = side

    def reading(self) -> TactileReading:
        return self._answers.answer(Channel.TACTILE, self.side)


class _Camera(_Port):
    def capture(self) -> CameraFrame:
        return self._answers.answer(Channel.CAPTURE)

    def glimpse(self) -> CameraFrame | None:
        return self._answers.answer(Channel.GLIMPSE)


class _WatchedStop(_Port):
    """The stop that is polled while a skill computes. It may be polled any number of times."""

    def trigger(self, reason: str) -> None: ...

    def state(self) -> StopState:
        return self._answers.stop_ahead()

    def reset(self) -> None: ...


class _Stop(_WatchedStop):
    def state(self) -> StopState:
        if not self._answers.on_its_thread:
            return self._answers.stop_ahead()
        return self._answers.answer(Channel.STOP)


class _Attendant(_Port):
    def lay_garment(self) -> None:
        self._answers.answer(Channel.LAY)

    def bring_board(self, place: BoardPlace) -> None:
        self._answers.answer(Channel.BOARD, place)


class _Commands(CommandQueue):
    """A command queue that answers the recorded questions with the recorded commands."""

    def __init__(self, answers: RecordedAnswers) -> None:
        super().__init__()
        self._answers = answers

    def take(self, wanted: Set[Event]) -> Event | None:
        return self._answers.answer(Channel.TAKE, wanted_names(wanted))

    def wait(self, wanted: Set[Event], seconds: float) -> Event | None:
        return self._answers.answer(Channel.WAIT, wanted_names(wanted))

    def edit(self) -> str:
        return str(self._answers.answer(Channel.EDIT))


# in words


def _both_in_words(recorded: Exchange, channel: Channel, arguments: tuple[Any, ...]) -> tuple[str, str]:
    """Return the recorded and the present question in words, with the largest difference of two set-points."""
    then, now = asked_in_words(recorded), _in_words(channel, arguments)
    if recorded.channel is Channel.SET_POINT and channel is Channel.SET_POINT:
        now += _difference(unpack(recorded.question), arguments)
    return then, now


def asked_in_words(exchange: Exchange) -> str:
    """Return the question of an exchange in words."""
    try:
        return _in_words(exchange.channel, unpack(exchange.question))
    except ValueError:
        return exchange.channel.value


def _in_words(channel: Channel, arguments: tuple[Any, ...]) -> str:
    try:
        return _WORDS[channel](*arguments)
    except (TypeError, ValueError, LookupError):
        return channel.value


def _difference(then: tuple[Array, Array], now: tuple[Array, Array]) -> str:
    for name, unit, a, b in zip(("position", "speed"), ("rad", "rad/s"), then, now, strict=True):
        if np.shape(a) != np.shape(b) or not np.size(a):
            continue
        off = np.abs(np.subtract(b, a)).ravel()
        joint = int(np.nanargmax(off)) if not np.isnan(off).all() else 0
        if not off[joint] <= 0.0:
            return f"; joint {joint}'s {name} differs most, by {off[joint]:.3g} {unit}"
    return ""


def _set_point(q: Array, qd: Array) -> str:
    return f"a set-point for the arms: ({', '.join(f'{v:.4f}' for v in q)}) rad"


_WORDS: dict[Channel, Callable[..., str]] = {
    Channel.NOW: lambda: "a reading of the clock",
    Channel.SLEEP: lambda t: f"waiting until {float(t)!r} s",
    Channel.ARMS: lambda: "a reading of the arms",
    Channel.ENABLE: lambda: "the arms' motors on",
    Channel.SET_POINT: _set_point,
    Channel.HEAD: lambda angle: f"the head to {float(angle)!r} rad",
    Channel.CALIBRATE: lambda side: f"calibrating the {side} gripper",
    Channel.GRIP: lambda side, opening, force: (
        f"the {side} gripper to {1e3 * float(opening)!r} mm with {float(force)!r} N"
    ),
    Channel.GRIPPER: lambda side: f"a reading of the {side} gripper",
    Channel.TACTILE: lambda side: f"a tactile reading of the {side} hand",
    Channel.CAPTURE: lambda: "a picture",
    Channel.GLIMPSE: lambda: "a picture for display",
    Channel.STOP: lambda: "a reading of the stop",
    Channel.LAY: lambda: "asking for the garment to be laid",
    Channel.BOARD: lambda place: f"asking for the board: {place}",
    Channel.TAKE: lambda wanted: f"a check for a command of the operator ({', '.join(wanted)})",
    Channel.WAIT: lambda wanted: f"waiting for a command of the operator ({', '.join(wanted)})",
    Channel.EDIT: lambda: "reading the operator's change of the plan",
    Channel.END: lambda: "the end of the run",
}
