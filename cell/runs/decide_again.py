"""Replay the decisions of a recorded run with the present program and find the first deviation.

The replay uses the same runner, effects and skills as a run, but its ports answer from the transcript. Every
request and command of the executive, and every line of the journal, must be bit for bit as recorded. The first
difference ends the replay.
"""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass, replace
from importlib import metadata
from itertools import zip_longest
from pathlib import Path
from typing import Any

from foldcell.cell.executive.effects import EFFECTS
from foldcell.cell.executive.runner import Runner
from foldcell.cell.hardware.assembly import assemble
from foldcell.cell.hardware.robot_model import load_robot
from foldcell.cell.hardware.workcell import Workcell
from foldcell.cell.journal.journal import Entry, Journal, JournalRun
from foldcell.cell.record.run_record import record_of
from foldcell.cell.runs.request_file import initial_checkpoint, restored_request
from foldcell.cell.runs.resumable import RESUMED_FROM
from foldcell.cell.states.commands import CommandQueue
from foldcell.cell.states.fold_request import FoldRequest
from foldcell.cell.states.observers import Observer, Step
from foldcell.cell.states.run_context import Result, RunContext, RunEnd
from foldcell.cell.states.transition_table import Event, State
from foldcell.cell.support.files.paths import journal_path
from foldcell.cell.support.json_values import flattened
from foldcell.cell.transcript.channels import Channel
from foldcell.cell.transcript.replay_ports import NoRecordedAnswer, RecordedAnswers
from foldcell.cell.transcript.transcript import TRANSCRIPT, Transcript
from foldcell.cell.view.recorder import Recorder
from foldcell.robots.errors import ConfigurationError, FailureKind, StorageError

UNREPEATED = frozenset({"wall", "traceback", "not_kept"})
"""Payload keys of the journal that are not compared, because they depend on the wall clock, the source lines or
the disk."""


@dataclass(frozen=True)
class Deviation:
    """First difference between the replay and the recorded run. cell_time_s: time of the cell's clock [s].

    place: line of the journal or exchange of the transcript; state, effect: state and effect at that moment
    (effect None: between two effects); then, now: the recorded and the present action, in words.
    """

    cell_time_s: float
    place: str
    state: str
    effect: str | None
    then: str
    now: str


@dataclass(frozen=True)
class Verdict:
    """Result of a replay. deviation: None if everything that was compared is the same.

    cell_time_s: cell time up to which the run was compared [s]; broken_off: the reason why the comparison ends
    before the run's end without a deviation, else None. effects, set_points, pictures, exchanges: number of each
    that were compared and found the same. wall_time_s: duration of the replay [s].
    """

    deviation: Deviation | None
    broken_off: str | None
    cell_time_s: float
    effects: int
    set_points: int
    pictures: int
    exchanges: int
    wall_time_s: float

    @property
    def same(self) -> bool:
        return self.deviation is None


def decide_again(
    run: JournalRun,
    entries: Sequence[Entry],
    observers: tuple[Observer, ...] = (),
    tell: Callable[[str], None] = lambda text: None,
    progress: Callable[[int, int, str], None] = lambda done, total, remark: None,
) -> Verdict:
    """Replay a run that has ended, from its beginning. entries: the run's lines in the journal. tell, progress: as
    in `foldcell.cell.hardware.assembly.assemble`.

    Raises ConfigurationError if the run cannot be set up as it was, StorageError if its transcript or a picture is
    missing or damaged.
    """
    if run.status == "running":
        raise ConfigurationError(f"the run {run.id} has not ended (pid {run.pid})", "try again when it has")
    began = time.monotonic()
    transcript = Transcript(run.directory / TRANSCRIPT)
    with tempfile.TemporaryDirectory(prefix="foldcell-") as scratch:
        request = restored_request(run.directory, Path(scratch))
        try:
            answers = RecordedAnswers(transcript)
            lines, replay = _replay(request, _beginning(run, entries), answers, observers, tell, progress)
        except NoRecordedAnswer as halt:  # the transcript cannot be read
            assert halt.trouble is not None
            raise halt.trouble from None
    if replay.unrecorded is not None:
        raise replay.unrecorded
    completed = replay.end is not None and answers.next is not None and answers.next.channel is Channel.END
    difference = first_difference(entries, lines, whole=completed)
    deviation = broken_off = None
    if difference is not None:
        deviation = difference[1]
    elif replay.halt is not None and replay.halt.trouble is not None:
        raise replay.halt.trouble
    elif not completed:
        beyond_journal = _was_cut_off(run) and len(lines) > len(entries)
        deviation, broken_off = _why_incomplete(replay, answers, beyond_journal)
    compared = lines if difference is None else lines[: difference[0]]
    return Verdict(
        deviation=deviation,
        broken_off=broken_off,
        cell_time_s=deviation.cell_time_s if deviation else answers.cell_time,
        effects=sum(1 for e in compared if e.kind == "result"),
        set_points=answers.asked[Channel.SET_POINT],
        pictures=answers.asked[Channel.CAPTURE] + answers.asked[Channel.GLIMPSE],
        exchanges=answers.asked.total(),
        wall_time_s=time.monotonic() - began,
    )


