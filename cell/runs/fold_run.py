"""Perform one run, from a request to a result: open the cell, run the state machine, score, report, close.

However the run ends, its end is written to the journal, the recording is closed and the result is written. Ctrl-C
and a termination signal trigger the stop circuit, and the state machine ends in a terminal state.
"""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import AbstractContextManager, contextmanager, nullcontext
from dataclasses import dataclass, replace
from pathlib import Path
from socket import socket
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from cell.config.garments.garment_file import load_garment
from cell.executive.effects import EFFECTS
from cell.executive.runner import Runner
from cell.hardware.assembly import assemble
from cell.hardware.camera import camera_calibration, camera_mount
from cell.hardware.cell_check import refuse_unfit_cell
from cell.hardware.driver import OpenCell, PersonAt, check_cell, is_simulated, opened_cell
from cell.hardware.placement import refuse_too_large
from cell.hardware.robot_model import load_robot
from cell.journal.journal import RunJournal
from cell.operator.console.run_status import RunStatus
from cell.operator.progress.compiling import report_compilation
from cell.operator.progress.lines import ProgressLines
from cell.operator.progress.notifier import Notifier, say
from cell.operator.terminal.attendant import PersonAttendant
from cell.operator.terminal.keys import TerminalOperator, check_terminal, in_foreground
from cell.report.camera_pictures.question_files import QuestionFiles
from cell.report.failure_stories import FailureStories, FailureStory
from cell.report.run_events import RunEvent, RunEvents
from cell.runs.checkpoint_writer import CheckpointWriter, Interrupted
from cell.runs.fold_result import failure_to_dict, fold_result
from cell.runs.ownership import VERSIONED, begun_run, owned_cell
from cell.runs.request_file import keep_request
from cell.runs.resumable import RESUMED_FROM, check_resumable
from cell.runs.run_inputs import keep_run_inputs
from cell.simulation import SimulationSettings
from cell.states.commands import CommandQueue
from cell.states.fold_request import FoldRequest, FoldResult
from cell.states.observers import Observer
from cell.states.run_context import RunContext
from cell.states.run_end import RunEnd
from cell.states.transition_table import Event, State
from cell.support.files.whole_file import write_whole
from cell.support.process.interrupts import Interrupts
from cell.transcript.port_recorder import PortRecorder
from cell.view import Recorder
from cell.view.observer import RecorderObserver
from robots.errors import CellError, Failure, FailureKind, StorageError
from robots.ports import Ports
from robots.registry import find_robot
from robots.visual import RobotVisual

if TYPE_CHECKING:
    from cell.operator.console.supervision import Supervision
    from cell.report.pictures.recorded_holds import TrueFrame

__all__ = ["FoldRequest", "FoldResult", "fold_once"]

RECORDING = "run.rrd"
JUDGED = (State.FOLDED, State.NOT_FOLDED)
"""Ends of a run after which the ideal fold is waited for, if all folds were made."""
OnOpen = Callable[[OpenCell, CommandQueue], Ports | None]
"""Called with the cell and the command queue before the first effect. May return other ports, which the executive
then uses."""


def fold_once(
    request: FoldRequest,
    on_open: OnOpen | None = None,
    observers: Sequence[Observer] = (),
    interrupted: Interrupted | None = None,
) -> FoldResult:
    """Perform one run, or resume an interrupted one. on_open, observers: used by tests and HIL scripts; the
    observers are added to those of the run.

    Raises ConfigurationError and StorageError before anything moves. If the journal cannot be written later, the
    run ends in a fault with the arms held.
    """
    began = time.monotonic()
    check_cell(request.driver, _simulated(request))
    refuse_unfit_cell(request.settings)
    if request.garment != "auto":
        refuse_too_large(load_garment(request.garment, request.settings.surface), request.settings)
    needs_operator = request.approve or not is_simulated(request.driver)
    if needs_operator and request.terminal and not request.page:
        check_terminal(sys.stdin)
    with owned_cell(request.logs) as (interrupts, journal), _listener(request) as listener:
        if interrupted:  # checked while the lock is held: no other process can resume it now
            check_resumable(journal, interrupted.run)
        packages = (*VERSIONED, "mujoco") if request.world == "mujoco" else VERSIONED
        with begun_run(journal, request.garment, request.seed, request.driver, request.settings, packages) as run:
            ended = _perform(request, run, began, on_open, observers, listener, interrupted, interrupts)
            result = _end_in_journal(run, ended.result)
        if result.result == "folded" or ended.end.context.through:
            CheckpointWriter(run.directory, None).forget()
        return _with_files(run.directory, request, replace(ended, result=result))


