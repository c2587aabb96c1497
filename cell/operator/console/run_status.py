"""The status of the run for the operator's page: an observer that stores the latest value of everything that the
page shows.

Any thread may write to it (the executive, a skill, a source of commands) and read it. A reader always gets a
consistent snapshot.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

from foldcell.cell.executive.machine import complete_table
from foldcell.cell.journal.checkpoint_file import has_checkpoint
from foldcell.cell.operator.console.questions import RECOGNISED, consequences, plan_facts, question
from foldcell.cell.record.judgement import Judgement
from foldcell.cell.record.run_record import RunRecord
from foldcell.cell.record.run_record_builder import RunRecordBuilder
from foldcell.cell.record.words import COMMANDS, capital, claim_in_words, garment_name, plain
from foldcell.cell.states.commands import ANSWERS, OPERATOR_EVENTS
from foldcell.cell.states.observers import Step
from foldcell.cell.states.run_context import Result, RunContext
from foldcell.cell.states.transition_table import TERMINAL, Event, State
from foldcell.cell.support.files.paths import command_for

ORDER = (Event.APPROVE, Event.RETRY, Event.SKIP, Event.PAUSE, Event.RESUME, Event.ABORT)
ASKING = (State.AWAITING_APPROVAL, State.AWAITING_PRESSING, State.ASKING)
REMARKS_SHOWN = 60

_ALLOWED: Mapping[State, frozenset[Event]] = {
    state: frozenset(row.event for row in complete_table() if row.state is state) & OPERATOR_EVENTS
    for state in State
}


class RunStatus:
    """The status of one run. `snapshot` returns the content of the page. `version` grows with every change of the
    content. record: the record that grows with the run."""

    def __init__(self, record: RunRecordBuilder) -> None:
        self._lock = threading.Lock()
        self.record = record
        request, simulated = record.request, record.simulated
        self._about = {
            "run": record.folder.name, "garment": garment_name(request.garment),
            "seed": request.seed if simulated else None, "simulated": simulated,
        }  # fmt: skip
        self._state = State.IDLE
        self._context = RunContext()
        self._question = 0
        self._pausing = False
        self._progress: dict[str, Any] | None = None
        self._note = ""
        self._wanted: str | None = None
        self._end: dict[str, Any] | None = None
        self._judge: Callable[[Judgement], None] | None = None
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

    def judge(self, judge: Callable[[Judgement], None] | None) -> None:
        """Ask for the verdict on the folded garment, and pass it to `judge`. None withdraws the question."""
        with self._lock:
            self._judge = judge
            self._question += judge is not None
            self.version += 1

    def note_command(self, command: Event) -> None:
        """Note a command from the page or the terminal. After PAUSE, the page offers RESUME in its place."""
        with self._lock:
            self._pausing = command is Event.PAUSE or (self._pausing and command in ANSWERS)
            self.version += 1

    def finish(self, record: RunRecord) -> None:
        """Store the end of the run."""
        folder, failure = Path(record.run_dir), record.failure
        with self._lock:
            unfinished = record.state in {State.STOPPED, State.FAULT} and not self._context.through
            resumable = unfinished and has_checkpoint(folder)
            self._end = {
                "result": record.state.value, "report": str(folder / "report.html"),
                "what": failure.what if failure else "", "hint": failure.hint if failure else "",
                "claim": claim_in_words(record.claim),
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

    def judged(self, question: int, judgement: Judgement) -> bool:
        """Pass the verdict on. Returns False if `question` is not the number of the open question about it."""
        with self._lock:
            judge = self._judge if question == self._question else None
        if judge is not None:
            judge(judgement)
        return judge is not None

    def snapshot(self) -> dict[str, Any]:
        with self._lock:
            allowed = self._allowed_now()
            return {
                **self._about,
                "version": self.version,
                "state": self._state.value,
                "allowed": [event.value for event in ORDER if event in allowed],
                "labels": {event.value: capital(words) for event, words in COMMANDS.items()},
                "question": self._asked_now(),
                "facts": [
                    fact for fact in plan_facts(self._context) if self._end is None or fact[0] == RECOGNISED
                ],
                "steps": self._steps(),
                "remarks": [asdict(event) for event in self.record.events[-REMARKS_SHOWN:]],
                "progress": self._progress,
                "note": self._note,
                "pausing": self._pausing,
                "end": self._end,
                "judging": self._question if self._judge else None,
            }

    def _allowed_now(self) -> frozenset[Event]:
        if self._end is not None or self._state in TERMINAL:
            return frozenset()
        allowed = _ALLOWED[self._state] - ({Event.PAUSE} if self._asking() else set())  # no motion to pause
        if self._state is State.AWAITING_APPROVAL and self._context.fold.repair is not None:
            allowed -= {Event.SKIP}
        allowed |= {Event.APPROVE, Event.ABORT} if self._wanted else set()
        return allowed - {Event.PAUSE} | {Event.RESUME} if self._pausing and Event.PAUSE in allowed else allowed

    def _asking(self) -> bool:
        return self._state in ASKING or self._wanted is not None

    def _asked_now(self) -> dict[str, Any] | None:
        """Return the present question: its number, its text, the effect of each answer, and whether it has a
        picture. A question with a picture can be approved only when the picture is on the screen."""
        if not self._asking():
            return None
        return {
            "number": self._question,
            "text": question(self._state, self._context)
            if self._wanted is None
            else f"Please {self._wanted}. Then approve.",
            "answers": dict(consequences(self._state, bool(self._context.steps), self._context.fold.repair)),
            "pictured": self._state in ASKING and self._context.sight.shown is not None,
        }

    def _steps(self) -> list[dict[str, Any]]:
        context = self._context
        made = {note.name for note in context.done}
        return [
            {"name": plain(step.name), "done": step.name in made, "now": k == context.fold.index}
            for k, step in enumerate(context.steps)
        ]