def first_difference(
    then: Sequence[Entry], now: Sequence[Entry], whole: bool = True
) -> tuple[int, Deviation] | None:
    """Return the index of the first line in which two journals of a run differ, and the difference; None if there
    is none. whole: whether both journals reach the run's end. If not, the additional lines of the longer journal
    are not compared."""
    effect = None
    for i, (a, b) in enumerate(zip_longest(then, now) if whole else zip(then, now, strict=False)):
        if a is not None and b is not None and _essence(a) == _essence(b):
            effect = a.name if a.kind == "intent" else effect
            continue
        entry = a or b
        transition = entry.kind == "event" and "from" in entry.payload
        state = entry.payload["from"] if transition else entry.state
        during = None if transition else effect if entry.kind == "event" else entry.name
        return i, Deviation(entry.cell_time, f"line {i + 1} of the journal", state, during, *_lines(a, b))
    return None


def changed_versions(then: Mapping[str, str]) -> dict[str, tuple[str, str]]:
    """Return the packages whose version has changed since a run was made: name -> (then, now)."""
    now = {name: _version(name) for name in then}
    return {name: (old, now[name]) for name, old in then.items() if now[name] != old}


class _ReplayState:
    """An observer that stores the present state and effect of the replay. end: set if the state machine ended the
    replay; halt: set if the ports ended the replay because the transcript has no answer."""

    def __init__(self) -> None:
        self.state, self.effect = State.IDLE.value, ""
        self.end: RunEnd | None = None
        self.halt: NoRecordedAnswer | None = None
        self.unrecorded: StorageError | None = None
        """Set if the replay's own journal could not be written."""

    def entered(self, t: float, step: Step) -> None:
        self.state, self.effect = step.target.value, step.effect.value

    def performed(self, t: float, step: Step, result: Result) -> None:
        failure = result.context.failure
        if result.event is Event.UNRECORDED and failure is not None:
            self.unrecorded = StorageError(failure.what, "make room for temporary files")


def _beginning(run: JournalRun, entries: Sequence[Entry]) -> tuple[Sequence[Entry], RunContext, Event]:
    """Return how a run began: the lines of its journal before the state machine's first line, and the runner's
    first context and event. Raises StorageError or ConfigurationError if the run's initial checkpoint cannot be
    read."""
    lines = tuple(e for e in entries[:1] if e.name == RESUMED_FROM)
    checkpoint = initial_checkpoint(run.directory)
    if lines and checkpoint is None:
        raise StorageError(
            f"the run {run.id} resumed another one, and its initial checkpoint is missing",
            "decide the other run again, or a new one",
        )
    return (lines, RunContext(), Event.START) if checkpoint is None else (lines, checkpoint, Event.REENTER)


def _replay(
    request: FoldRequest,
    beginning: tuple[Sequence[Entry], RunContext, Event],
    answers: RecordedAnswers,
    observers: tuple[Observer, ...],
    tell: Callable[[str], None],
    progress: Callable[[int, int, str], None],
) -> tuple[list[Entry], _ReplayState]:
    """Run the present program on the recorded answers. Returns the lines of the replay's own journal, and how the
    replay ended."""
    replay = _ReplayState()
    earlier, context, first = beginning
    with Journal.open(journal_path(request.logs)) as journal:
        run = journal.begin_run(garment=request.garment, seed=request.seed, driver=request.driver)
        try:
            for line in earlier:
                run.event(line.cell_time, line.state, line.name, line.payload)
            with _workcell(request, answers, tell, progress) as (cell, commands):
                runner = Runner(cell, EFFECTS, run, commands, (replay, *observers))
                replay.end = runner.run(context, first)
        except NoRecordedAnswer as halt:
            replay.halt = halt
        finally:
            run.abandon()
        return journal.entries(run.id), replay