def _end_in_journal(run: RunJournal, result: FoldResult) -> FoldResult:
    """Write the result to the journal. If this fails, the result becomes a fault."""
    try:
        run.end(result.result, result.as_json())
    except StorageError as e:
        run.abandon()
        failure = failure_to_dict(Failure(FailureKind.UNRECORDED, e.what, e.hint))
        if result.failure is None or result.failure["kind"] == FailureKind.UNRECORDED:
            return replace(result, result="fault", failure=result.failure or failure)
        return replace(result, result="fault", unwritten=(e.what,))
    return result


def _with_files(folder: Path, request: FoldRequest, ended: _Ended) -> FoldResult:
    """Write result.json and the report. Files that cannot be written are listed in the returned result."""
    result = ended.result
    try:
        write_whole(folder / "result.json", json.dumps(result.as_json(), indent=1) + "\n")
        if request.record:
            from cell.report.report import report

            calibration = camera_calibration(request.settings)
            report(
                folder, request, ended.end, result, ended.remarks, ended.frames, ended.triangles, calibration,
                ended.stories,
            )  # fmt: skip
    except StorageError as e:
        return replace(result, unwritten=(*result.unwritten, e.what))
    return result


@dataclass(frozen=True, eq=False)
class _Ended:
    """A run that has ended: its result and the data for the report."""

    end: RunEnd
    result: FoldResult
    remarks: list[RunEvent]
    stories: tuple[FailureStory, ...]
    frames: list[TrueFrame]
    triangles: NDArray[np.int32] | None


def _listener(request: FoldRequest) -> AbstractContextManager[socket | None]:
    """Return the listener of the operator's page, or None. It is opened first, so that a port that is in use is
    noticed before the run begins."""
    if not request.page:
        return nullcontext()
    from cell.operator.local_server import open_listener

    return open_listener(request.page_port)


def _perform(
    request: FoldRequest,
    run: RunJournal,
    began: float,
    on_open: OnOpen | None,
    more_observers: Sequence[Observer],
    listener: socket | None,
    interrupted: Interrupted | None,
    interrupts: Interrupts,
) -> _Ended:
    keep_request(run.directory, request)
    if request.record:
        keep_run_inputs(run.directory, request, interrupted.context if interrupted else None)
    robot = load_robot(request.settings)
    recorder = _recorder(request, run)
    port_recorder = PortRecorder(run.directory if request.record else None)
    run_status = RunStatus(run.id, request.garment, request.seed, is_simulated(request.driver))
    commands = CommandQueue(run_status.note_command)
    supervision = _supervision(request, run, run_status, commands, listener)
    remarks = RunEvents()
    lines = ProgressLines(None if request.quiet else sys.stdout)
    notifier = Notifier(lines, run_status, request.quiet, request.terminal)
    calibration = camera_calibration(request.settings)
    stories = FailureStories(calibration)
    pictures = (QuestionFiles(run.directory, calibration), stories) if request.record else ()
    pictured = (supervision.live_view,) if supervision else ()
    # run_status comes before lines: an operator may answer as soon as the line with the question is shown
    observers: tuple[Observer, ...] = (
        RecorderObserver(recorder), remarks, *pictures, *pictured, run_status, lines, *more_observers,
    )  # fmt: skip

    truth_recorder = None
    try:
        with (
            report_compilation(lines.note),
            _opened(request, interrupted, lambda stop: PersonAttendant(commands, stop, notifier.ask)) as opened,
            ThreadPoolExecutor(1, "skill") as workers,
            interrupts.stop(opened.ports, asked=request.approve or not opened.ports.simulated),
            supervision.page(opened.ports.stop, say) if supervision else nullcontext(),
        ):
            ports = opened.ports
            executive_ports = (on_open(opened, commands) if on_open is not None else None) or ports
            if supervision:
                display = opened.simulated.display if opened.simulated else None
                executive_ports = supervision.live_view.between(executive_ports, display)
            if isinstance(ports.attendant, PersonAttendant):
                ports.attendant.clock, ports.attendant.stop = executive_ports.clock, executive_ports.stop
            recorded = port_recorder.between(executive_ports, commands)
            cell = assemble(
                request, robot, recorded.ports, recorder, recorded.commands, workers,
                notifier.note, notifier.computing,
            )  # fmt: skip
            cell = replace(cell, watched_stop=executive_ports.stop)
            truth_recorder = _truth_recorder(request, opened, recorder)
            attended = request.approve or not ports.simulated
            if attended and request.terminal and (in_foreground(sys.stdin) or not request.page):
                alone = not request.page
                TerminalOperator(commands, sys.stdin, sys.stderr, alone, run_status.allowed).start()
            checkpoint_writer = CheckpointWriter(
                run.directory, opened.simulated.checkpoint.save if opened.simulated else None
            )
            context, first = (interrupted.context, Event.REENTER) if interrupted else (RunContext(), Event.START)
            checkpoint_writer.keep(context)  # first: from here on, the run can be resumed if the process dies
            if interrupted:
                run.event(ports.clock.now(), State.IDLE.value, RESUMED_FROM, {"run": interrupted.run})
            runner = Runner(cell, EFFECTS, run, recorded.commands, observers, checkpoint_writer.keep)
            end = runner.run(context, first)
            port_recorder.end()
            if supervision:
                failure = end.context.failure if end.state is not State.FOLDED else None
                run_status.finish(end.state, failure, run.directory)
            score = _score(truth_recorder, end)
    finally:
        if truth_recorder:
            truth_recorder.close()
        summary, transcript_error = recorder.close(), port_recorder.close()
    errors = [f"recording: {error}" for error in summary.errors] + ([transcript_error] if transcript_error else [])
    live = {"live_dropped": summary.live_dropped, "live_errors": list(summary.live_errors)}
    recording = {"dropped": summary.dropped, "errors": errors, **live}
    result = fold_result(
        request, run.directory, began, end, score, interrupts.received, recording,
        interrupted.run if interrupted else None,
    )  # fmt: skip
    frames, triangles = (truth_recorder.key_frames, truth_recorder.triangles) if truth_recorder else ([], None)
    return _Ended(end, result, remarks.list, stories.stories, frames, triangles)


