"""Performs what a state asks for and turns its outcome into the next event.

One loop, one thread: the machine says which effect is due; the journal takes the intent; the effect is
performed (cell/executive/effects); the journal takes the result; the machine takes the event. Observers (the
Rerun view, the progress lines) are told of each step and cannot hinder it.
"""

from __future__ import annotations

import traceback
from collections.abc import Callable, Mapping
from dataclasses import replace

from cell.control.checks import stopped
from cell.executive.machine import Executive
from cell.hardware.workcell import Workcell
from cell.recording.journal import RunJournal
from cell.states.commands import ABORTED, ANSWERS, CommandQueue
from cell.states.observers import FAILING, Observer, Step
from cell.states.run_context import Result, RunContext
from cell.states.run_end import RunEnd
from cell.states.transition_table import TERMINAL, Effect, Event, State
from robots.errors import CellError, DriverError, Failure, FailureKind, InternalError, StorageError

__all__ = ["EffectFunction", "Runner"]

EffectFunction = Callable[[Workcell, RunContext], Result]

_QUIET = frozenset({Effect.NOTHING, Effect.WAIT, Effect.CHOOSE_RECOVERY, Effect.NEXT_STEP})
"""Effects that touch neither the cell nor the clock: an event in the journal is enough."""

_FAILING = FAILING | {Event.GIVE_UP}
"""Events of which the failure at hand is the reason. With others it is one that was met, and mended, before."""

_QUESTIONS = frozenset({Effect.ASK_APPROVAL, Effect.ASK_OPERATOR})
"""Only what is said after they were shown answers them: a key pressed twice does not approve the next fold."""


class Runner:
    """One run of the machine over the effects of a cell.

    keep: puts down what is believed after each effect, so that an interrupted run can be gone on with. What was
    folded to its end is not: its last fold is judged again, should the journal not know of the end.
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
        """From START, or whatever event comes first, to a declared end. Returns however it ended."""
        clock = self._cell.ports.clock
        started = clock.now()
        self._context, self._times = context or RunContext(), {}
        try:
            state = self._walk(first)
        except StorageError as error:
            state = self._unrecorded(error)
        return RunEnd(state, self._context, started, clock.now(), self._times)

    def _walk(self, event: Event) -> State:
        """Through the table to its end. Raises StorageError when the journal takes no more lines."""
        clock = self._cell.ports.clock
        while True:
            step = self._moved(event)
            entered = clock.now()
            self._note_entry(entered, step)
            if step.target in TERMINAL:
                self._perform(step, self._context)
                return step.target
            result = self._perform(step, self._context)
            self._context, event = result.context, result.event
            self._times[step.target.value] = self._times.get(step.target.value, 0.0) + clock.now() - entered
            ended = clock.now()  # once, however many look on: what is asked of the cell does not depend on them
            for o in self._observers:
                o.performed(ended, step, result)

    def _moved(self, event: Event) -> Step:
        """The machine one event on. One that the state does not know is a bug of the effect, and ends as one."""
        try:
            return self._machine.handle(event)
        except InternalError as bug:
            if Event.CRASH not in self._machine.allowed():
                raise
            self._context = self._context.with_failure(_crash(bug))
            return self._machine.handle(Event.CRASH)

    def _unrecorded(self, error: StorageError) -> State:
        """What the journal cannot tell of is not done: the arms are held where they are, and that is the end."""
        now, source = self._cell.ports.clock.now(), self._machine.state
        hint = f"the arms are held where they are: free by hand what the hands hold. {error.hint}"
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
        except Exception as e:  # there is no journal to tell, and no other way to hold them
            told = replace(failure, hint=f"{hint}. Holding them failed ({e}): press the emergency stop")
            self._context = replace(self._context, failure=told)
        return State.FAULT

    def _note(self, name: str, values: Mapping[str, float]) -> None:
        """Something that happened within an effect."""
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
        """The effect with its intent and result in the journal; whatever it raises becomes an event."""
        pending = self._interruption(step)
        if pending:
            return Result(pending, self._with_cause(pending, context), {"interrupted": True})
        clock, self._noted = self._cell.ports.clock, ()
        payload = {"step": context.fold.index, "attempt": len(context.fold.adjustments)}
        intent = None
        if step.effect not in _QUIET:
            intent = self._journal.intent(clock.now(), step.target.value, step.effect.value, payload)
        try:
            result = self._effects[step.effect](self._cell, context)
        except DriverError as e:
            # a stop between two looks at it is met by the driver first: it is told of as any other
            halted = stopped(self._cell.ports) if e.kind is FailureKind.STOPPED else None
            result = Result(Event.FAILED, context.with_failure(halted or e.failure()))
        except Exception as e:  # a bug or a broken file: the machine must know, the journal must keep it
            result = Result(Event.CRASH, context.with_failure(_crash(e)))
        result = replace(self._divert(step, result), within=self._noted)
        if result.event is not Event.ALL_FOLDED and step.target is not State.FOLDED:
            self._put_down(result.context)  # before the result: what is believed is never older than the journal
        if intent is not None:
            record = {"event": result.event.value, **result.record}
            if result.event in _FAILING and result.context.failure:
                f = result.context.failure
                record |= {"kind": f.kind.value, "what": f.what, "hint": f.hint, "values": dict(f.values)}
            self._journal.result(intent, clock.now(), record)
        return result

    def _put_down(self, context: RunContext) -> None:
        try:
            self._keep(context)
        except StorageError:
            raise
        except DriverError as e:  # a simulated cell that is gone cannot be kept
            raise StorageError(f"what is believed cannot be kept: {e.what}", e.hint) from e
        except Exception as e:  # what cannot be gone on with is as bad as what cannot be told
            bug = "this is a bug: keep the run folder and report it"
            raise StorageError(f"what is believed cannot be kept: {type(e).__name__}: {e}", bug) from e

    def _divert(self, step: Step, result: Result) -> Result:
        """A failure that is a stop or an abort leaves by its own row; an end has nowhere left to go."""
        if result.event is not Event.FAILED or result.context.failure is None:
            return result
        kind = result.context.failure.kind
        if kind is FailureKind.STOPPED:
            return replace(result, event=Event.STOP)
        if kind is FailureKind.ABORTED and Event.ABORT in self._machine.allowed():
            return replace(result, event=Event.ABORT)
        return result

    def _interruption(self, step: Step) -> Event | None:
        """What an operator or the stop circuit wants before this effect begins."""
        if step.target in TERMINAL:
            return None
        if self._cell.ports.stop.state().stopped:
            return Event.STOP
        if step.effect in {Effect.ASK_APPROVAL, Effect.ASK_OPERATOR, Effect.WAIT}:
            return None  # these take their commands themselves
        return self._commands.take(frozenset({Event.PAUSE, Event.ABORT}) & set(self._machine.allowed()))

    def _with_cause(self, event: Event, context: RunContext) -> RunContext:
        """What ends a run is the failure that it tells of, not one that was met and mended before."""
        if event is Event.ABORT:
            return context.with_failure(ABORTED)
        halted = stopped(self._cell.ports)
        return context.with_failure(halted) if halted else context


def _crash(error: Exception) -> Failure:
    """Of the exception that is being handled."""
    hint = error.hint if isinstance(error, CellError) else "this is a bug: keep the run folder and report it"
    what = f"{type(error).__name__}: {error}"
    return Failure(FailureKind.SKILL_CRASHED, what, hint, {"traceback": traceback.format_exc()})
