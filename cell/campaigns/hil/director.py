"""The director carries out the actions of a script during a run and records what happens.

A director is an observer of the state machine, and the executive's clock carries out its scheduled actions. It
acts only through the usual inputs: it puts commands into the command queue, triggers the stop circuit, and adds
faults to the simulated cell. While the cell does not sleep on this clock (for example while an attendant lays the
garment), due actions wait until the next sleep or the end of the effect. Answers wait until the next sleep, which
is that of the next question: earlier answers do not count for it.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from foldcell.cell.campaigns.hil.script import LIMIT_S, Action
from foldcell.cell.hardware.driver import OpenCell
from foldcell.cell.simulation import Fault
from foldcell.cell.states.commands import ANSWERS, CommandQueue, QueuedCommand
from foldcell.cell.states.observers import FAILING, Step
from foldcell.cell.states.run_context import Result
from foldcell.cell.states.transition_table import TERMINAL, Event, State
from foldcell.cell.support.forwarding import forwarding
from foldcell.robots.errors import FailureKind, InternalError
from foldcell.robots.ports import Array, Clock, JointSetpoint, Ports

OVERTIME = "the script's time is over"
GIVE_UP, HALT = Action.model_validate({"say": Event.ABORT.value}), Action.model_validate({"stop": OVERTIME})
"""Actions for a run that exceeds its time limit: GIVE_UP first, HALT if the run still does not end."""
GRACE_S = 60.0
"""Cell time between GIVE_UP and HALT [s]."""
WALL_FACTOR = 3.0
"""If the cell's clock stops, the stop is triggered when the wall time exceeds this multiple of the time limit."""
AT_REST = 0.02
"""The arms count as parked if each joint is closer to the rest pose than this [rad]."""
OPEN = 0.01
"""The hands count as open if their pads are further apart than this [m]."""


@dataclass(frozen=True)
class Observations:
    """Observations of a run, in addition to its result.

    states, failures: in order of time. parked: whether the arms are in their rest pose and the hands open at the
    end. missed: actions that were never due, faults that never happened and commands that were never taken.
    overdue: whether the run was aborted at its time limit. trouble: errors that occurred while the script was
    carried out. sent_after_stop: number of set-points that were sent after a stop.
    """

    states: tuple[State, ...]
    failures: tuple[FailureKind, ...]
    parked: bool
    missed: tuple[Action, ...]
    overdue: bool = False
    trouble: tuple[str, ...] = ()
    sent_after_stop: int = 0

    @property
    def not_done(self) -> tuple[str, ...]:
        """Everything that the script states and that did not happen, in words."""
        return (*map(str, self.missed), *self.trouble)


def scheduled(clock: Clock, schedule: Director) -> Clock:
    """Return a clock whose sleep wakes at each scheduled action and carries it out, also between two set-points of
    a motion."""

    def sleep_until(t: float) -> None:
        schedule.carry_out(clock.now())
        while (due := schedule.next_due()) is not None and due < t:
            clock.sleep_until(due)
            schedule.carry_out(clock.now())
        clock.sleep_until(t)
        schedule.carry_out(clock.now())

    return forwarding(clock, sleep_until=sleep_until)


