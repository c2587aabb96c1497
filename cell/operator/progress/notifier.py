"""Who follows a run, at the terminal and at the operator's page, and what they are told within a state."""

from __future__ import annotations

import sys
from dataclasses import dataclass

from cell.operator.console.run_status import RunStatus
from cell.operator.progress.lines import ProgressLines

__all__ = ["Notifier", "say"]


def say(text: str) -> None:
    """To the person who typed the command, whatever was asked to be printed."""
    print(text, file=sys.stderr, flush=True)


@dataclass(frozen=True)
class Notifier:
    """lines: of the terminal. board: what the page shows, also where none is open. quiet: no lines are printed.
    typed: whether answers may be typed."""

    lines: ProgressLines
    run_status: RunStatus
    quiet: bool
    typed: bool

    @property
    def watching(self) -> tuple[ProgressLines | RunStatus, ...]:
        return self.lines, self.run_status

    def note(self, text: str) -> None:
        """What happens within a state."""
        for watcher in self.watching:
            watcher.note(text)

    def computing(self, done: int, total: int, remark: str) -> None:
        """How far the state's long computing is."""
        for watcher in self.watching:
            watcher.computing(done, total, remark)

    def ask(self, what: str | None) -> None:
        """For something that the robot cannot do itself; None: it is not asked for any more."""
        self.run_status.ask(what)
        if what is not None:
            told = f"{what}, then approve" + (" (a, Enter)" if self.typed else "")
            say(told) if self.quiet else self.lines.note(told)
