"""Progress as plain lines: cell time, state, and what failed. An observer of the runner."""

from __future__ import annotations

from typing import TextIO

from cell.context import Result
from cell.executive import Step
from cell.states import Event, State

__all__ = ["ProgressLines"]

_HINTS = {
    State.AWAITING_APPROVAL: "approve the fold (a), look again (r) or end the run (q)",
    State.ASKING: "try again (r), skip this fold (s) or end the run (q)",
    State.PAUSED: "resume (c) or end the run (q)",
}


class ProgressLines:
    """One line a state, one more for a failure. A terminal that is gone never hinders the run."""

    def __init__(self, stream: TextIO) -> None:
        self._stream: TextIO | None = stream

    def entered(self, t: float, step: Step) -> None:
        hint = _HINTS.get(step.target)
        self._say(f"{t:8.1f} s  {step.target.value.replace('_', ' ')}" + (f": {hint}" if hint else ""))

    def performed(self, t: float, step: Step, result: Result) -> None:
        failure = result.context.failure
        if failure is not None and result.event in {Event.FAILED, Event.CRASH, Event.STOP, Event.ABORT}:
            self._say(f"{t:8.1f} s    {failure}")

    def _say(self, text: str) -> None:
        if self._stream is None:
            return
        try:
            print(text, file=self._stream, flush=True)
        except (OSError, ValueError):  # a closed pipe or stream
            self._stream = None
