"""An observer of the runner. It collects failures, estimates, recoveries and commands for the report."""

from __future__ import annotations

from dataclasses import dataclass

from cell.states.commands import COMMAND_WORDS
from cell.states.observers import FAILING, Step
from cell.states.run_context import Result
from cell.states.transition_table import Effect, Event

__all__ = ["RunEvent", "RunEvents"]


@dataclass(frozen=True)
class RunEvent:
    """One event at cell time t [s]. kind: 'failure', 'recovery', 'estimate' or 'command'."""

    t: float
    kind: str
    title: str
    text: str


class RunEvents:
    """Collects failures, estimates, recoveries and the operator's commands in order."""

    def __init__(self) -> None:
        self.list: list[RunEvent] = []

    def entered(self, t: float, step: Step) -> None: ...

    def performed(self, t: float, step: Step, result: Result) -> None:
        failure = result.context.failure
        where = step.target.value.replace("_", " ")
        self.list += [
            RunEvent(t_command, "command", command, f"while {where}") for t_command, command in result.within
        ]
        if result.event in FAILING and failure is not None:
            kind = failure.kind.value.replace("_", " ")
            hint = f" ({failure.hint})" if failure.hint else ""
            self.list.append(RunEvent(t, "failure", f"{kind} while {where}", failure.what + hint))
        elif step.effect is Effect.CHOOSE_RECOVERY:
            text = str(result.record.get("change", "none")).replace("_", " ")
            title = result.event.value.replace("_", " ")
            self.list.append(RunEvent(t, "recovery", title, "" if text == "none" else f"change: {text}"))
        elif step.effect is Effect.ESTIMATE:
            self.list.append(RunEvent(t, "estimate", "state of the garment", str(result.record.get("says", ""))))
        elif "command" in result.record:
            self.list.append(RunEvent(t, "command", _words(result.record["command"]), f"while {where}"))
        elif result.event is Event.PAUSE:
            self.list.append(RunEvent(t, "command", "pause", f"before {where}"))


def _words(command: object) -> str:
    return COMMAND_WORDS[Event(str(command))]
