"""Ask the person at the cell whether a garment is folded well, at the terminal and on the operator's page."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from queue import Empty, SimpleQueue
from typing import TextIO

from foldcell.cell.operator.console.run_status import RunStatus
from foldcell.cell.operator.progress.lines import say
from foldcell.cell.operator.terminal.keys import TypedLines
from foldcell.cell.record.judgement import Judgement, judgement_of

ASKED = "y if the garment is folded well, or n and why (n a sleeve lies open)"
UNSEEN = "u if nobody can tell any more: the run is then performed again"
POLL_S = 0.1


def ask_judgement(
    about: str,
    source: TextIO | None,
    page: RunStatus | None = None,
    ended: Callable[[], bool] = lambda: False,
    unseen: bool = False,
) -> Judgement | None:
    """Ask for the verdict and return the first answer. Returns None when nobody can answer any more, or when
    `ended` returns true.

    about: names the run. source: lines typed at the terminal; None: nobody types. page: the status behind the open
    page, if there is one. unseen: whether nobody may have seen the garment.
    """
    given: SimpleQueue[Judgement | None] = SimpleQueue()
    say(f"{about}: {ASKED}{f'; {UNSEEN}' if unseen else ''}, then Enter")
    if page is not None:
        page.judge(given.put)
    if source is not None:
        TypedLines.of(source).listen(_TypedVerdict(given.put, page is None, unseen))
    try:
        while not ended():
            with suppress(Empty):
                return given.get(timeout=POLL_S)
        return None
    finally:
        if page is not None:
            page.judge(None)


@dataclass(frozen=True)
class _TypedVerdict:
    """Listens to the terminal. alone: whether nobody can answer elsewhere."""

    give: Callable[[Judgement | None], None]
    alone: bool
    unseen: bool

    def take(self, line: str) -> None:
        judgement = judgement_of(line, self.unseen)
        if judgement is not None:
            self.give(judgement)
        elif line:
            say(f"'{line}' is no verdict: {ASKED}")

    def left(self) -> None:
        if self.alone:
            self.give(None)
