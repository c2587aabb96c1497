"""The observers and recorders of one run: its record, recording, transcript, stories, progress lines and page."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager, nullcontext
from dataclasses import replace
from socket import socket
from typing import TYPE_CHECKING

from foldcell.cell.hardware.camera import camera_calibration
from foldcell.cell.hardware.driver import OpenCell
from foldcell.cell.hardware.driver_names import is_simulated
from foldcell.cell.journal.frame_store import FRAMES, FrameStore
from foldcell.cell.journal.journal import RunJournal
from foldcell.cell.operator.console.run_status import RunStatus
from foldcell.cell.operator.judging import ask_judgement
from foldcell.cell.operator.progress.lines import Notifier, ProgressLines, say
from foldcell.cell.operator.terminal.keys import TerminalOperator, in_foreground
from foldcell.cell.record.judgement import Judgement
from foldcell.cell.record.run_record import RecordingLosses
from foldcell.cell.record.run_record_builder import RunRecordBuilder
from foldcell.cell.record.words import garment_name
from foldcell.cell.report.camera_pictures.question_picture import QuestionFiles
from foldcell.cell.report.failure_stories import FailureStories
from foldcell.cell.states.commands import CommandQueue
from foldcell.cell.states.fold_request import FoldRequest
from foldcell.cell.states.observers import Observer
from foldcell.cell.states.run_context import RunEnd
from foldcell.cell.states.transition_table import State
from foldcell.cell.transcript.port_recorder import PortRecorder
from foldcell.cell.view.recorder import Recorder
from foldcell.robots.errors import CellError, StorageError
from foldcell.robots.ports import Ports, Stop
from foldcell.robots.registry import find_robot
from foldcell.robots.robot import RobotVisual
from foldcell.skills.scoring.verdict import Score
from foldcell.skills.vocabulary import CameraCalibration

if TYPE_CHECKING:
    from foldcell.cell.operator.console.live_view import LiveView
    from foldcell.cell.simulation.scoring.ground_truth_recorder import GroundTruthRecorder

RECORDING = "run.rrd"
JUDGED = (State.FOLDED, State.NOT_FOLDED)
"""Ends of a run after which the scorer waits for the ideal fold, if all folds were made."""


def page_listener(request: FoldRequest) -> AbstractContextManager[socket | None]:
    """Return the listener of the operator's page, or None. It is opened before the run begins, so that a port in
    use is noticed early."""
    if not request.page:
        return nullcontext()
    from foldcell.cell.operator.local_server import open_listener

    return open_listener(request.page_port)


class RunObservers:
    """All observers and recorders of one run. None of them changes a decision.

    began: time.monotonic() at the request [s]; resumed_from: the run that is resumed, else None; listener: of the
    operator's page; more: other observers.
    """

    def __init__(
        self,
        request: FoldRequest,
        run: RunJournal,
        began: float,
        resumed_from: str | None,
        listener: socket | None,
        more: Sequence[Observer],
    ) -> None:
        self._request, self._run = request, run
        simulated, calibration = is_simulated(request.driver), camera_calibration(request.settings)
        self.recorder = _recorder(request, run)
        self.frames = FrameStore(run.directory / FRAMES)
        self._port_recorder = PortRecorder(run.directory if request.record else None, self.frames)
        self.record = RunRecordBuilder(request, simulated, run.directory, began, resumed_from)
        self._run_status = RunStatus(self.record)
        self.commands = CommandQueue(self._run_status.note_command)
        self._listener, self._live_view = listener, _live_view(calibration) if listener else None
        self.lines = ProgressLines(None if request.quiet else sys.stdout)
        self.notifier = Notifier(self.lines, self._run_status, request.quiet, request.terminal)
        self.stories = FailureStories(calibration)
        self.truth: GroundTruthRecorder | None = None
        pictures = (QuestionFiles(run.directory, calibration), self.stories) if request.record else ()
        pictured = (self._live_view,) if self._live_view else ()
        # run_status comes before lines: an operator may answer as soon as the line with the question is shown
        self.all: tuple[Observer, ...] = (
            self.recorder, self.record, *pictures, *pictured, self._run_status, self.lines,
            *more,
        )  # fmt: skip

    @contextmanager
    def page(self, stop: Stop) -> Iterator[None]:
        """Serve the operator's page for the duration of the context, if it was requested."""
        if self._live_view is None or self._listener is None:
            yield
            return
        from foldcell.cell.operator.console.server import operators_page
        from foldcell.cell.operator.console.viewer_routes import recorded_view

        viewer = recorded_view(self._run.directory / RECORDING) if self._request.record else None
        with operators_page(
            self._run_status,
            self._live_view,
            self.commands,
            stop,
            viewer,
            self._listener,
            self._request.page_origin,
        ) as address:
            say(f"operator's page: {address}")
            yield

    def pictured(self, ports: Ports, opened: OpenCell) -> Ports:
        """Return ports that do the same as `ports`, and also give the operator's page its pictures."""
        if self._live_view is None:
            return ports
        display = opened.simulated.display if opened.simulated else None
        return self._live_view.between(ports, display)

    def recorded(self, ports: Ports) -> tuple[Ports, CommandQueue]:
        """Return ports and commands whose answers are written to the transcript."""
        return self._port_recorder.between(ports, self.commands)

    def watch_truth(self, opened: OpenCell) -> None:
        """Record the true state of a simulated cell from now on, for the score, the recording and the film."""
        if self._request.record_truth and opened.simulated is not None:
            from foldcell.cell.simulation.scoring.ground_truth_recorder import GroundTruthRecorder

            self.truth = GroundTruthRecorder(opened.simulated.truth, self.recorder, self._request)

    def listen_to_terminal(self, attended: bool) -> None:
        """Take commands from the terminal, if a person attends the run there."""
        if attended and self._typed():
            may = self._run_status.allowed
            TerminalOperator(self.commands, sys.stdin, sys.stderr, not self._request.page, may).start()

    def _typed(self) -> bool:
        """Whether lines typed at the terminal are read."""
        request = self._request
        return request.terminal and (in_foreground(sys.stdin) or not request.page)

    def judgement(self, ended: Callable[[], bool]) -> Judgement | None:
        """Ask the person whether the garment is folded well. See `ask_judgement`."""
        source, page = sys.stdin if self._typed() else None, self._run_status if self._live_view else None
        return ask_judgement(garment_name(self._request.garment), source, page, ended)

    def run_ended(self, end: RunEnd) -> None:
        """End the transcript, and show the end on the operator's page."""
        self._port_recorder.end()
        if self._live_view:
            self._run_status.finish(self.record.record(end))

    def score(self, end: RunEnd) -> Score | None:
        """Return the score. None if the true state is not recorded or no longer available."""
        made = bool(end.context.steps) and len(end.context.done) == len(end.context.steps)
        try:
            return self.truth.score(made and end.state in JUDGED) if self.truth else None
        except CellError as e:
            say(f"not scored: {e.what}")
            return None

    def close(self) -> RecordingLosses:
        """Close recording and transcript. Returns messages about lost data."""
        if self.truth:
            self.truth.close()
        lost, transcript_error = self.recorder.close(), self._port_recorder.close()
        errors = (*(f"recording: {error}" for error in lost.errors), *filter(None, [transcript_error]))
        return replace(lost, errors=errors)


def _live_view(calibration: CameraCalibration) -> LiveView:
    from foldcell.cell.operator.console.live_view import LiveView

    return LiveView(calibration)


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
