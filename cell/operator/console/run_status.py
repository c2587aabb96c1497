"""What the operator's page shows, as the run goes: an observer that keeps the last word on everything.

Any thread may write to it (the executive's, a skill's, whoever gives a command) and read: a reader always gets a
whole snapshot.
"""

from __future__ import annotations

import threading
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

from cell.executive.machine import complete_table
from cell.recording.checkpoint.run_checkpoint import has_checkpoint
from cell.recording.report.run_events import RunEvents
from cell.states.commands import ANSWERS, OPERATOR_EVENTS
from cell.states.observers import Step
from cell.states.run_context import Result, RunContext
from cell.states.transition_table import TERMINAL, Event, State
from cell.support.files.paths import command_for
from robots.errors import Failure

__all__ = ["ORDER", "RunStatus"]

ORDER = (Event.APPROVE, Event.RETRY, Event.SKIP, Event.PAUSE, Event.RESUME, Event.ABORT)
ASKING = (State.AWAITING_APPROVAL, State.AWAITING_PRESSING, State.ASKING)
REMARKS_SHOWN = 60

_ALLOWED: Mapping[State, frozenset[Event]] = {
    state: frozenset(row.event for row in complete_table() if row.state is state) & OPERATOR_EVENTS
    for state in State
}


class RunStatus:
    """`snapshot` is what a page shows now, `version` changes with it."""

    def __init__(self, run_id: str, garment: str, seed: int, simulated: bool) -> None:
        self._lock = threading.Lock()
        self._remarks = RunEvents()
        drawn = seed if simulated else None
        self._about = {"run": run_id, "garment": Path(garment).stem, "seed": drawn, "simulated": simulated}
        self._state = State.IDLE
        self._context = RunContext()
        self._question = 0
        self._pausing = False
        self._progress: dict[str, Any] | None = None
        self._note = ""
        self._wanted: str | None = None
        self._end: dict[str, Any] | None = None
        self.version = 0

    # the runner's observer

    def entered(self, t: float, step: Step) -> None:
        with self._lock:
            self._state = step.target
            self._pausing, self._progress, self._note = False, None, ""
            if step.target in ASKING:
                self._question += 1
            self.version += 1

    def performed(self, t: float, step: Step, result: Result) -> None:
        with self._lock:
            self._remarks.performed(t, step, result)
            self._context = result.context
            self.version += 1

    # what is said within a state

    def computing(self, done: int, total: int, remark: str) -> None:
        with self._lock:
            self._progress = {"done": done, "total": total, "remark": remark}
            self.version += 1

    def note(self, text: str) -> None:
        with self._lock:
            self._note = text
            self.version += 1

    def ask(self, what: str | None) -> None:
        """Something that the person at the cell is to do, and to approve when it is done; None: it is."""
        with self._lock:
            self._wanted = what
            self._question += what is not None
            self.version += 1

    def heard(self, command: Event) -> None:
        """A command was given, here or at the terminal: a motion that pauses can be resumed."""
        with self._lock:
            self._pausing = command is Event.PAUSE or (self._pausing and command in ANSWERS)
            self.version += 1

    def finish(self, state: State, failure: Failure | None, folder: Path) -> None:
        """How the run ended, and the folder that it leaves."""
        with self._lock:
            unfinished = state in {State.STOPPED, State.FAULT} and not self._context.through
            resumable = unfinished and has_checkpoint(folder)
            self._end = {
                "result": state.value, "report": str(folder / "report.html"),
                "what": failure.what if failure else "", "hint": failure.hint if failure else "",
                "go_on": command_for(f"resume {folder.name}", folder.parent) if resumable else "",
            }  # fmt: skip
            self.version += 1

    # the page's side

    def allowed(self) -> frozenset[Event]:
        """What may be said now."""
        with self._lock:
            return self._may_be_said()

    def answers(self, question: object) -> bool:
        """Whether this is the question that is asked now."""
        with self._lock:
            return self._asking() and question == self._question

    def snapshot(self) -> dict[str, Any]:
        with self._lock:
            may = self._may_be_said()
            return {
                **self._about,
                "version": self.version,
                "state": self._state.value,
                "allowed": [event.value for event in ORDER if event in may],
                "labels": {"retry": "Try again"} if self._state is State.ASKING else {},
                "question": {"number": self._question, "text": self._asked()} if self._asking() else None,
                "steps": self._steps(),
                "remarks": [asdict(remark) for remark in self._remarks.list[-REMARKS_SHOWN:]],
                "progress": self._progress,
                "note": self._note,
                "end": self._end,
            }

    def _may_be_said(self) -> frozenset[Event]:
        if self._end is not None or self._state in TERMINAL:
            return frozenset()
        may = _ALLOWED[self._state] - ({Event.PAUSE} if self._asking() else set())  # it stands still
        may |= {Event.APPROVE} if self._wanted else set()
        return may - {Event.PAUSE} | {Event.RESUME} if self._pausing and Event.PAUSE in may else may

    def _asking(self) -> bool:
        return self._state in ASKING or self._wanted is not None

    def _asked(self) -> str:
        context = self._context
        if self._wanted is not None:
            return f"Please {self._wanted}. Then approve."
        if self._state is State.ASKING:
            failure = context.failure
            laid = "to try again, first lay the garment as it was before this fold" if context.steps else ""
            return _sentences(failure.what, failure.hint, laid) if failure else "What now?"
        fold, steps, attempt = context.fold, context.steps, context.fold.attempt
        words = (steps[fold.index].name, steps[fold.index].variant) if steps else ("the fold",)
        name = ", ".join(word.replace("_", " ") for word in words if word)
        count = f"Fold {fold.index + 1} of {len(steps)}: {name}."
        if self._state is State.AWAITING_PRESSING:
            seen = attempt.inspection if attempt else None
            high = f"{1e3 * seen.height_m:.0f} mm high" if seen else "high"
            return f"{count} It is made and stands {high}: press it flat? Skip leaves it so."
        if attempt is None:
            return count
        source = "looked up in the library" if attempt.trajectory.source == "library" else "optimised now"
        missed = 1e3 * attempt.dissimilarity_m
        end = f"; it is predicted to end {missed:.1f} mm from the ideal fold on average" if missed >= 0.0 else ""
        return f"{count} The arc was {source}{end}."

    def _steps(self) -> list[dict[str, Any]]:
        context = self._context
        made = {note.name for note in context.done}
        return [
            {"name": step.name.replace("_", " "), "done": step.name in made, "now": k == context.fold.index}
            for k, step in enumerate(context.steps)
        ]


def _sentences(*parts: str) -> str:
    """Parts of which some may be empty, one sentence each, the first as it begins."""
    first, *more = [part for part in parts if part]
    return " ".join(f"{part}." for part in (first, *(part[0].upper() + part[1:] for part in more)))
