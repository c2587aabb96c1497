"""Perform one run, from a request to its record: open the cell, observe, run, score, record, report.

However the run ends, its end is written to the journal, the recording is closed and the record is written. Ctrl-C
and a termination signal trigger the stop circuit, and the state machine ends in a terminal state.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace

from foldcell.cell.executive.effects import EFFECTS
from foldcell.cell.executive.runner import EffectFunction, Runner
from foldcell.cell.hardware.assembly import assemble
from foldcell.cell.hardware.camera import camera_calibration
from foldcell.cell.hardware.driver import OpenCell, PersonAt, check_cell, opened_cell, simulation_settings
from foldcell.cell.hardware.driver_names import is_simulated
from foldcell.cell.hardware.placement import refuse_unfit_folds
from foldcell.cell.hardware.robot_model import load_robot
from foldcell.cell.journal.journal import RunJournal
from foldcell.cell.operator.progress.compiling import report_compilation
from foldcell.cell.operator.terminal.attendant import LAY, PersonAttendant
from foldcell.cell.operator.terminal.keys import check_terminal
from foldcell.cell.record.judgement import Judgement
from foldcell.cell.record.run_record import FailureRecord, RecordingLosses, RunRecord, write_record
from foldcell.cell.runs.checkpoint_writer import CheckpointWriter, Interrupted
from foldcell.cell.runs.compiling_ahead import compiling_ahead
from foldcell.cell.runs.ownership import VERSIONED, begun_run, owned_cell
from foldcell.cell.runs.request_file import keep_request, keep_run_inputs
from foldcell.cell.runs.resumable import RESUMED_FROM, check_resumable
from foldcell.cell.runs.run_observers import RunObservers, page_listener
from foldcell.cell.simulation import SimulationSettings
from foldcell.cell.states.commands import CommandQueue
from foldcell.cell.states.fold_request import FoldRequest
from foldcell.cell.states.observers import Observer
from foldcell.cell.states.run_context import RunContext, RunEnd
from foldcell.cell.states.transition_table import Effect, Event, State
from foldcell.cell.support.process.signals import Interrupts
from foldcell.robots.errors import FailureKind, StorageError
from foldcell.robots.ports import Attendant, Ports, Stop
from foldcell.skills.scoring.verdict import Score

OnOpen = Callable[[OpenCell, CommandQueue], Ports | None]
"""Called with the cell and the command queue before the first effect. May return other ports, which the executive
then uses."""


@dataclass(frozen=True)
class Attendance:
    """The part of a person in a run of a campaign.

    begin: a request to the person before anything moves. lay: the request to lay the garment. recorded: called
    when the journal has the end of the run. judge: called when all files of the run are written and the operator's
    page is still open, with a function that asks the person for the verdict on the garment.
    """

    begin: str
    lay: str
    recorded: Callable[[RunRecord], None]
    judge: Callable[[Callable[[], Judgement | None]], None]


@compiling_ahead()
def fold_once(
    request: FoldRequest,
    on_open: OnOpen | None = None,
    observers: Sequence[Observer] = (),
    interrupted: Interrupted | None = None,
    instead: Mapping[Effect, EffectFunction] | None = None,
    attendance: Attendance | None = None,
) -> RunRecord:
    """Perform one run, or resume an interrupted one. on_open, observers: used by tests and HIL scripts. The given
    observers are added to the run's own observers. instead: effects that replace the run's own, for a
    step of the ladder. attendance: of a person; None: the run asks no more of a person than its driver and
    `request` say.

    Raises ConfigurationError and StorageError before anything moves. If the journal cannot be written later, the
    run ends in a fault with the arms held.
    """
    began = time.monotonic()
    _check(request, attendance)
    with (
        owned_cell(request.logs) as (interrupts, journal),
        page_listener(request) as listener,
        ExitStack() as after,
    ):
        if interrupted:  # checked while the lock is held: no other process can resume it now
            check_resumable(journal, interrupted.run)
        packages = (*VERSIONED, "mujoco") if request.world == "mujoco" else VERSIONED
        with begun_run(journal, request.garment, request.seed, request.driver, request.settings, packages) as run:
            keep_request(run.directory, request)
            if request.record:
                keep_run_inputs(run.directory, request, interrupted.context if interrupted else None)
            resumed_from = interrupted.run if interrupted else None
            watching = RunObservers(request, run, began, resumed_from, listener, observers)
            end, score, losses = _perform(
                request, run, watching, on_open, interrupted, interrupts, instead or {}, attendance, after
            )
            signal = interrupts.received[0] if interrupts.received else None
            record = _end_in_journal(run, watching.record.record(end, score, losses, signal))
            if attendance:
                attendance.recorded(record)
        if record.result == "folded" or end.context.through:
            CheckpointWriter(run.directory, None).forget()
        record = _with_files(request, record, end.context, watching)
        if attendance:
            attendance.judge(lambda: watching.judgement(lambda: bool(interrupts.received)))
        return record


def _check(request: FoldRequest, attendance: Attendance | None) -> None:
    """Raises ConfigurationError for a request that cannot be performed."""
    check_cell(request.driver, _simulated(request))
    refuse_unfit_folds([request.garment], request.settings)
    needs_operator = request.approve or not is_simulated(request.driver) or attendance is not None
    if needs_operator and request.terminal and not request.page:
        check_terminal(sys.stdin)


def _perform(
    request: FoldRequest,
    run: RunJournal,
    watching: RunObservers,
    on_open: OnOpen | None,
    interrupted: Interrupted | None,
    interrupts: Interrupts,
    instead: Mapping[Effect, EffectFunction],
    attendance: Attendance | None,
    after: ExitStack,
) -> tuple[RunEnd, Score | None, RecordingLosses]:
    """Open the cell, run the state machine and score the garment. Everything is closed when this returns, except
    that the operator's page stays open until `after` is closed if a person judges the garment there."""
    robot, notifier = load_robot(request.settings), watching.notifier

    def person(stop: Stop, hands: Attendant | None = None) -> PersonAttendant:
        lay = attendance.lay if attendance else LAY
        return PersonAttendant(watching.commands, stop, notifier.ask, lay, hands)

    try:
        with (
            report_compilation(watching.lines.note),
            _opened(request, interrupted, person) as opened,
            ThreadPoolExecutor(1, "skill") as workers,
            ExitStack() as during,
        ):
            asked = request.approve or not opened.ports.simulated or attendance is not None
            during.enter_context(interrupts.stop(opened.ports, asked))
            (after if attendance else during).enter_context(watching.page(opened.ports.stop))
            own = (on_open(opened, watching.commands) if on_open is not None else None) or opened.ports
            own = watching.pictured(own, opened)
            attendant = own.attendant
            if attendance and not isinstance(attendant, PersonAttendant):
                attendant = person(own.stop, attendant)
                own = replace(own, attendant=attendant)
            if isinstance(attendant, PersonAttendant):
                attendant.clock, attendant.stop = own.clock, own.stop
            ports, commands = watching.recorded(own)
            cell = assemble(
                request, robot, ports, watching.recorder, commands, workers, notifier.note, notifier.computing
            )
            cell = replace(cell, watched_stop=own.stop, laid_by_person=isinstance(attendant, PersonAttendant))
            watching.watch_truth(opened)
            watching.listen_to_terminal(asked)
            if attendance and isinstance(attendant, PersonAttendant):
                attendant.wait_for(attendance.begin)
            checkpoint_writer = CheckpointWriter(
                run.directory,
                opened.simulated.checkpoint.save if opened.simulated else None,
                watching.frames,
            )
            context, first = (interrupted.context, Event.REENTER) if interrupted else (RunContext(), Event.START)
            checkpoint_writer.keep(context)  # first: from here on, the run can be resumed if the process dies
            if interrupted:
                run.event(opened.ports.clock.now(), State.IDLE.value, RESUMED_FROM, {"run": interrupted.run})
            runner = Runner(cell, {**EFFECTS, **instead}, run, commands, watching.all, checkpoint_writer.keep)
            end = runner.run(context, first)
            watching.run_ended(end)
            score = watching.score(end)
    finally:
        losses = watching.close()
    return end, score, losses


