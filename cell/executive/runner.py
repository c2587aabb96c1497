"""Performs the effect of each state and feeds its event back to the state machine.

One loop in one thread: the machine names the effect, the runner writes its intent to the journal, performs it
(cell/executive/effects), writes its result to the journal, and passes its event to the machine. Observers (the
Rerun view, the progress lines) are notified of each step and cannot affect it.
"""

from __future__ import annotations

import traceback
from collections.abc import Callable, Mapping
from dataclasses import replace

from foldcell.cell.control.checks import stopped
from foldcell.cell.executive.machine import Executive
from foldcell.cell.hardware.workcell import Workcell
from foldcell.cell.journal.journal import RunJournal
from foldcell.cell.states.commands import ABORTED, ANSWERS, CommandQueue
from foldcell.cell.states.observers import FAILING, Observer, Step
from foldcell.cell.states.run_context import Result, RunContext, RunEnd
from foldcell.cell.states.transition_table import TERMINAL, Effect, Event, State
from foldcell.robots.errors import CellError, DriverError, Failure, FailureKind, InternalError, StorageError

EffectFunction = Callable[[Workcell, RunContext], Result]

_QUIET = frozenset({Effect.NOTHING, Effect.WAIT, Effect.CHOOSE_RECOVERY, Effect.NEXT_STEP})
"""Effects that only decide or wait. The journal gets no intent and no result for them."""

_FAILING = FAILING | {Event.GIVE_UP}
"""After one of these events, the context holds the failure that caused the event. After any other event, the
failure in the context is an earlier one, from which the run has already recovered."""

_QUESTIONS = frozenset({Effect.ASK_APPROVAL, Effect.ASK_OPERATOR})
"""Effects that ask the operator. Earlier answers are dropped before the question: a key that was pressed twice
must not approve the next fold."""


