"""Print progress as plain lines: cell time, state and failures. The printer is an observer of the runner.

The notifier sends the messages of a run to the terminal and to the operator's page.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass
from typing import TYPE_CHECKING, TextIO

from foldcell.cell.operator.progress.bar import ProgressBar
from foldcell.cell.record.words import plain
from foldcell.cell.states.observers import FAILING, Step
from foldcell.cell.states.run_context import Result
from foldcell.cell.states.stages import Repair, Spread
from foldcell.cell.states.transition_table import Event, State

if TYPE_CHECKING:
    from foldcell.cell.operator.console.run_status import RunStatus

_HINTS = {
    State.AWAITING_APPROVAL: "approve the fold (a), look again (r), skip it (s) or end the run (q)",
    State.AWAITING_PRESSING: "approve pressing it flat (a), look again (r), skip it (s) or end the run (q)",
    State.ASKING: "lay the garment as it was before this fold and look again (r), skip this fold (s)"
    " or end the run (q)",
    State.PAUSED: "resume (c) or end the run (q)",
}
_REPAIR_HINT = "approve the repair (a), look again (r) or end the run (q)"

_LAST = frozenset({Event.ASK, Event.GIVE_UP})


class ProgressLines:
    """Prints one line per state and per failure, and a bar for long computations. Without a stream it prints
    nothing. A closed terminal does not affect the run."""

    def __init__(self, stream: TextIO | None) -> None:
        self._bar = ProgressBar(stream)
        self._repair: Repair | Spread | None = None

    def entered(self, t: float, step: Step) -> None:
        hint = _HINTS.get(step.target)
        if step.target is State.AWAITING_APPROVAL and self._repair is not None:
            hint = f"{self._repair.in_words()}: {_REPAIR_HINT}"
        self._bar.line(f"{t:8.1f} s  {plain(step.target)}" + (f": {hint}" if hint else ""))
        self._bar.restart()

    def performed(self, t: float, step: Step, result: Result) -> None:
        failure, self._repair = result.context.failure, result.context.fold.repair
        if failure is not None and result.event in FAILING:
            self._bar.line(f"{t:8.1f} s    {failure}")
        if result.event is Event.ASK and result.context.asking:
            self._bar.line(f"{t:8.1f} s    asked because {result.context.asking}")
        if step.target is State.RECOVERING and result.event in _LAST and result.context.setting:
            self._bar.line(f"{t:8.1f} s    the limit: {result.context.setting}")
        if step.target is State.RECOGNISING and result.event is Event.DONE and result.context.recognition:
            self._bar.line(f"{t:8.1f} s    recognised: {result.context.recognition.in_words()}")

    def computing(self, done: int, total: int, remark: str) -> None:
        """Show the progress of a long computation."""
        self._bar.update(done, total, remark)

    def note(self, text: str) -> None:
        """Show a message about what happens in the present state."""
        self._bar.line(f"{'':12}{text}")


def say(text: str) -> None:
    """Print to standard error, where it never mixes with JSON output."""
    print(text, file=sys.stderr, flush=True)


@dataclass(frozen=True)
class Notifier:
    """Sends messages to all places where a person may read them. lines: printer of lines for the terminal.
    run_status: status for the page, used whether or not a page is open. quiet: whether no lines are printed.
    typed: whether the operator can type answers."""

    lines: ProgressLines
    run_status: RunStatus
    quiet: bool
    typed: bool

    def note(self, text: str) -> None:
        """Show a message about what happens in the present state."""
        self.lines.note(text)
        self.run_status.note(text)

    def computing(self, done: int, total: int, remark: str) -> None:
        """Show the progress of a long computation."""
        self.lines.computing(done, total, remark)
        self.run_status.computing(done, total, remark)

    def ask(self, what: str | None) -> None:
        """Ask the person for something that the robot cannot do. None withdraws the request."""
        self.run_status.ask(what)
        if what is not None:
            text = f"{what}, then approve" + (" (a, Enter)" if self.typed else "")
            say(text) if self.quiet else self.lines.note(text)
