"""Deciding a run again: today's program, given what was read then, is compared with what was decided then.

The same runner, effects and skills go through the run; the ports answer from the transcript. Everything that the
executive asks and sends has to be what it was then, bit for bit, and so has every line of the journal. The first
difference ends it.
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
from typing import Any, Self

from cell.executive.effects import EFFECTS
from cell.executive.runner import Runner
from cell.hardware.assembly import assemble, load_robot
from cell.hardware.workcell import Workcell
from cell.recording.journal import Entry, Journal, RunRecord
from cell.recording.rerun import Recorder
from cell.recording.transcript.replay_ports import Answers, Halt, asked_in_words
from cell.recording.transcript.transcript import TRANSCRIPT, Transcript
from cell.recording.transcript.transcript_codec import Channel
from cell.runs.resumable import RESUMED_FROM
from cell.runs.run_inputs import initial_checkpoint, restored_request
from cell.states.commands import CommandQueue
from cell.states.fold_request import FoldRequest
from cell.states.observers import Observer, Step
from cell.states.run_context import Result, RunContext
from cell.states.run_end import RunEnd
from cell.states.transition_table import Event, State
from cell.support.files.paths import journal_path
from robots.errors import ConfigurationError, FailureKind, StorageError

__all__ = ["Deviation", "Verdict", "changed_versions", "decide_again", "first_difference"]

UNREPEATED = frozenset({"wall", "traceback", "not_kept"})
"""In the journal's payloads: what is of the wall's clock, of our own lines, and of the disk."""


@dataclass(frozen=True)
class Deviation:
    """Where a run that is decided again leaves what was decided then. cell_time_s: of the cell's clock.

    place: in the journal or the transcript; state, effect: what was under way (no effect: between two); then, now:
    what was done and what would be done, in words.
    """

    cell_time_s: float
    place: str
    state: str
    effect: str | None
    then: str
    now: str


@dataclass(frozen=True)
class Verdict:
    """What came of deciding a run again. deviation: None where all that was compared is the same.

    cell_time_s: as far as that goes. broken_off: why it does not go to the end of the run, where there is no
    deviation. effects, set_points, pictures, exchanges: how many were compared and the same. wall_time_s: what
    deciding took.
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
    run: RunRecord,
    entries: Sequence[Entry],
    observers: tuple[Observer, ...] = (),
    tell: Callable[[str], None] = lambda text: None,
    progress: Callable[[int, int, str], None] = lambda done, total, remark: None,
) -> Verdict:
    """Take the decisions of a run that has ended again, from where it began. entries: its lines in the journal.
    tell, progress: as `cell.hardware.assembly.assemble` has them.

    Raises ConfigurationError where the run cannot be set up as it was, StorageError where its transcript or a
    picture is missing or damaged.
    """
    if run.status == "running":
        raise ConfigurationError(f"the run {run.id} has not ended (pid {run.pid})", "try again when it has")
    began = time.monotonic()
    transcript = Transcript(run.directory / TRANSCRIPT)
    with tempfile.TemporaryDirectory(prefix="foldcell-") as scratch:
        request = restored_request(run.directory, Path(scratch))
        try:
            answers = Answers(transcript)
            again, where = _taken_again(request, _Beginning.of(run, entries), answers, observers, tell, progress)
        except Halt as halt:  # before anything was asked
            assert halt.trouble is not None
            raise halt.trouble from None
    if where.unrecorded is not None:
        raise where.unrecorded
    to_the_end = where.end is not None and answers.next is not None and answers.next.channel is Channel.END
    line = first_difference(entries, again, whole=to_the_end)
    deviation = broken_off = None
    if line is not None:
        deviation = line[1]
    elif where.halt is not None and where.halt.trouble is not None:
        raise where.halt.trouble
    elif not to_the_end:
        ledger_over = _was_cut_off(run) and len(again) > len(entries)
        deviation, broken_off = _how_it_left(where, answers, ledger_over)
    compared = again if line is None else again[: line[0]]
    return Verdict(
        deviation=deviation,
        broken_off=broken_off,
        cell_time_s=deviation.cell_time_s if deviation else answers.cell_time,
        effects=sum(1 for e in compared if e.kind == "result"),
        set_points=answers.asked.get(Channel.SET_POINT, 0),
        pictures=answers.asked.get(Channel.CAPTURE, 0) + answers.asked.get(Channel.GLIMPSE, 0),
        exchanges=answers.count,
        wall_time_s=time.monotonic() - began,
    )


def first_difference(
    then: Sequence[Entry], now: Sequence[Entry], whole: bool = True
) -> tuple[int, Deviation] | None:
    """Index of the first line in which two journals of a run differ, and the difference. whole: both go to the
    run's end; otherwise lines that only one of them has are not compared."""
    effect = None
    for i, (a, b) in enumerate(zip_longest(then, now) if whole else zip(then, now, strict=False)):
        if a is not None and b is not None and _essence(a) == _essence(b):
            effect = a.name if a.kind == "intent" else effect
            continue
        there = a or b
        between = there.kind == "event" and "from" in there.payload
        state = there.payload["from"] if between else there.state
        during = None if between else effect if there.kind == "event" else there.name
        return i, Deviation(there.cell_time, f"line {i + 1} of the journal", state, during, *_lines(a, b))
    return None


def changed_versions(then: Mapping[str, str]) -> dict[str, tuple[str, str]]:
    """Packages of another version than when a run was made: name -> (then, now)."""
    now = {name: _version(name) for name in then}
    return {name: (old, now[name]) for name, old in then.items() if now[name] != old}


