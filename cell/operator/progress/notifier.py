"""Sends the messages of a run to the terminal and to the operator's page."""

from __future__ import annotations

import sys
from dataclasses import dataclass

from foldcell.cell.operator.console.run_status import RunStatus
from foldcell.cell.operator.progress.lines import ProgressLines

__all__ = ["Notifier", "say"]


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

    @property
    def watching(self) -> tuple[ProgressLines | RunStatus, ...]:
        return self.lines, self.run_status

    def note(self, text: str) -> None:
        """Show a message about what happens in the present state."""
        for watcher in self.watching:
            watcher.note(text)

    def computing(self, done: int, total: int, remark: str) -> None:
        """Show the progress of a long computation."""
        for watcher in self.watching:
            watcher.computing(done, total, remark)

    def ask(self, what: str | None) -> None:
        """Ask the person for something that the robot cannot do. None withdraws the request."""
        self.run_status.ask(what)
        if what is not None:
            text = f"{what}, then approve" + (" (a, Enter)" if self.typed else "")
            say(text) if self.quiet else self.lines.note(text)