@contextmanager
def _workcell(
    request: FoldRequest,
    answers: RecordedAnswers,
    tell: Callable[[str], None],
    progress: Callable[[int, int, str], None],
) -> Iterator[tuple[Workcell, CommandQueue]]:
    """Assemble the workcell of the run, with ports that answer from the transcript."""
    commands, robot = answers.commands(), load_robot(request.settings)
    with ThreadPoolExecutor(1, "skill") as workers:
        try:
            cell = assemble(request, robot, answers.ports(), Recorder.silent(), commands, workers, tell, progress)
            yield replace(cell, watched_stop=answers.watched_stop()), commands
        finally:
            answers.abandoned = True  # this ends a skill that is still computing


def _why_incomplete(
    replay: _ReplayState, answers: RecordedAnswers, beyond_journal: bool
) -> tuple[Deviation | None, str | None]:
    """Return the reason why a replay ended before the run's end: a deviation, or a text if nothing more can be
    compared.

    beyond_journal: the replay has more journal lines than the run.
    """
    recorded = answers.next
    if recorded is None:
        return None, "the transcript breaks off here"
    if beyond_journal:  # the journal of the recorded run lacks its last lines
        return None, "the journal of the run breaks off here"
    then, now = recorded.in_words(), f"the end of the run: {replay.state}"
    if replay.halt is not None:
        then, now = replay.halt.then, replay.halt.now
    place = f"exchange {answers.asked.total() + 1} of the transcript"
    return Deviation(answers.cell_time, place, replay.state, replay.effect, then, now), None


def _was_cut_off(run: JournalRun) -> bool:
    """Whether the journal of a run may lack its last lines."""
    record = record_of(run.summary)
    failure = record.failure if record else None
    return run.status == "interrupted" or (failure is not None and failure.kind is FailureKind.UNRECORDED)


def _version(name: str) -> str:
    try:
        return metadata.version(name)
    except metadata.PackageNotFoundError:
        return "not installed"


# lines of a journal


def _essence(entry: Entry) -> tuple[Any, ...]:
    return entry.cell_time, entry.state, entry.kind, entry.name, entry.answers, _repeatable(entry.payload)


def _repeatable(value: Any) -> Any:
    """Return the value without the keys that are not compared."""
    if isinstance(value, Mapping):
        return {k: _repeatable(v) for k, v in value.items() if k not in UNREPEATED}
    return value


def _lines(then: Entry | None, now: Entry | None) -> tuple[str, str]:
    """Describe two lines in words, with up to four figures in which they differ."""
    a, b = _figures(then), _figures(now)
    differ = [key for key in a if key in b and a[key] != b[key]][:4]
    return _line(then, a, differ), _line(now, b, differ)


def _line(entry: Entry | None, figures: Mapping[str, Any], differ: Sequence[str]) -> str:
    if entry is None:
        return "nothing: the run was over"
    if entry.kind == "result":
        text = f"{entry.name} ends: {entry.payload.get('event')}"
    elif entry.kind == "intent":
        text = f"{entry.name} begins"
    else:
        text = f"{entry.name} -> {entry.state}" if "from" in entry.payload else entry.name
    if "what" in entry.payload:
        text += f", {entry.payload.get('kind')}: {entry.payload['what']}"
    return text + (f" ({', '.join(f'{key} {figures[key]}' for key in differ)})" if differ else "")


def _figures(entry: Entry | None) -> dict[str, Any]:
    """Return the time and figures of a journal line as a flat mapping: nested keys are joined by dots."""
    if entry is None:
        return {}
    flat = dict(flattened(_repeatable(entry.payload)))
    in_text = {"schema", "event", "kind", "what", "hint"}
    return {"cell time": entry.cell_time, **{k: v for k, v in flat.items() if k not in in_text}}
