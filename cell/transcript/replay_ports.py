"""Ports and commands that answer from a transcript while the executive asks the recorded questions in order."""

from __future__ import annotations

import threading
from collections import Counter
from collections.abc import Callable, Iterator, Set
from dataclasses import dataclass, field
from functools import partial
from types import SimpleNamespace
from typing import Any, cast

import numpy as np

from foldcell.cell.journal.frame_store import FRAMES, FrameStore
from foldcell.cell.states.commands import CommandQueue
from foldcell.cell.states.transition_table import Event
from foldcell.cell.support.forwarding import forwarding
from foldcell.cell.transcript.channels import Channel, build_ports
from foldcell.cell.transcript.transcript import Transcript
from foldcell.cell.transcript.transcript_codec import Exchange, Picture, pack, unpack
from foldcell.robots.errors import CellError, StorageError
from foldcell.robots.ports import Ports, Side, Stop, StopState


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
    asked: Counter[Channel] = field(default_factory=Counter)
    """Number of answered questions of each channel. Each was equal to the recorded question."""
    abandoned: bool = False
    """Set this to true if the outcome is no longer needed. `stop_ahead` then reports a stop, so that computations
    end early. It also reports a stop at the end of the transcript, because nothing is left to compare."""

    def __post_init__(self) -> None:
        self._frames = FrameStore(self.transcript.path.parent / FRAMES)
        self._thread = threading.get_ident()
        self._stop = StopState(0.0, False)
        self._left: Iterator[Exchange] = iter(self.transcript)
        self.next = self._read()
        """The next recorded exchange; None: the transcript has ended."""

    def answer(self, channel: Channel, *arguments: object) -> Any:
        """Return the recorded answer. Raises the recorded exception, or NoRecordedAnswer if the recorded question
        is different."""
        question, exchange = pack(arguments), self.next
        if exchange is None:
            raise NoRecordedAnswer()
        if exchange.channel is not channel or exchange.question != question:
            raise NoRecordedAnswer(*_both_in_words(exchange, Exchange(channel, question, None)))
        self.asked[channel] += 1
        answer = exchange.answer
        if isinstance(answer, Picture):
            try:
                answer = self._frames.get(answer.name)
            except StorageError as e:
                raise NoRecordedAnswer(trouble=e) from None
        self.cell_time = exchange.time_after(self.cell_time)
        if isinstance(answer, StopState):
            self._stop = answer
        self.next = self._read()
        if isinstance(answer, Exception):
            raise answer
        return answer

    def stop_ahead(self) -> StopState:
        """Return the state of the stop without asking a recorded question: the next recorded answer if it is a
        state of the stop, else the last state."""
        exchange = self.next
        if exchange is None or self.abandoned:
            return StopState(self.cell_time, True, "the outcome is no longer needed")
        if exchange.channel is Channel.STOP and isinstance(exchange.answer, StopState):
            return exchange.answer
        return self._stop

    def ports(self) -> Ports:
        def method(channel: Channel, sides: tuple[Side, ...]) -> Callable[..., Any]:
            return self._stop_state if channel is Channel.STOP else partial(self.answer, channel, *sides)

        return build_ports(self.transcript.constants, method, self.watched_stop())

    def _stop_state(self) -> StopState:
        if threading.get_ident() != self._thread:
            return self.stop_ahead()
        state: StopState = self.answer(Channel.STOP)
        return state

    def commands(self) -> CommandQueue:
        """Return a command queue that answers the recorded questions with the recorded commands."""

        def take(channel: Channel, wanted: Set[Event], *_: float) -> Event | None:
            taken = self.answer(channel, sorted(wanted))
            return None if taken is None else Event(taken)

        return forwarding(
            CommandQueue(), take=partial(take, Channel.TAKE), wait=partial(take, Channel.WAIT),
            edit=partial(self.answer, Channel.EDIT),
        )  # fmt: skip

    def watched_stop(self) -> Stop:
        """Return the stop that is polled while a skill computes. It may be polled any number of times."""
        nothing: Callable[..., None] = lambda *_: None  # noqa: E731
        return cast(Stop, SimpleNamespace(trigger=nothing, state=self.stop_ahead, reset=nothing))

    def _read(self) -> Exchange | None:
        try:
            return next(self._left, None)
        except StorageError as e:
            raise NoRecordedAnswer(trouble=e) from None


# in words


def _both_in_words(recorded: Exchange, present: Exchange) -> tuple[str, str]:
    """Return the recorded and the present question in words, with the largest difference of two set-points."""
    then, now = recorded.in_words(), present.in_words()
    if recorded.channel is present.channel is Channel.SET_POINT:
        now += _difference(unpack(recorded.question), unpack(present.question))
    return then, now


def _difference(then: list[Any], now: list[Any]) -> str:
    for name, unit, a, b in zip(("position", "speed"), ("rad", "rad/s"), then, now, strict=True):
        if np.shape(a) != np.shape(b) or not np.size(a):
            continue
        off = np.abs(np.subtract(b, a)).ravel()
        joint = int(np.nanargmax(off)) if not np.isnan(off).all() else 0
        if not off[joint] <= 0.0:
            return f"; joint {joint}'s {name} differs most, by {off[joint]:.3g} {unit}"
    return ""
