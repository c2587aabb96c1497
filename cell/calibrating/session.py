"""Run one calibration, or other work at the cell that is no fold, from request to result: open the cell, perform,
make safe, close."""

from __future__ import annotations

import sys
import time
import traceback
from collections.abc import Callable, Mapping, Set
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Generic, TypeVar

import cv2
import numpy as np
from numpy.typing import NDArray

from foldcell.calibration.effects import Procedure
from foldcell.cell.calibrating.procedure_runner import STATE, ProcedureRunner
from foldcell.cell.config.cell_settings import CellSettings
from foldcell.cell.executive.effects.moving import hold_still, make_safe, prepare
from foldcell.cell.hardware.assembly import assemble
from foldcell.cell.hardware.driver import OpenCell, check_cell, opened_cell, simulation_settings
from foldcell.cell.hardware.driver_names import is_simulated
from foldcell.cell.hardware.robot_model import load_robot
from foldcell.cell.hardware.workcell import Workcell
from foldcell.cell.journal.journal import RunJournal
from foldcell.cell.operator.progress.compiling import report_compilation
from foldcell.cell.operator.terminal.attendant import PersonAttendant
from foldcell.cell.operator.terminal.keys import TerminalOperator, check_terminal
from foldcell.cell.runs.ownership import begun_run, owned_cell
from foldcell.cell.simulation import SimulationSettings, Truth
from foldcell.cell.states.commands import CommandQueue
from foldcell.cell.states.fold_request import FoldRequest
from foldcell.cell.states.run_context import RunContext
from foldcell.cell.states.transition_table import Event
from foldcell.cell.support.files.whole_file import write_whole
from foldcell.cell.support.json_values import write_json
from foldcell.cell.support.process.signals import BY_SIGNAL, Interrupts
from foldcell.cell.view.recorder import Recorder
from foldcell.robots.errors import (
    CellError,
    DriverError,
    Failure,
    FailureKind,
    RecordError,
    StorageError,
)
from foldcell.robots.ports import Stop
from foldcell.skills.vocabulary import Outcome

T = TypeVar("T")
Script = Callable[[OpenCell], None]


@dataclass(frozen=True)
class CalibrationRequest:
    """Request for one calibration. name: name of its run. say: shows a progress line."""

    name: str
    seed: int
    driver: str
    settings: CellSettings
    logs: Path
    realtime: bool
    say: Callable[[str], None]


@dataclass(frozen=True, eq=False)
class CalibrationEnd(Generic[T]):
    """Result of a calibration. truth: ground truth of a simulated cell, for the record only."""

    run_id: str
    run_dir: Path
    value: T | None
    failure: Failure | None
    safe: bool
    simulated: bool
    truth: Truth | None
    signal: int | None
    robot_time_s: float
    wall_time_s: float

    @property
    def result(self) -> str:
        if self.value is not None:
            return "done" if self.safe else "fault"
        crashed = self.failure is not None and self.failure.kind is FailureKind.SKILL_CRASHED
        return "not_done" if self.safe and not crashed else "fault"

    @property
    def exit_code(self) -> int:
        if self.signal is not None:
            return BY_SIGNAL + self.signal
        return {"done": 0, "not_done": 2, "fault": 3}[self.result]

    def as_json(self) -> dict[str, Any]:
        f = self.failure
        return {
            "result": self.result,
            "failure": None if f is None else {"kind": f.kind.value, "what": f.what, "hint": f.hint},
            "simulated": self.simulated,
            "robot_time_s": self.robot_time_s,
            "wall_time_s": self.wall_time_s,
            "run_dir": str(self.run_dir),
        }


@dataclass(frozen=True, eq=False)
class Session:
    """The open cell of a request. run: its journal. ended: whether a signal asks for the end."""

    request: CalibrationRequest
    run: RunJournal
    cell: Workcell
    opened: OpenCell
    ended: Callable[[], bool]

    def say(self, text: str) -> None:
        self.request.say(f"{self.cell.ports.clock.now():8.1f} s  {text}")


