"""Does to a run what its script says, when it says so, and remembers what came of it.

A director stands beside the machine as any observer does, and on the clock that the executive sleeps by. It holds
nothing that the executive could not meet on its own: commands go into the one queue, a stop into the stop circuit,
faults into the simulated world. While the cell does not sleep by this clock (an attendant lays the garment), what
is due has to wait until it does, or enters its next state.
"""

from __future__ import annotations

import threading
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from cell.campaigns.hil.clock import ScheduledClock
from cell.campaigns.hil.script import Action, Script
from cell.hardware.driver import OpenCell
from cell.simulation import Fault
from cell.states.commands import CommandQueue, QueuedCommand
from cell.states.observers import FAILING, Step
from cell.states.run_context import Result
from cell.states.transition_table import TERMINAL, Event, State
from robots.errors import FailureKind, InternalError
from robots.ports import Array, Ports

__all__ = ["Director", "Seen"]

HUNG = "the script's time is over"
GIVE_UP, HALT = Action.model_validate({"say": Event.ABORT.value}), Action.model_validate({"stop": HUNG})
"""What is done to a run that does not come to its end, and to one that does not heed that."""
GRACE_S = 60.0
"""Of cell time between the two [s]."""
HUNG_FACTOR = 3.0
"""A cell whose clock stands still is stopped after so many times that on the wall."""
AT_REST = 0.02
"""Arms this near to the rest pose are parked [rad]."""
OPEN = 0.01
"""Pads this far apart hold nothing [m]."""


@dataclass(frozen=True)
class Seen:
    """What came of a run beside its result.

    states: in the order in which they were entered; failures: likewise. parked: arms at rest and hands open at
    the end. missed: actions that were never due, faults that never happened and commands that nobody took.
    overdue: it was told to end for its length. trouble: what kept the script from being carried out.
    """

    states: tuple[State, ...]
    failures: tuple[FailureKind, ...]
    parked: bool
    missed: tuple[Action, ...]
    overdue: bool = False
    trouble: tuple[str, ...] = ()


class Director:
    """One script, for one run: `begin` before the first effect, then an observer of the runner."""

    def __init__(self, script: Script, rest: Array, tell: Callable[[str], None]) -> None:
        """rest: (14,) the arms' rest pose [rad]. tell: says a line to the person at the cell."""
        self._waiting = list(script.do)
        self._due: list[tuple[float, Action]] = []
        self._faults: list[tuple[Fault, Action]] = []
        self._rest, self._tell = rest, tell
        self._cell: OpenCell | None = None
        self._commands = CommandQueue()
        self._began = 0.0
        self._states: list[State] = []
        self._failures: list[FailureKind] = []
        self._parked = False
        self._said: list[tuple[QueuedCommand, Action]] = []
        self._late: list[Action] = []
        self._missed: tuple[Action, ...] = script.do
        self._limit = script.limit_s
        self._overdue = False
        self._trouble: list[str] = []
        self._guard: threading.Timer | None = None

    def begin(self, cell: OpenCell, commands: CommandQueue) -> Ports:
        """The ports as the executive gets them: the same, with a clock on whose way the script is carried out."""
        ports = cell.ports
        self._cell, self._commands, self._began = cell, commands, ports.clock.now()
        self._schedule(lambda action: action.when.time_s)
        self._due += [(self._began + self._limit, GIVE_UP), (self._began + self._limit + GRACE_S, HALT)]
        self._guard = threading.Timer(HUNG_FACTOR * (self._limit + GRACE_S), ports.stop.trigger, [HUNG])
        self._guard.daemon = True
        self._guard.start()
        self.carry_out(self._began)
        return replace(ports, clock=ScheduledClock(ports.clock, self))

    def close(self) -> None:
        """The run is over: nothing is to be stopped any more."""
        if self._guard is not None:
            self._guard.cancel()

    def seen(self) -> Seen:
        states, failures = tuple(self._states), tuple(self._failures)
        return Seen(states, failures, self._parked, self._missed, self._overdue, tuple(self._trouble))

    # an agenda

    def next_due(self) -> float | None:
        return min((t for t, _ in self._due), default=None)

    def carry_out(self, now: float) -> None:
        self._carry_out(now, lambda action: True)

    def _carry_out(self, now: float, which: Callable[[Action], bool]) -> None:
        for t, action in sorted(self._due, key=lambda item: item[0]):
            if t <= now and which(action):
                self._due.remove((t, action))
                self._without_raising(partial(self._do, t, action))

    # an observer

    def entered(self, t: float, step: Step) -> None:
        left = [(due, action) for due, action in self._due if action.when.state is not None and due > t]
        self._due = [item for item in self._due if item not in left]  # it would meet another state
        self._late += [action for _, action in left]
        visit = self._states.count(step.target) + 1
        self._states.append(step.target)

        def moment(action: Action) -> float | None:
            it_is = action.when.state is step.target and action.when.visit == visit
            return t - self._began + action.when.after_s if it_is else None

        self._schedule(moment)
        # what is said before a question was asked does not answer it: that waits until the effect has begun
        self._carry_out(t, lambda action: action.say is None)
        if step.target in TERMINAL:
            self._without_raising(self._look_at_the_end)

    def performed(self, t: float, step: Step, result: Result) -> None:
        if result.event in FAILING and result.context.failure is not None:
            self._failures.append(result.context.failure.kind)

    def _schedule(self, moment: Callable[[Action], float | None]) -> None:
        """Put down what is due at a moment [s] since the run began that is known now."""
        for action in tuple(self._waiting):
            at = moment(action)
            if at is not None:
                self._waiting.remove(action)
                self._due.append((self._began + at, action))

    def _do(self, t: float, action: Action) -> None:
        assert self._cell is not None
        if action.fault is not None:
            fault = action.fault.at(t)
            self._faults.append((fault, action))
            if self._cell.simulated is None:
                raise InternalError("only a simulated cell can be made to fail")
            self._cell.simulated.faults.add(fault)
        elif action.say is not None:
            self._overdue = self._overdue or action is GIVE_UP
            self._said.append((self._commands.put(action.say), action))
        elif action.stop is not None:
            self._cell.ports.stop.trigger(action.stop)
        elif action.tell is not None:
            self._tell(action.tell)

    def _look_at_the_end(self) -> None:
        assert self._cell is not None
        ports, simulated = self._cell.ports, self._cell.simulated
        astray = float(np.abs(ports.arms.state().q - self._rest).max())
        openings = [gripper.state().opening for gripper in ports.grippers.values()]
        self._parked = astray < AT_REST and min(openings) > OPEN
        happened = [fault for _, fault in simulated.truth.now().faults] if simulated and self._faults else []
        not_so = []
        for fault, action in self._faults:  # equal ones are told apart by their number
            if fault in happened:
                happened.remove(fault)
            else:
                not_so.append(action)
        still = [action for _, action in self._due] + [action for said, action in self._said if not said.taken]
        missed = (*self._waiting, *self._late, *still, *not_so)
        self._missed = tuple(action for action in missed if action is not GIVE_UP and action is not HALT)

    def _without_raising(self, act: Callable[[], None]) -> None:
        """The run must not end by its script's trouble; the script has failed then."""
        try:
            act()
        except Exception as e:
            self._trouble.append(f"{type(e).__name__}: {e}")
