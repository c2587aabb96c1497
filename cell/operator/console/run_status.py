"""The status of the run for the operator's page: an observer that stores the latest value of everything that the
page shows.

Any thread may write to it (the executive, a skill, a source of commands) and read it. A reader always gets a
consistent snapshot.
"""

from __future__ import annotations

import threading
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

from cell.executive.machine import complete_table
from cell.journal.checkpoint_file import has_checkpoint
from cell.operator.console.facts import RECOGNISED, consequences, plan_facts
from cell.report.run_events import RunEvents
from cell.states.commands import ANSWERS, COMMAND_WORDS, OPERATOR_EVENTS
from cell.states.observers import Step
from cell.states.run_context import Result, RunContext
from cell.states.stages import Spread
from cell.states.transition_table import TERMINAL, Event, State
from cell.support.files.paths import command_for
from robots.errors import Failure
from skills.perception.inspection.claim import Claim

__all__ = ["ORDER", "RunStatus"]

ORDER = (Event.APPROVE, Event.RETRY, Event.SKIP, Event.PAUSE, Event.RESUME, Event.ABORT)
UNPREDICTED = (
    "the garment lies in no known state, so the end of a pull cannot be predicted; the cell looks after it"
)
ASKING = (State.AWAITING_APPROVAL, State.AWAITING_PRESSING, State.ASKING)
REMARKS_SHOWN = 60

_ALLOWED: Mapping[State, frozenset[Event]] = {
    state: frozenset(row.event for row in complete_table() if row.state is state) & OPERATOR_EVENTS
    for state in State
}