class CalibrationPrompts:
    """Asks the operator for help during a calibration. The latest request stays open until `ask(None)` withdraws
    it. say: shows a line to the operator."""

    def __init__(self, say: Callable[[str], None]) -> None:
        self._say = say
        self._wanted: str | None = None

    def ask(self, what: str | None) -> None:
        """Ask the operator for something that the robot cannot do itself. None withdraws the request."""
        self._wanted = what
        if what is not None:
            self._say(f"{'':12}{what}, then approve (a, Enter)")

    def may(self) -> Set[Event]:
        """Return the commands allowed now. A calibration cannot be paused and has nothing to skip."""
        return {Event.ABORT} if self._wanted is None else {Event.ABORT, Event.APPROVE}


def calibrate(
    request: CalibrationRequest,
    procedure: Callable[[Workcell], Procedure[T]],
    figures: Callable[[T, Truth | None], Mapping[str, Any]],
    script: Script | None = None,
) -> CalibrationEnd[T]:
    """Run one calibration procedure on the cell of the request.

    procedure: makes the procedure for the assembled cell. The rest is as in `perform_session`.
    """

    def work(session: Session) -> tuple[Outcome[T], bool]:
        if script is not None:
            script(session.opened)
        return _perform(session, procedure)

    return perform_session(request, work, figures)


def perform_session(
    request: CalibrationRequest,
    work: Callable[[Session], tuple[Outcome[T], bool]],
    figures: Callable[[T, Truth | None], Mapping[str, Any]],
) -> CalibrationEnd[T]:
    """Open the cell of the request and do the work, with its own run in the journal.

    work: returns its outcome, and whether it left the cell safe. figures(value, truth): returns the figures of the
    result that are stored with the run.

    Raises ConfigurationError and StorageError before anything moves. Later, if a record cannot be written, holds
    the arms and raises RecordError.
    """
    began = time.monotonic()
    check_cell(request.driver, _simulated(request))
    if not is_simulated(request.driver):  # an operator has to confirm that the board is in place
        check_terminal(sys.stdin)
    with (
        owned_cell(request.logs) as (interrupts, journal),
        begun_run(journal, request.name, request.seed, request.driver, request.settings) as run,
    ):
        write_whole(run.directory / "cell.yaml", request.settings.as_yaml())
        end = _with_cell(request, run, work, began, interrupts)
        report = end.as_json() | (dict(figures(end.value, end.truth)) if end.value is not None else {})
        run.end(end.result, report)
        write_json(run.directory / "result.json", report)
    return end


def _with_cell(
    request: CalibrationRequest,
    run: RunJournal,
    work: Callable[[Session], tuple[Outcome[T], bool]],
    began: float,
    interrupts: Interrupts,
) -> CalibrationEnd[T]:
    robot, commands, prompts = load_robot(request.settings), CommandQueue(), CalibrationPrompts(request.say)

    def attendant(stop: Stop) -> PersonAttendant:
        return PersonAttendant(commands, stop, prompts.ask)

    with (
        report_compilation(lambda text: request.say(f"{'':12}{text}")),
        opened_cell(request.driver, _simulated(request), request.seed, request.settings, attendant) as opened,
        ThreadPoolExecutor(1, "skill") as workers,
        interrupts.stop(opened.ports, asked=not opened.ports.simulated),
    ):
        ports = opened.ports
        fold_request = FoldRequest("auto", request.seed, request.driver, request.settings, request.logs)
        cell = assemble(fold_request, robot, ports, Recorder.silent(), commands, workers, _ignore, _ignore)
        if not ports.simulated and sys.stdin is not None:
            TerminalOperator(commands, sys.stdin, sys.stderr, may=prompts.may).start()
        session = Session(request, run, cell, opened, lambda: bool(interrupts.received))
        try:
            outcome, safe = work(session)
        except StorageError as e:
            hold_still(cell, RunContext())
            hint = f"the arms are held where they are: remove by hand what they hold. {e.hint}"
            raise RecordError(e.what, hint) from e
        return CalibrationEnd(
            run_id=run.id,
            run_dir=run.directory,
            value=outcome.value,
            failure=outcome.failure,
            safe=safe,
            simulated=ports.simulated,
            truth=opened.simulated.truth.now() if opened.simulated else None,
            signal=interrupts.received[0] if interrupts.received else None,
            robot_time_s=round(ports.clock.now(), 3),
            wall_time_s=round(time.monotonic() - began, 3),
        )


