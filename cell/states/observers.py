"""Observers of the runner: one feeds the view, one keeps what went wrong and what was done about it."""

from __future__ import annotations

from dataclasses import dataclass

from cell.executive.machine import Step
from cell.recording.rerun import Recorder
from cell.states.context import Result
from cell.states.transition_table import Effect, Event

__all__ = ["FAILING", "RecorderObserver", "Remark", "Remarks"]

FAILING = frozenset({Event.FAILED, Event.CRASH, Event.STOP, Event.ABORT, Event.UNRECORDED})


class RecorderObserver:
    """States and transitions into the recording; failures with their hints."""

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


@dataclass(frozen=True)
class Remark:
    """kind: 'failure', 'recovery' or 'command'."""

    t: float
    kind: str
    title: str
    text: str


class Remarks:
    """Failures, recoveries and the operator's commands in order, for the report."""

    def __init__(self) -> None:
        self.list: list[Remark] = []

    def entered(self, t: float, step: Step) -> None: ...

    def performed(self, t: float, step: Step, result: Result) -> None:
        failure = result.context.failure
        where = step.target.value.replace("_", " ")
        self.list += [Remark(when, "command", what, f"on the way, while {where}") for when, what in result.within]
        if result.event in FAILING and failure is not None:
            kind = failure.kind.value.replace("_", " ")
            hint = f" ({failure.hint})" if failure.hint else ""
            self.list.append(Remark(t, "failure", f"{kind} while {where}", failure.what + hint))
        elif step.effect is Effect.CHOOSE_RECOVERY:
            text = str(result.record.get("change", "none")).replace("_", " ")
            title = result.event.value.replace("_", " ")
            self.list.append(Remark(t, "recovery", title, "" if text == "none" else f"change: {text}"))
        elif "command" in result.record:
            self.list.append(Remark(t, "command", str(result.record["command"]), f"while {where}"))
        elif result.event is Event.PAUSE:
            self.list.append(Remark(t, "command", "pause", f"before {where}"))