class RunStatus:
    """The status of one run. `snapshot` returns the content of the page. `version` grows with every change of the
    content."""

    def __init__(self, run_id: str, garment: str, seed: int, simulated: bool) -> None:
        self._lock = threading.Lock()
        self._remarks = RunEvents()
        shown_seed = seed if simulated else None
        self._about = {"run": run_id, "garment": Path(garment).stem, "seed": shown_seed, "simulated": simulated}
        self._state = State.IDLE
        self._context = RunContext()
        self._question = 0
        self._pausing = False
        self._progress: dict[str, Any] | None = None
        self._note = ""
        self._wanted: str | None = None
        self._end: dict[str, Any] | None = None
        self.version = 0

    # observer of the runner

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

    # messages within a state

    def computing(self, done: int, total: int, remark: str) -> None:
        with self._lock:
            self._progress = {"done": done, "total": total, "remark": remark}
            self.version += 1

    def note(self, text: str) -> None:
        with self._lock:
            self._note = text
            self.version += 1

    def ask(self, what: str | None) -> None:
        """Ask the person at the cell to do something and then approve. None withdraws the request."""
        with self._lock:
            self._wanted = what
            self._question += what is not None
            self.version += 1

    def note_command(self, command: Event) -> None:
        """Note a command from the page or the terminal. After PAUSE, the page offers RESUME in its place."""
        with self._lock:
            self._pausing = command is Event.PAUSE or (self._pausing and command in ANSWERS)
            self.version += 1

    def finish(self, state: State, failure: Failure | None, folder: Path) -> None:
        """Set how the run ended, and its folder."""
        with self._lock:
            unfinished = state in {State.STOPPED, State.FAULT} and not self._context.through
            resumable = unfinished and has_checkpoint(folder)
            self._end = {
                "result": state.value, "report": str(folder / "report.html"),
                "what": failure.what if failure else "", "hint": failure.hint if failure else "",
                "claim": _claimed(self._context.claim()),
                "go_on": command_for(f"resume {folder.name}", folder.parent) if resumable else "",
            }  # fmt: skip
            self.version += 1

    # used by the page

    def allowed(self) -> frozenset[Event]:
        """Return the commands that are possible now."""
        with self._lock:
            return self._allowed_now()

    def answers(self, question: object) -> bool:
        """Whether `question` is the number of the present question."""
        with self._lock:
            return self._asking() and question == self._question

    def snapshot(self) -> dict[str, Any]:
        with self._lock:
            allowed = self._allowed_now()
            return {
                **self._about,
                "version": self.version,
                "state": self._state.value,
                "allowed": [event.value for event in ORDER if event in allowed],
                "labels": {event.value: words.capitalize() for event, words in COMMAND_WORDS.items()},
                "question": self._asked_now(),
                "facts": [
                    fact for fact in plan_facts(self._context) if self._end is None or fact[0] == RECOGNISED
                ],
                "steps": self._steps(),
                "remarks": [asdict(remark) for remark in self._remarks.list[-REMARKS_SHOWN:]],
                "progress": self._progress,
                "note": self._note,
                "pausing": self._pausing,
                "end": self._end,
            }

    def _allowed_now(self) -> frozenset[Event]:
        if self._end is not None or self._state in TERMINAL:
            return frozenset()
        allowed = _ALLOWED[self._state] - ({Event.PAUSE} if self._asking() else set())  # no motion to pause
        if self._state is State.AWAITING_APPROVAL and self._context.fold.repair is not None:
            allowed -= {Event.SKIP}
        allowed |= {Event.APPROVE} if self._wanted else set()
        return allowed - {Event.PAUSE} | {Event.RESUME} if self._pausing and Event.PAUSE in allowed else allowed

    def _asking(self) -> bool:
        return self._state in ASKING or self._wanted is not None

    def _asked_now(self) -> dict[str, Any] | None:
        """Return the present question: its number, its text, what each answer does, and whether it has a picture,
        which then has to be on the screen before it can be approved."""
        if not self._asking():
            return None
        return {
            "number": self._question,
            "text": self._asked(),
            "answers": dict(consequences(self._state, bool(self._context.steps), self._context.fold.repair)),
            "pictured": self._state in ASKING and self._context.sight.frame is not None,
        }

    def _asked(self) -> str:
        context = self._context
        if self._wanted is not None:
            return f"Please {self._wanted}. Then approve."
        if self._state is State.ASKING:
            failure = context.failure
            lay_again = (
                "before the cell looks again, lay the garment as it was before this fold" if context.steps else ""
            )
            why = f"the cell asks because {context.asking}" if context.asking else ""
            if failure is None:
                return "How should the run continue?"
            limit = f"the limit is {context.setting}" if context.setting else ""
            return _sentences(failure.what, why, failure.hint, limit, lay_again)
        fold, steps, attempt = context.fold, context.steps, context.fold.attempt
        words = (steps[fold.index].name, steps[fold.index].variant) if steps else ("the fold",)
        name = ", ".join(word.replace("_", " ") for word in words if word)
        count = f"Fold {fold.index + 1} of {len(steps)}: {name}."
        if self._state is State.AWAITING_PRESSING:
            inspection = attempt.inspection if attempt else None
            height = f"{1e3 * inspection.height_m:.0f} mm high" if inspection else "too high"
            return f"{count} The fold is made and is {height}. Press it flat? Skip leaves it as it is."
        if attempt is None:
            return count
        if isinstance(fold.repair, Spread):
            why = UNPREDICTED if not fold.repair.home else "the garment lies flat, but not where it was laid"
            return _sentences(count.rstrip("."), why, fold.repair.in_words())
        if fold.repair is not None:
            return _sentences(f"{count} The fold is not as planned and can be repaired: {fold.repair.in_words()}")
        if fold.refused_edit:
            count = f"Your change is not possible ({fold.refused_edit}); this is the plan without it. {count}"
        elif fold.edits:
            count = f"Changed: {fold.edits[-1].in_words()}. {count}"
        source = "taken from the library" if attempt.trajectory.source == "library" else "optimised now"
        error_mm = 1e3 * attempt.dissimilarity_m
        error = (
            f"; its predicted mean distance from the ideal fold is {error_mm:.1f} mm" if error_mm >= 0.0 else ""
        )
        return f"{count} The arc was {source}{error}."

    def _steps(self) -> list[dict[str, Any]]:
        context = self._context
        made = {note.name for note in context.done}
        return [
            {"name": step.name.replace("_", " "), "done": step.name in made, "now": k == context.fold.index}
            for k, step in enumerate(context.steps)
        ]


def _claimed(claim: Claim | None) -> str:
    return f"{claim.says}, reliability {100 * claim.reliability:.0f} %" if claim else ""


def _sentences(*parts: str) -> str:
    """Join the non-empty parts as sentences."""
    return " ".join(f"{part[0].upper()}{part[1:]}." for part in parts if part)