class _Where:
    """Where a run that is decided again is, and how it ended: by its own rules, or with the answers."""

    def __init__(self) -> None:
        self.state, self.effect = State.IDLE.value, ""
        self.end: RunEnd | None = None
        self.halt: Halt | None = None
        self.unrecorded: StorageError | None = None
        """There was no room for the lines that are to be compared."""

    def entered(self, t: float, step: Step) -> None:
        self.state, self.effect = step.target.value, step.effect.value

    def performed(self, t: float, step: Step, result: Result) -> None:
        failure = result.context.failure
        if result.event is Event.UNRECORDED and failure is not None:
            self.unrecorded = StorageError(failure.what, "make room for temporary files")


@dataclass(frozen=True, eq=False)
class _Beginning:
    """How a run began. lines: in its journal before the machine's first; context, first: what the runner had."""

    lines: tuple[Entry, ...]
    context: RunContext
    first: Event

    @classmethod
    def of(cls, run: RunRecord, entries: Sequence[Entry]) -> Self:
        """Raises StorageError, ConfigurationError where what it began with cannot be read."""
        lines = tuple(e for e in entries[:1] if e.name == RESUMED_FROM)
        checkpoint = initial_checkpoint(run.directory)
        if lines and checkpoint is None:
            raise StorageError(
                f"the run {run.id} goes on with another one, and what it began with is missing",
                "have the other one decided again, or a new one",
            )
        return (
            cls(lines, RunContext(), Event.START) if checkpoint is None else cls(lines, checkpoint, Event.REENTER)
        )


def _taken_again(
    request: FoldRequest,
    beginning: _Beginning,
    answers: Answers,
    observers: tuple[Observer, ...],
    tell: Callable[[str], None],
    progress: Callable[[int, int, str], None],
) -> tuple[list[Entry], _Where]:
    """The decisions as they are taken now: the lines of a journal of their own, and how far it went."""
    where = _Where()
    with Journal.open(journal_path(request.logs)) as journal:
        run = journal.begin_run(garment=request.garment, seed=request.seed, driver=request.driver)
        try:
            for line in beginning.lines:
                run.event(line.cell_time, line.state, line.name, line.payload)
            with _workcell(request, answers, tell, progress) as (cell, commands):
                runner = Runner(cell, EFFECTS, run, commands, (where, *observers))
                where.end = runner.run(beginning.context, beginning.first)
        except Halt as halt:
            where.halt = halt
        finally:
            run.abandon()
        return journal.entries(run.id), where


@contextmanager
def _workcell(
    request: FoldRequest,
    answers: Answers,
    tell: Callable[[str], None],
    progress: Callable[[int, int, str], None],
) -> Iterator[tuple[Workcell, CommandQueue]]:
    """The cell of the run, with answers in place of ports."""
    commands, robot = answers.commands(), load_robot(request.settings)
    with ThreadPoolExecutor(1, "skill") as workers:
        try:
            cell = assemble(request, robot, answers.ports(), Recorder.silent(), commands, workers, tell, progress)
            yield replace(cell, watched_stop=answers.watched_stop()), commands
        finally:
            answers.abandoned = True  # what still computes ends soon


def _how_it_left(where: _Where, answers: Answers, ledger_over: bool) -> tuple[Deviation | None, str | None]:
    """Where not all of a run was gone along: what was decided otherwise, or why there is no more to compare.

    ledger_over: the run's own journal has no line for what is decided here.
    """
    there = answers.next
    if there is None:
        return None, "the transcript breaks off here"
    if ledger_over:  # it took no more lines then, and the run was ended for that
        return None, "the journal of the run breaks off here"
    then, now = asked_in_words(there), f"the end of the run: {where.state}"
    if where.halt is not None:
        then, now = where.halt.then, where.halt.now
    place = f"exchange {answers.count + 1} of the transcript"
    return Deviation(answers.cell_time, place, where.state, where.effect, then, now), None


def _was_cut_off(run: RunRecord) -> bool:
    """Whether the journal of a run took no more lines before it had ended, as far as it could tell."""
    failure = run.summary.get("failure") or {}
    return run.status == "interrupted" or failure.get("kind") == FailureKind.UNRECORDED


def _version(name: str) -> str:
    try:
        return metadata.version(name)
    except metadata.PackageNotFoundError:
        return "not installed"


# lines of a journal


def _essence(entry: Entry) -> tuple[Any, ...]:
    return entry.cell_time, entry.state, entry.kind, entry.name, entry.answers, _repeated(entry.payload)


def _repeated(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {k: _repeated(v) for k, v in value.items() if k not in UNREPEATED}
    return value


def _lines(then: Entry | None, now: Entry | None) -> tuple[str, str]:
    """Two lines in words, with the first figures in which they differ."""
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
    """All that a line says beyond its name, flat: keys with dots."""
    if entry is None:
        return {}
    flat = dict(_flat("", _repeated(entry.payload)))
    told = {"schema", "event", "kind", "what", "hint"}
    return {"cell time": entry.cell_time, **{k: v for k, v in flat.items() if k not in told}}


def _flat(prefix: str, value: Any) -> Iterator[tuple[str, Any]]:
    if isinstance(value, Mapping):
        for key, item in value.items():
            yield from _flat(f"{prefix}.{key}" if prefix else key, item)
    else:
        yield prefix, value