class Director:
    """Carries out the actions of one run. Call `begin` before the first effect; from then on the director observes
    the runner."""

    def __init__(
        self,
        actions: Sequence[Action],
        rest: Array,
        tell: Callable[[str], None],
        seed: int = 0,
        limit_s: float = LIMIT_S,
    ) -> None:
        """rest: (joints,) rest pose of the arms [rad]. tell: shows a line to the person at the cell. seed: draws
        random moments. limit_s: cell time after which the run is aborted [s]."""
        self._pending = [
            action.model_copy(update={"when": action.when.drawn(seed, index)})
            for index, action in enumerate(actions)
        ]
        self._due: list[tuple[float, Action]] = []
        self._faults: list[tuple[Fault, Action]] = []
        self._rest, self._tell = rest, tell
        self._cell: OpenCell | None = None
        self._commands = CommandQueue()
        self._began = 0.0
        self._states: list[State] = []
        self._failures: list[FailureKind] = []
        self._parked = False
        self._commanded: list[tuple[QueuedCommand, Action]] = []
        self._dropped: list[Action] = []
        self._missed: tuple[Action, ...] = tuple(self._pending)
        self._limit = limit_s
        self._overdue = False
        self._trouble: list[str] = []
        self._wall_timer: threading.Timer | None = None
        self._stopped = False
        self._sent_after_stop = 0

    def begin(self, cell: OpenCell, commands: CommandQueue) -> Ports:
        """Start the script. Returns the ports for the executive; their clock carries out the scheduled actions."""
        ports = cell.ports
        self._cell, self._commands, self._began = cell, commands, ports.clock.now()
        self._schedule(lambda action: action.when.time_s)
        self._due += [(self._began + self._limit, GIVE_UP), (self._began + self._limit + GRACE_S, HALT)]
        wall_limit = WALL_FACTOR * (self._limit + GRACE_S)
        self._wall_timer = threading.Timer(wall_limit, ports.stop.trigger, [OVERTIME])
        self._wall_timer.daemon = True
        self._wall_timer.start()
        self.carry_out(self._began)

        def command(q: Array, qd: Array) -> JointSetpoint:
            self._note_stop()
            self._sent_after_stop += self._stopped  # a set-point counts even if the driver refuses it
            return ports.arms.command(q, qd)

        arms = forwarding(ports.arms, command=command)
        return replace(ports, clock=scheduled(ports.clock, self), arms=arms)

    def close(self) -> None:
        """Cancel the wall-clock limit. Call it after the run has ended."""
        if self._wall_timer is not None:
            self._wall_timer.cancel()

    def seen(self) -> Observations:
        states, failures = tuple(self._states), tuple(self._failures)
        return Observations(
            states, failures, self._parked, self._missed, self._overdue, tuple(self._trouble),
            self._sent_after_stop,
        )  # fmt: skip

    # Schedule

    def next_due(self) -> float | None:
        return min((t for t, _ in self._due), default=None)

    def carry_out(self, now: float) -> None:
        self._carry_out(now, lambda action: True)
        self._note_stop()

    def _note_stop(self) -> None:
        """Read the stop circuit. A stop counts from the first time that it is found, also if the circuit closes
        again by itself."""
        assert self._cell is not None
        self._stopped = self._stopped or self._cell.ports.stop.state().stopped

    def _carry_out(self, now: float, selected: Callable[[Action], bool]) -> None:
        for t, action in sorted(self._due, key=lambda item: item[0]):
            if t <= now and selected(action):
                self._due.remove((t, action))
                self._without_raising(partial(self._do, t, action))

    # observer

    def entered(self, t: float, step: Step) -> None:
        left = [(due, action) for due, action in self._due if action.when.state is not None and due > t]
        self._due = [item for item in self._due if item not in left]  # the state of these actions has ended
        for due, action in left:
            if action.when.at_latest:
                self._without_raising(partial(self._do, min(due, t), action))
            else:
                self._dropped.append(action)
        visit = self._states.count(step.target) + 1
        self._states.append(step.target)

        def moment(action: Action) -> float | None:
            matches = action.when.state is step.target and action.when.visit == visit
            return t - self._began + action.when.after_s if matches else None

        self._schedule(moment)
        # all actions except commands; a command waits until the effect has begun, because a command that comes
        # before the effect's question does not answer it
        self._carry_out(t, lambda action: action.say is None)
        if step.target in TERMINAL:
            self._without_raising(self._observe_end)

    def performed(self, t: float, step: Step, result: Result) -> None:
        if result.event in FAILING and result.context.failure is not None:
            self._failures.append(result.context.failure.kind)
        # of an effect that did not sleep: a look over ROS
        self._carry_out(t, lambda action: action.say not in ANSWERS)

    def _schedule(self, moment: Callable[[Action], float | None]) -> None:
        """Schedule the pending actions for which `moment` returns a time since the start of the run [s]."""
        for action in tuple(self._pending):
            at = moment(action)
            if at is not None:
                self._pending.remove(action)
                self._due.append((self._began + at, action))

    def _do(self, t: float, action: Action) -> None:
        assert self._cell is not None
        if action.fault is not None:
            fault = action.fault.at(t)
            self._faults.append((fault, action))
            if self._cell.simulated is None:
                raise InternalError("faults need a simulated cell")
            self._cell.simulated.faults.add(fault)
        elif action.say is not None:
            self._overdue = self._overdue or action is GIVE_UP
            self._commanded.append((self._commands.put(action.say), action))
        elif action.stop is not None:
            self._cell.ports.stop.trigger(action.stop)
        elif action.tell is not None:
            self._tell(action.tell)

    def _observe_end(self) -> None:
        assert self._cell is not None
        ports, simulated = self._cell.ports, self._cell.simulated
        distance = float(np.abs(ports.arms.state().q - self._rest).max())
        openings = [gripper.state().opening for gripper in ports.grippers.values()]
        self._parked = distance < AT_REST and min(openings) > OPEN
        happened = [fault for _, fault in simulated.truth.now().faults] if simulated and self._faults else []
        absent = []
        for fault, action in self._faults:  # equal faults are counted one by one
            if fault in happened:
                happened.remove(fault)
            else:
                absent.append(action)
        due = [action for _, action in self._due]
        not_taken = [action for command, action in self._commanded if not command.taken]
        missed = (*self._pending, *self._dropped, *due, *not_taken, *absent)
        self._missed = tuple(action for action in missed if action is not GIVE_UP and action is not HALT)

    def _without_raising(self, act: Callable[[], None]) -> None:
        """Call `act` and record an error instead of raising it. The run then continues, and the script fails."""
        try:
            act()
        except Exception as e:
            self._trouble.append(f"{type(e).__name__}: {e}")