@contextmanager
def _opened(request: FoldRequest, interrupted: Interrupted | None, person: PersonAt) -> Iterator[OpenCell]:
    """Open the cell. The saved world of a resumed simulated run is restored before the stop can be triggered."""
    with opened_cell(request.driver, _simulated(request), request.seed, request.settings, person) as cell:
        if interrupted and interrupted.world is not None and cell.simulated is not None:
            cell.simulated.checkpoint.restore(interrupted.world)
        yield cell


def _supervision(
    request: FoldRequest, run: RunJournal, run_status: RunStatus, commands: CommandQueue, listener: socket | None
) -> Supervision | None:
    if listener is None:
        return None
    from cell.operator.console.live_view import LiveView
    from cell.operator.console.supervision import Supervision

    live_view = LiveView(camera_calibration(request.settings))
    return Supervision(request, run_status, live_view, commands, listener, run.directory / RECORDING)


def _recorder(request: FoldRequest, run: RunJournal) -> Recorder:
    if not request.record:
        return Recorder.silent()
    visual: RobotVisual | None
    try:
        visual = find_robot(request.settings.robot).visual()
    except StorageError:  # the converted meshes cannot be stored: the view shows no robot
        visual = None
    path, table = run.directory / RECORDING, request.settings.table
    recorder = Recorder.open(path, run.id, table, live=request.live, robot=visual)
    if recorder.live_url:
        say(f"live view: rerun --connect {recorder.live_url}")
    return recorder


def _simulated(request: FoldRequest) -> SimulationSettings:
    settings = request.settings
    return SimulationSettings(
        robot=settings.robot,
        garment=request.garment,
        surface=settings.surface,
        table=settings.drawn_table,
        camera=camera_mount(settings),
        pads=settings.gripper.pads,
        q_start=tuple(load_robot(settings).q_park.tolist()),
        realtime=request.realtime,
        world=request.world,
        as_built=settings.calibrated,
    )


def _truth_recorder(request: FoldRequest, cell: OpenCell, recorder: Recorder) -> Any:
    """Return the recorder and scorer of a simulated cell's true state, or None."""
    if not request.record_truth or cell.simulated is None:
        return None
    from cell.simulation.scoring.ground_truth_recorder import GroundTruthRecorder

    return GroundTruthRecorder(cell.simulated.truth, recorder, request)


def _score(truth_recorder: Any, end: RunEnd) -> dict[str, Any] | None:
    """Return the score, or None if the true state is not recorded or no longer available."""
    made = bool(end.context.steps) and len(end.context.done) == len(end.context.steps)
    try:
        return truth_recorder.score(made and end.state in JUDGED) if truth_recorder else None
    except CellError as e:
        say(f"not scored: {e.what}")
        return None
