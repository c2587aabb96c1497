"""Perform the effects of a procedure one by one, with intent and result in the journal."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from foldcell.calibration.effects import (
    ANSWERABLE,
    Bring,
    Effect,
    Grip,
    Look,
    Note,
    Procedure,
    Reach,
    RecordTactile,
    Sight,
    Touch,
)
from foldcell.cell.calibrating.reach import reach, settled_joints, with_board
from foldcell.cell.calibrating.touch import touch_table
from foldcell.cell.control.checks import stopped
from foldcell.cell.control.motions.hold_position import wait
from foldcell.cell.control.ticks import TICK_S
from foldcell.cell.executive.effects.seeing import capture
from foldcell.cell.hardware.workcell import Workcell
from foldcell.cell.journal.journal import RunJournal
from foldcell.robots.errors import DriverError, Failure, FailureKind
from foldcell.robots.ports import BoardPlace, Side, TactileReading
from foldcell.skills.grasping.hand_reading import GripCommand
from foldcell.skills.vocabulary import Outcome, refuse, skill

STATE = "calibrating"
GRIP_S = 0.8
IN_HAND = {BoardPlace.LEFT_HAND: Side.LEFT, BoardPlace.RIGHT_HAND: Side.RIGHT}

T = TypeVar("T")


class ProcedureRunner:
    """Runs one procedure on one cell. say(t, text): shows progress at cell time t [s]. keep(name, picture): saves
    a picture (h, w, 3) in the run folder."""

    def __init__(
        self,
        cell: Workcell,
        journal: RunJournal,
        say: Callable[[float, str], None],
        keep: Callable[[str, NDArray[np.uint8]], None],
    ) -> None:
        self._cell_without_board = self._cell = cell
        self._journal, self._say, self._keep = journal, say, keep
        self._performers: Mapping[type, Callable[[Any], Outcome[Any]]] = {
            Look: self._look,
            Reach: lambda effect: reach(self._cell, effect),
            Touch: lambda effect: touch_table(self._cell, effect),
            RecordTactile: self._listen,
            Grip: self._grip,
            Bring: self._bring,
        }

    @property
    def holds_board(self) -> bool:
        return self._cell is not self._cell_without_board

    @skill
    def run(self, procedure: Procedure[T]) -> Outcome[T]:
        """Run the procedure to its end, or to the first failure that it cannot handle (see ANSWERABLE)."""
        try:
            effect = next(procedure)
            while True:
                answer = self._perform(effect)
                if answer.failure and answer.failure.kind not in ANSWERABLE:
                    procedure.close()
                    return Outcome(failure=answer.failure)
                effect = procedure.send(answer)
        except StopIteration as end:
            return end.value

    def take_board(self) -> None:
        """Ask the attendant to take the board out of the hand. Raises DriverError."""
        self._bring(Bring(BoardPlace.AWAY))

    def _perform(self, effect: Effect) -> Outcome[Any]:
        clock = self._cell.ports.clock
        if isinstance(effect, Note):
            return self._note(effect)
        failure = stopped(self._cell.ports)
        if failure:
            return Outcome(failure=failure)
        intent = self._journal.intent(clock.now(), STATE, type(effect).__name__.lower(), {"effect": effect})
        try:
            answer = self._performers[type(effect)](effect)
        except Exception as e:  # it ends the procedure; before that, the journal gets the result of the intent
            crash = Failure(FailureKind.SKILL_CRASHED, f"{type(e).__name__}: {e}")
            failure = e.failure() if isinstance(e, DriverError) else crash
            self._journal.result(intent, clock.now(), _record(Outcome(failure=failure)))
            raise
        self._journal.result(intent, clock.now(), _record(answer))
        return answer

    def _note(self, effect: Note) -> Outcome[bool]:
        t = self._cell.ports.clock.now()
        self._journal.event(t, STATE, "note", {"text": effect.text})
        self._say(t, effect.text)
        if effect.picture is not None:
            self._keep(effect.name, effect.picture)
        return Outcome(True)

    @skill
    def _look(self, _: Look) -> Outcome[Sight]:
        q = settled_joints(self._cell).unwrap()
        return Outcome(Sight(capture(self._cell).unwrap(), q))

    @skill
    def _listen(self, effect: RecordTactile) -> Outcome[Mapping[Side, tuple[TactileReading, ...]]]:
        cell = self._cell
        readings: dict[Side, list[TactileReading]] = {side: [] for side in Side}

        def gather(_: object) -> Failure | None:
            for side, recorded in readings.items():
                reading = cell.ports.tactile[side].reading()
                if not recorded or reading.stamp > recorded[-1].stamp:
                    recorded.append(reading)
            return None

        refuse(wait(cell.loop, max(effect.seconds, TICK_S), gather))
        return Outcome({side: tuple(recorded) for side, recorded in readings.items()})

    @skill
    def _grip(self, effect: Grip) -> Outcome[bool]:
        cell = self._cell
        cell.hands.command(effect.side, GripCommand(effect.opening, effect.force))
        refuse(wait(cell.loop, GRIP_S))
        return Outcome(True)

    def _bring(self, effect: Bring) -> Outcome[bool]:
        """Ask the attendant to move the board. Collision checks include the board from before it is put into a
        hand until after it is removed."""
        side = IN_HAND.get(effect.place)
        if side is not None:
            self._cell = with_board(self._cell_without_board, side)
        self._cell.ports.attendant.bring_board(effect.place)
        if side is None:
            self._cell = self._cell_without_board
        return Outcome(True)


def _record(answer: Outcome[Any]) -> dict[str, Any]:
    f = answer.failure
    if f is None:
        return {"event": "done"}
    return {"event": "failed", "kind": f.kind.value, "what": f.what, "hint": f.hint, "values": dict(f.values)}
