"""An observer of the runner that writes to the Rerun recording."""

from __future__ import annotations

from cell.states.observers import FAILING, Step
from cell.states.run_context import Result
from cell.states.transition_table import Event
from cell.view.recorder import Recorder

__all__ = ["RecorderObserver"]


class RecorderObserver:
    """Records states, transitions, and failures including their hints."""

    def __init__(self, recorder: Recorder) -> None:
        self._recorder = recorder

    def entered(self, t: float, step: Step) -> None:
        self._recorder.state(t, step.target.value)
        self._recorder.event(t, f"{step.source.value} --{step.event.value}--> {step.target.value}")

    def performed(self, t: float, step: Step, result: Result) -> None:
        failure = result.context.failure
        if result.event in FAILING and failure is not None:
            level = "ERROR" if result.event in {Event.CRASH, Event.STOP, Event.UNRECORDED} else "WARN"
            self._recorder.event(t, str(failure), level)