class Runner:
    """One run of the state machine over the effects of a cell.

    keep: writes the checkpoint of the context after each effect, so that an interrupted run can be resumed. A run
    that ends as folded gets no checkpoint after its last effect. If the program dies before that end is in the
    journal, `resume` therefore inspects the last fold again.
    """

    def __init__(
        self,
        workcell: Workcell,
        effects: Mapping[Effect, EffectFunction],
        journal: RunJournal,
        commands: CommandQueue,
        observers: tuple[Observer, ...] = (),
        keep: Callable[[RunContext], None] = lambda context: None,
    ) -> None:
        self._cell = replace(workcell, note=self._note)
        self._effects = effects
        self._journal = journal
        self._commands = commands
        self._observers = observers
        self._keep = keep
        self._machine = Executive()
        self._state = State.IDLE
        self._context = RunContext()
        self._times: dict[str, float] = {}
        self._noted: tuple[tuple[float, str], ...] = ()

    def run(self, context: RunContext | None = None, first: Event = Event.START) -> RunEnd:
        """Run from the event `first` to a terminal state. Failures are part of the returned value."""
        clock = self._cell.ports.clock
        started = clock.now()
        self._context, self._times = context or RunContext(), {}
        try:
            state = self._walk(first)
        except StorageError as error:
            state = self._unrecorded(error)
        return RunEnd(state, self._context, started, clock.now(), self._times)

    def _walk(self, event: Event) -> State:
        """Follow the table to a terminal state. Raises StorageError if journal or checkpoint cannot be written."""
        clock = self._cell.ports.clock
        while True:
            step = self._advance(event)
            entered = clock.now()
            self._note_entry(entered, step)
            result = self._perform(step, self._context)
            if step.target in TERMINAL:
                return step.target
            self._context, event = result.context, result.event
            self._times[step.target.value] = self._times.get(step.target.value, 0.0) + clock.now() - entered
            ended = clock.now()  # read once: the number of clock readings must not depend on the observers
            for o in self._observers:
                o.performed(ended, step, result)

    def _advance(self, event: Event) -> Step:
        """Give an event to the machine. An event without a row in the present state is a bug and becomes a
        crash."""
        try:
            return self._machine.handle(event)
        except InternalError as bug:
            if Event.CRASH not in self._machine.allowed():
                raise
            self._context = self._context.with_failure(_crash(bug))
            return self._machine.handle(Event.CRASH)

    def _unrecorded(self, error: StorageError) -> State:
        """End the run with the arms held, because the executive does nothing that the journal cannot record."""
        now, source = self._cell.ports.clock.now(), self._machine.state
        hint = f"the arms are held where they are: free the garment from the hands. {error.hint}"
        failure = Failure(FailureKind.UNRECORDED, error.what, hint)
        self._context = self._context.with_failure(failure)
        if not self._machine.ended:
            self._machine.handle(Event.UNRECORDED)
        step = Step(source, Event.UNRECORDED, State.FAULT, Effect.HOLD)
        for o in self._observers:
            o.performed(now, replace(step, target=source), Result(Event.UNRECORDED, self._context))
            o.entered(now, step)
        try:
            self._effects[Effect.HOLD](self._cell, self._context)
        except Exception as e:  # the journal cannot record it, and nothing else can hold the arms
            failure = replace(failure, hint=f"{hint}. Holding them failed ({e}): press the emergency stop")
            self._context = replace(self._context, failure=failure)
        return State.FAULT

    def _note(self, name: str, values: Mapping[str, float]) -> None:
        """Record an event that happens during an effect."""
        now = self._cell.ports.clock.now()
        self._journal.event(now, self._state.value, name, values)
        self._noted = (*self._noted, (now, name))

    def _note_entry(self, t: float, step: Step) -> None:
        self._state = step.target
        if step.effect in _QUESTIONS:
            self._commands.drop(ANSWERS)
        self._journal.event(t, step.target.value, step.event.value, {"from": step.source.value})
        for o in self._observers:
            o.entered(t, step)

    def _perform(self, step: Step, context: RunContext) -> Result:
        """Perform the effect, with its intent and result in the journal. An exception becomes an event."""
        interruption = self._interruption(step)
        if interruption is Event.ABORT and step.effect is Effect.LAY_BACK:  # the cloth is laid down before the end
            self._commands.drop({Event.ABORT})
            context, interruption = self._with_cause(interruption, context), None
        if interruption:
            return Result(interruption, self._with_cause(interruption, context), {"interrupted": True})
        clock, self._noted = self._cell.ports.clock, ()
        payload = {"step": context.fold.index, "attempt": len(context.fold.adjustments)}
        intent = None
        if step.effect not in _QUIET:
            intent = self._journal.intent(clock.now(), step.target.value, step.effect.value, payload)
        try:
            result = self._effects[step.effect](self._cell, context)
        except DriverError as e:
            # the driver may notice a stop before the executive does; report it like any other stop
            stop = stopped(self._cell.ports) if e.kind is FailureKind.STOPPED else None
            result = Result(Event.FAILED, context.with_failure(stop or e.failure()))
        except Exception as e:  # a bug or a broken file
            result = Result(Event.CRASH, context.with_failure(_crash(e)))
        result = replace(self._divert(step, result), within=self._noted)
        if result.event is not Event.ALL_FOLDED and step.target is not State.FOLDED:
            # write it before the result, so that the checkpoint is never older than the journal
            result = self._write_checkpoint(step, result)
        if intent is not None:
            record = {"event": result.event.value, **result.record}
            if result.event in _FAILING and result.context.failure:
                f = result.context.failure
                record |= {"kind": f.kind.value, "what": f.what, "hint": f.hint, "values": dict(f.values)}
            self._journal.result(intent, clock.now(), record)
        return result

    def _write_checkpoint(self, step: Step, result: Result) -> Result:
        """Write the checkpoint. Raises StorageError, which ends the run in the same way as a lost journal. If the
        process of the simulated cell has ended, the effect counts as failed: the robot does not respond. An effect
        that has already failed keeps its own failure, which is the cause."""
        try:
            self._keep(result.context)
        except StorageError:
            raise
        except DriverError as e:
            if step.target not in TERMINAL and result.event not in _FAILING:
                return replace(result, event=Event.FAILED, context=result.context.with_failure(e.failure()))
        except Exception as e:
            hint = "this is a bug: keep the run folder and report it"
            raise StorageError(f"the checkpoint cannot be written: {type(e).__name__}: {e}", hint) from e
        return result

    def _divert(self, step: Step, result: Result) -> Result:
        """Return the result with another event if a stop or an abort caused the failure: STOP, or ABORT if the
        present state has a row for ABORT."""
        if result.event is not Event.FAILED or result.context.failure is None:
            return result
        kind = result.context.failure.kind
        if kind is FailureKind.STOPPED:
            return replace(result, event=Event.STOP)
        if kind is FailureKind.ABORTED and Event.ABORT in self._machine.allowed():
            return replace(result, event=Event.ABORT)
        return result

    def _interruption(self, step: Step) -> Event | None:
        """Return the stop, pause or abort that is pending before this effect begins, or None."""
        if step.target in TERMINAL:
            return None
        if self._cell.ports.stop.state().stopped:
            return Event.STOP
        if step.effect in {Effect.ASK_APPROVAL, Effect.ASK_OPERATOR, Effect.WAIT}:
            return None  # these effects take the commands themselves
        return self._commands.take(frozenset({Event.PAUSE, Event.ABORT}) & set(self._machine.allowed()))

    def _with_cause(self, event: Event, context: RunContext) -> RunContext:
        """Return the context with the abort or stop as its failure. It replaces an earlier failure, from which the
        run has already recovered."""
        if event is Event.ABORT:
            return context.with_failure(ABORTED)
        stop = stopped(self._cell.ports)
        return context.with_failure(stop) if stop else context


def _crash(error: Exception) -> Failure:
    """Return the exception that is being handled as a failure, with its traceback."""
    hint = error.hint if isinstance(error, CellError) else "this is a bug: keep the run folder and report it"
    what = f"{type(error).__name__}: {error}"
    return Failure(FailureKind.SKILL_CRASHED, what, hint, {"traceback": traceback.format_exc()})