def _end_in_journal(run: RunJournal, record: RunRecord) -> RunRecord:
    """Write the record to the journal. If this fails, the result becomes a fault."""
    try:
        run.end(record.result, record.as_json())
    except StorageError as e:
        run.abandon()
        if record.failure is None:
            return replace(record, result="fault", failure=FailureRecord(FailureKind.UNRECORDED, e.what, e.hint))
        if record.failure.kind is FailureKind.UNRECORDED:
            return replace(record, result="fault")
        return replace(record, result="fault", unwritten=(e.what,))
    return record


def _with_files(request: FoldRequest, record: RunRecord, context: RunContext, watching: RunObservers) -> RunRecord:
    """Write result.json and the report. Files that cannot be written are listed in the returned record."""
    try:
        write_record(record)
        if request.record:
            from foldcell.cell.report.report import report

            truth = watching.truth
            frames, triangles = (truth.key_frames, truth.triangles) if truth else ([], None)
            calibration, stories = camera_calibration(request.settings), watching.stories.stories
            report(record, context, request.settings, calibration, frames, triangles, stories)
    except StorageError as e:
        return replace(record, unwritten=(*record.unwritten, e.what))
    return record


@contextmanager
def _opened(request: FoldRequest, interrupted: Interrupted | None, person: PersonAt) -> Iterator[OpenCell]:
    """Open the cell. The saved world of a resumed simulated run is restored before the stop can be triggered."""
    with opened_cell(request.driver, _simulated(request), request.seed, request.settings, person) as cell:
        if interrupted and interrupted.world is not None and cell.simulated is not None:
            cell.simulated.checkpoint.restore(interrupted.world)
        yield cell


def _simulated(request: FoldRequest) -> SimulationSettings:
    cell = simulation_settings(request.settings, request.realtime, request.settings.calibrated)
    return replace(cell, garment=request.garment, world=request.world)