def _ignore(*_: Any) -> None: ...


def _perform(session: Session, procedure: Callable[[Workcell], Procedure[T]]) -> tuple[Outcome[T], bool]:
    """Prepare the cell, run the procedure and make the cell safe. Returns the procedure's outcome, and whether the
    cell is safe."""
    run, cell = session.run, session.cell

    def say(t: float, text: str) -> None:
        session.request.say(f"{t:8.1f} s  {text}")

    performer = ProcedureRunner(cell, run, say, lambda name, picture: _keep(run.directory, name, picture))
    say(cell.ports.clock.now(), "preparing")
    outcome = _catch(lambda: _prepare(cell, run) or performer.run(procedure(cell)))
    if outcome.failure:
        say(cell.ports.clock.now(), str(outcome.failure))
        f = outcome.failure
        run.event(cell.ports.clock.now(), STATE, f.kind.value, {"what": f.what, "hint": f.hint, **f.values})
    say(cell.ports.clock.now(), "making safe")
    return outcome, _make_safe(cell, run, performer)


def _catch(work: Callable[[], Outcome[T]]) -> Outcome[T]:
    """Run `work`. Every exception except StorageError becomes a failure, so that the cell can then be made
    safe."""
    try:
        return work()
    except StorageError:
        raise
    except DriverError as e:
        return Outcome(failure=e.failure())
    except Exception as e:
        hint = e.hint if isinstance(e, CellError) else "this is a bug: keep the run folder and report it"
        values = {"traceback": traceback.format_exc()}
        return Outcome(failure=Failure(FailureKind.SKILL_CRASHED, f"{type(e).__name__}: {e}", hint, values))


def _prepare(cell: Workcell, run: RunJournal) -> Outcome[Any] | None:
    """Prepare the cell. Returns None if the cell is ready, otherwise the failure as an outcome."""
    clock = cell.ports.clock
    intent = run.intent(clock.now(), "preparing", "prepare")
    result = prepare(cell, RunContext())
    run.result(intent, clock.now(), {"event": result.event.value})
    return Outcome(failure=result.context.failure) if result.context.failure else None


def _make_safe(cell: Workcell, run: RunJournal, performer: ProcedureRunner) -> bool:
    """Remove the board and park the arms. If the stop is triggered, only hold the arms. Returns whether the cell
    is safe."""
    clock = cell.ports.clock
    intent = run.intent(clock.now(), "making_safe", "make_safe")
    if cell.ports.stop.state().stopped:
        hold_still(cell, RunContext())
        run.result(intent, clock.now(), {"event": "held"})
        return True
    failure: Failure | None
    try:
        if performer.holds_board:
            performer.take_board()
        failure = make_safe(cell, RunContext()).context.failure
    except DriverError as e:
        failure = e.failure()
    run.result(intent, clock.now(), {"event": "failed", "what": str(failure)} if failure else {"event": "done"})
    return failure is None or failure.kind is FailureKind.STOPPED


def _keep(folder: Path, name: str, picture: NDArray[np.uint8]) -> None:
    """Save a picture (h, w, 3) RGB in the run folder."""
    if not cv2.imwrite(str(folder / f"{name}.png"), picture[..., ::-1]):
        raise StorageError(
            f"cannot write {folder / name}.png", "free disk space, or choose another folder with --logs"
        )


def _simulated(request: CalibrationRequest) -> SimulationSettings:
    return simulation_settings(request.settings, request.realtime, as_built=True)
