"""The runner: journal entries around every effect, and the operator, stops and crashes between two effects."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from foldcell.cell.config.garments.garment_file import load_garment
from foldcell.cell.executive.effects import EFFECTS
from foldcell.cell.executive.effects.inspecting import next_step
from foldcell.cell.executive.effects.recovery.deciding import ask_approval, ask_operator, pause
from foldcell.cell.executive.runner import EffectFunction, Runner
from foldcell.cell.journal.journal import Journal, RunJournal, performed
from foldcell.cell.states.observers import Step
from foldcell.cell.states.run_context import Result, RunContext, RunEnd
from foldcell.cell.states.transition_table import REENTRIES, Effect, Event, State
from foldcell.robots.errors import DriverError, Failure, FailureKind, StorageError
from foldcell.robots.ports import Side
from foldcell.skills.vocabulary import FoldLine, FoldStep
from tests.builders.contexts import context_with
from tests.builders.records import record_builder
from tests.fakes import FakeCell
from tests.inspections import inspection
from tests.workcells import fake_workcell

K = FailureKind
PATIENCE = 0.1
STRAIGHT = [
    Effect.PREPARE, Effect.PHOTOGRAPH_TABLE, Effect.AWAIT_GARMENT, Effect.LOOK, Effect.RECOGNISE,
    Effect.PLAN_FOLDS, Effect.CHOOSE_TRAJECTORY, Effect.PLAN_MOTION, Effect.CHECK_PLACE, Effect.APPROACH,
    Effect.GRASP, Effect.LIFT, Effect.FOLD, Effect.RELEASE, Effect.RETREAT, Effect.LOOK, Effect.INSPECT,
]  # fmt: skip


def photographed(cell: Any, context: RunContext) -> Result:
    return Result(Event.DONE, context_with(context, reference=cell.ports.camera.capture()))


def laid_back(cell: Any, context: RunContext) -> Result:
    """Laying back succeeds. After an abort it ends the run."""
    assert context.failure is not None
    return Result(Event.GIVE_UP if context.failure.kind is K.ABORTED else Event.DONE, context)


class Rig:
    """A runner whose effects take one second of cell time and do nothing else, except those that a test
    replaces."""

    def __init__(self, run: RunJournal, journal: Journal) -> None:
        self.cell = FakeCell()
        self.journal, self.journal_file = journal, run
        self.performed: list[Effect] = []
        self.after: dict[Effect, Callable[[], object]] = {}
        self.answers: dict[Effect, list[Callable[[], object]]] = {}
        self.special: dict[Effect, EffectFunction] = {
            Effect.ASK_APPROVAL: ask_approval,
            Effect.ASK_OPERATOR: ask_operator,
            Effect.WAIT: pause,
            Effect.CHOOSE_RECOVERY: EFFECTS[Effect.CHOOSE_RECOVERY],
            Effect.PHOTOGRAPH_TABLE: photographed,
            Effect.LAY_BACK: laid_back,
            Effect.INSPECT: lambda c, x: Result(Event.ALL_FOLDED, x),
        }
        self.observers: tuple[Any, ...] = ()
        self.keep: Callable[[RunContext], None] = lambda context: None
        self.workcell = fake_workcell(self.cell)

    def attended(self, **changes: bool) -> None:
        self.workcell = fake_workcell(self.cell, attended=True, commands=self.workcell.commands, **changes)

    def say(self, command: Event) -> Callable[[], object]:
        return lambda: self.workcell.commands.put(command)

    def answer(self, question: Effect, *answers: Callable[[], object]) -> None:
        """The operator answers this question in this order, each time after PATIENCE. The wait takes as long in
        real time."""
        self.answers[question] = list(answers)

    def run(self, context: RunContext | None = None, first: Event = Event.START) -> RunEnd:
        effects = {effect: self._effect(effect) for effect in Effect}
        commands = self.workcell.commands
        runner = Runner(self.workcell, effects, self.journal_file, commands, self.observers, self.keep)
        return runner.run(context, first)

    def _effect(self, effect: Effect) -> EffectFunction:
        def perform(cell: Any, context: RunContext) -> Result:
            self.performed.append(effect)
            if effect not in {Effect.NOTHING, Effect.WAIT, Effect.ASK_APPROVAL, Effect.ASK_OPERATOR}:
                self.cell.ports().clock.sleep_until(self.cell.now + 1.0)
            if self.answers.get(effect):
                self.cell.at(self.cell.now + PATIENCE, self.answers[effect].pop(0))
            result = self.special.get(effect, lambda c, x: Result(Event.DONE, x))(cell, context)
            self.after.pop(effect, lambda: None)()
            return result

        return perform

    def entries(self, kind: str | None = None) -> list[Any]:
        return [e for e in self.journal.entries(self.journal_file.id) if kind in (None, e.kind)]

    def transitions(self) -> list[tuple[str, str]]:
        return [(e.name, e.state) for e in self.entries("event")]


@pytest.fixture
def rig(tmp_path: Path) -> Iterator[Rig]:
    with Journal.open(tmp_path / "journal.db") as journal:
        run = journal.begin_run(garment="medium_towel", seed=1, driver="fake")
        yield Rig(run, journal)
        run.abandon()


def failing(kind: FailureKind, times: int = 1) -> EffectFunction:
    """An effect that fails this many times and then succeeds."""
    left = [times]

    def effect(cell: Any, context: RunContext) -> Result:
        left[0] -= 1
        if left[0] < 0:
            return Result(Event.DONE, context)
        return Result(Event.FAILED, context.with_failure(Failure(kind, "it failed", "mend it", {"n": left[0]})))

    return effect


# a run without failures, and its journal


def test_a_run_without_failures_ends_folded(rig: Rig) -> None:
    end = rig.run()
    assert end.state is State.FOLDED
    assert rig.performed == [*STRAIGHT, Effect.NOTHING]
    assert end.ended - end.started == pytest.approx(len(STRAIGHT))
    assert sum(end.stage_times.values()) == pytest.approx(len(STRAIGHT))


def test_the_intent_is_on_disk_before_the_effect_and_its_result_after_it(rig: Rig) -> None:
    seen = []

    def read_the_journal(cell: Any, context: RunContext) -> Result:
        with Journal.open(rig.journal.path, readonly=True) as reader:  # as another process reads it
            intent = performed(reader.entries(rig.journal_file.id))[-1]
        seen.append((intent.begun.name, intent.begun.state, intent.begun.cell_time, intent.result))
        return Result(Event.DONE, context, {"force_n": 3.5})

    rig.special[Effect.GRASP] = read_the_journal
    rig.run()
    started = STRAIGHT.index(Effect.GRASP)
    assert seen == [("grasp", "grasping", float(started), None)]
    begun = next(e for e in rig.entries("intent") if e.name == "grasp")
    (ended,) = [e for e in rig.entries("result") if e.answers == begun.sequence]
    assert ended.cell_time == pytest.approx(started + 1.0)
    assert ended.payload["event"] == "done" and ended.payload["force_n"] == 3.5


def test_the_journal_records_every_transition(rig: Rig) -> None:
    end = rig.run()
    assert [e.name for e in rig.entries("intent")] == [e.value for e in STRAIGHT]
    assert rig.transitions()[0] == ("start", "preparing")
    assert rig.transitions()[-1] == ("all_folded", end.state.value)


def test_a_failure_is_noted_with_its_hint_and_figures(rig: Rig) -> None:
    rig.special[Effect.GRASP] = failing(K.MISSED_GRASP)
    assert rig.run().state is State.FOLDED
    failed = next(e for e in rig.entries("result") if e.payload["event"] == "failed")
    assert (failed.name, failed.payload["kind"]) == ("grasp", "missed_grasp")
    assert (failed.payload["what"], failed.payload["hint"]) == ("it failed", "mend it")
    assert failed.payload["values"] == {"n": 0}


def test_a_later_success_is_not_recorded_with_an_earlier_failure(rig: Rig) -> None:
    """Otherwise an operator's command or a plan that awaits approval would have a failure in the journal."""
    approving(rig)
    rig.special[Effect.GRASP] = failing(K.MISSED_GRASP)
    rig.special[Effect.RETREAT] = failing(K.HARDWARE_FAULT)
    approve = rig.say(Event.APPROVE)
    rig.answer(Effect.ASK_APPROVAL, approve, approve, approve)
    rig.answer(Effect.ASK_OPERATOR, rig.say(Event.RETRY))
    assert rig.run().state is State.FOLDED
    results = [(e.name, e.payload["event"], e.payload.get("kind")) for e in rig.entries("result")]
    assert {("plan_motion", "approval_needed", None), ("ask_operator", "retry", None)} <= set(results)
    assert [told for told in results if told[2]] == [
        ("grasp", "failed", "missed_grasp"),
        ("retreat", "failed", "hardware_fault"),
    ]


def test_observers_receive_every_step(rig: Rig) -> None:
    class Listener:
        def __init__(self) -> None:
            self.states: list[State] = []
            self.events: list[Event] = []

        def entered(self, t: float, step: Step) -> None:
            self.states.append(step.target)

        def performed(self, t: float, step: Step, result: Result) -> None:
            self.events.append(result.event)

    listener = Listener()
    rig.observers = (listener,)
    rig.run()
    assert [s.value for s in listener.states] == [state for _, state in rig.transitions()]
    assert [e.value for e in listener.events] == [name for name, _ in rig.transitions()][1:]


# failures


def test_the_cloth_is_laid_back_and_the_hands_are_cleared_before_the_next_attempt(rig: Rig) -> None:
    rig.special[Effect.FOLD] = failing(K.SLIPPED)
    assert rig.run().state is State.FOLDED
    at = rig.performed.index(Effect.FOLD)
    assert rig.performed[at : at + 5] == [
        Effect.FOLD, Effect.LAY_BACK, Effect.CLEAR, Effect.CHOOSE_RECOVERY, Effect.LOOK,
    ]  # fmt: skip


def test_a_second_clearing_follows_a_failed_one_and_a_third_does_not(rig: Rig) -> None:
    rig.special[Effect.GRASP] = failing(K.MISSED_GRASP)
    rig.special[Effect.CLEAR] = failing(K.TRACKING_ERROR)
    assert rig.run().state is State.FOLDED, "a transient is over at the second clearing"
    at = rig.performed.index(Effect.CLEAR)
    assert rig.performed[at : at + 3] == [Effect.CLEAR, Effect.CLEAR_AGAIN, Effect.CHOOSE_RECOVERY]
    assert ("failed", "making_safe") not in rig.transitions()


def test_only_a_second_failed_clearing_makes_the_cell_safe(rig: Rig) -> None:
    rig.special[Effect.GRASP] = failing(K.MISSED_GRASP)
    rig.special |= {effect: failing(K.TRACKING_ERROR) for effect in (Effect.CLEAR, Effect.CLEAR_AGAIN)}
    assert rig.run().state is State.FAULT
    assert rig.performed[-4:] == [Effect.CLEAR, Effect.CLEAR_AGAIN, Effect.MAKE_SAFE, Effect.NOTHING]


@pytest.mark.parametrize("effect", [Effect.LIFT, Effect.FOLD])
@pytest.mark.parametrize("kind", [K.STALE_STATE, K.TRACKING_ERROR, K.START_MISMATCH, K.IN_COLLISION])
def test_a_garment_released_during_a_fold_is_located_in_a_new_picture(
    rig: Rig, effect: Effect, kind: FailureKind
) -> None:
    held: Any = {Side.LEFT: object()}
    rig.special[Effect.GRASP] = lambda c, x: Result(Event.DONE, context_with(x, held=held))
    rig.special[effect] = failing(kind)
    assert rig.run().state is State.FOLDED
    at = rig.performed.index(effect)
    assert rig.performed[at : at + 5] == [
        effect, Effect.LAY_BACK, Effect.CLEAR, Effect.CHOOSE_RECOVERY, Effect.LOOK,
    ]  # fmt: skip


def test_a_garment_that_was_not_grasped_is_grasped_again_without_a_new_picture(rig: Rig) -> None:
    rig.special[Effect.CHOOSE_TRAJECTORY] = lambda c, x: Result(
        Event.DONE, context_with(x, garment=load_garment("t_shirt"), trajectory=SimpleNamespace(source="library"))
    )
    rig.special[Effect.GRASP] = failing(K.MISSED_GRASP)
    assert rig.run().state is State.FOLDED
    at = rig.performed.index(Effect.CHOOSE_RECOVERY)
    assert rig.performed[at + 1] is Effect.PLAN_MOTION


def frozen_state(cell: FakeCell) -> None:
    cell.frozen_since = cell.now


def pushed(cell: FakeCell) -> None:
    cell.follows, cell.q = False, cell.q + 0.2


BEGUN = STRAIGHT.index(Effect.LOOK) + 2
"""When the recovery after the first look begins to wait, for one second [s]."""


def test_arms_that_are_silent_for_a_while_during_a_recovery_wait_do_not_end_the_run(rig: Rig) -> None:
    """Their position is unknown meanwhile, so they get no set-points."""
    rig.special[Effect.LOOK] = failing(K.NO_GARMENT)
    rig.cell.at(BEGUN + 0.3, lambda: frozen_state(rig.cell))
    rig.cell.at(BEGUN + 0.8, lambda: setattr(rig.cell, "frozen_since", None))
    assert rig.run().state is State.FOLDED
    silent = [t for t, _ in rig.cell.commands if BEGUN + 0.45 < t < BEGUN + 0.8]
    assert silent == [] and Effect.MAKE_SAFE not in rig.performed


def test_arms_that_are_pushed_during_a_recovery_wait_are_made_safe(rig: Rig) -> None:
    rig.special[Effect.LOOK] = failing(K.NO_GARMENT)
    rig.cell.at(BEGUN + 0.3, lambda: pushed(rig.cell))
    end = rig.run()
    assert end.state is State.FAULT
    assert rig.performed[-3:] == [Effect.CHOOSE_RECOVERY, Effect.MAKE_SAFE, Effect.NOTHING]
    assert rig.transitions()[-2:] == [("failed", "making_safe"), ("done", "fault")]


def test_a_driver_error_during_a_question_makes_the_cell_safe(rig: Rig) -> None:
    def lost(cell: Any, context: RunContext) -> Result:
        raise DriverError(K.HARDWARE_FAULT, "the clock stands still")

    rig.attended()
    rig.special[Effect.LOOK] = failing(K.HARDWARE_FAULT)
    rig.special[Effect.ASK_OPERATOR] = lost
    end = rig.run()
    assert end.state is State.FAULT and rig.performed[-2:] == [Effect.MAKE_SAFE, Effect.NOTHING]
    assert end.context.failure is not None and end.context.failure.what == "the clock stands still"


def test_an_event_without_a_transition_is_a_crash_and_makes_the_cell_safe(rig: Rig) -> None:
    rig.special[Effect.LOOK] = lambda c, x: Result(Event.NEXT_FOLD, x)
    end = rig.run()
    assert end.state is State.FAULT and Effect.MAKE_SAFE in rig.performed
    assert end.context.failure is not None and end.context.failure.kind is K.SKILL_CRASHED
    assert "next_fold" in end.context.failure.what


# skipped folds


LINE = FoldLine(np.zeros(2), np.array([1.0, 0.0]))


def plan_of(*names: str) -> Any:
    return tuple(FoldStep(name, k, LINE, (), {}, {}) for k, name in enumerate(names))


def test_skip_needs_a_recognised_garment(rig: Rig) -> None:
    rig.attended()
    rig.special |= {Effect.RECOGNISE: failing(K.UNKNOWN_GARMENT, 9), Effect.NEXT_STEP: next_step}
    rig.answer(Effect.ASK_OPERATOR, rig.say(Event.SKIP))
    end = rig.run()
    assert end.state is State.NOT_FOLDED
    assert end.context.failure is not None and end.context.failure.kind is K.UNKNOWN_GARMENT


def test_a_skipped_fold_is_reported_and_the_garment_is_not_folded(rig: Rig) -> None:
    rig.attended()
    rig.special |= {
        Effect.PLAN_FOLDS: lambda c, x: Result(Event.DONE, context_with(x, steps=plan_of("half", "quarter"))),
        Effect.GRASP: failing(K.HARDWARE_FAULT, 9),
        Effect.NEXT_STEP: next_step,
    }
    rig.answer(Effect.ASK_OPERATOR, rig.say(Event.SKIP), rig.say(Event.SKIP))
    end = rig.run()
    assert end.state is State.NOT_FOLDED
    assert end.context.failure is not None and end.context.failure.what.endswith("half, quarter")


def refused_fold(rig: Rig) -> None:
    """A run with one fold that is made, inspected and refused. The operator is asked."""
    rig.attended()
    seen = inspection(diagnosis=K.SAG)
    shape: Any = SimpleNamespace(vertices=np.zeros((3, 3)))
    arc: Any = SimpleNamespace(source="library", duration=2.0)

    def planned(cell: Any, context: RunContext) -> Result:
        return Result(Event.DONE, context_with(context, steps=plan_of("half"), predicted=shape, trajectory=arc))

    def refused(cell: Any, context: RunContext) -> Result:
        return failing(K.SAG, 9)(cell, context_with(context, inspection=seen))

    rig.special |= {
        Effect.PLAN_FOLDS: planned,
        Effect.RELEASE: lambda c, x: Result(Event.DONE, context_with(x, carried=True)),
        Effect.INSPECT: refused,
        Effect.NEXT_STEP: next_step,
    }


def test_an_inspected_fold_that_is_skipped_counts_as_made(rig: Rig) -> None:
    """The operator has seen the inspected fold and accepts it."""
    refused_fold(rig)
    rig.answer(Effect.ASK_OPERATOR, rig.say(Event.SKIP))
    end = rig.run()
    assert end.state is State.FOLDED and [note.name for note in end.context.done] == ["half"]


def test_a_fold_undone_and_skipped_does_not_count_as_made(rig: Rig) -> None:
    """An operator who chooses to retry has laid the garment back to its shape before the fold."""
    refused_fold(rig)

    def lost() -> None:
        rig.special |= {Effect.PLAN_FOLDS: failing(K.HARDWARE_FAULT, 9)}
        rig.workcell.commands.put(Event.RETRY)

    rig.answer(Effect.ASK_OPERATOR, lost, rig.say(Event.SKIP))
    end = rig.run()
    assert end.state is State.NOT_FOLDED and end.context.done == () and end.context.through


@pytest.mark.parametrize("kind", [K.MISSED_GRASP, K.UNREACHABLE, K.STALE_STATE, K.HARDWARE_FAULT])
def test_an_effect_that_always_fails_ends_the_run_safely(rig: Rig, kind: FailureKind) -> None:
    rig.special[Effect.GRASP] = failing(kind, 1000)
    end = rig.run()
    assert end.state is State.NOT_FOLDED
    assert rig.performed[-2:] == [Effect.MAKE_SAFE, Effect.NOTHING]
    assert rig.performed.count(Effect.GRASP) <= 5
    assert end.context.failure.kind is kind


def test_a_driver_that_raises_is_a_failure_like_any_other(rig: Rig) -> None:
    def silent(cell: Any, context: RunContext) -> Result:
        raise DriverError(K.CAMERA_FAULT, "the camera does not answer", "look at its cable", waited_s=2.0)

    rig.special[Effect.LOOK] = silent
    end = rig.run()
    assert end.state is State.NOT_FOLDED
    assert rig.performed.count(Effect.LOOK) == 6, "it looks again after 1, 2, 4, 8 and 15 s: recovery.patience"
    failed = [e.payload for e in rig.entries("result") if e.name == "look"]
    assert all((f["kind"], f["values"]) == ("camera_fault", {"waited_s": 2.0}) for f in failed)


@pytest.mark.parametrize("effect", [Effect.PREPARE, Effect.RECOGNISE, Effect.RELEASE])
def test_a_crash_makes_the_cell_safe_and_ends_as_a_fault(rig: Rig, effect: Effect) -> None:
    def crash(cell: Any, context: RunContext) -> Result:
        raise ZeroDivisionError("of course")

    rig.special[effect] = crash
    end = rig.run()
    assert end.state is State.FAULT
    assert rig.performed[-3:] == [effect, Effect.MAKE_SAFE, Effect.NOTHING]
    crashed = next(e.payload for e in rig.entries("result") if e.name == effect.value)
    assert crashed["kind"] == "skill_crashed" and "ZeroDivisionError: of course" in crashed["what"]
    assert "Traceback" in crashed["values"]["traceback"]


@pytest.mark.parametrize("effect", [Effect.LIFT, Effect.FOLD])
def test_after_a_crash_with_cloth_in_the_hands_the_cloth_is_laid_down_first(rig: Rig, effect: Effect) -> None:
    def crash(cell: Any, context: RunContext) -> Result:
        raise ZeroDivisionError("of course")

    for laying in (lambda c, x: Result(Event.CRASH, x), crash):  # also if the laying meets the same bug
        rig.special[effect], rig.special[Effect.LAY_BACK] = crash, laying
        end = rig.run()
        assert end.state is State.FAULT
        assert rig.performed[-4:] == [effect, Effect.LAY_BACK, Effect.MAKE_SAFE, Effect.NOTHING]
        assert end.context.failure is not None and end.context.failure.kind is K.SKILL_CRASHED


def test_a_crash_while_making_safe_holds_the_arms(rig: Rig) -> None:
    def crash(cell: Any, context: RunContext) -> Result:
        raise ValueError("twice")

    rig.special[Effect.FOLD] = rig.special[Effect.MAKE_SAFE] = crash
    assert rig.run().state is State.FAULT
    assert rig.performed[-2:] == [Effect.MAKE_SAFE, Effect.HOLD]


# stop


@pytest.mark.parametrize("effect", STRAIGHT)
def test_a_stop_ends_the_run_before_the_next_effect(rig: Rig, effect: Effect) -> None:
    rig.after[effect] = lambda: rig.workcell.ports.stop.trigger("button")
    end = rig.run()
    if effect is Effect.INSPECT:  # the stop comes after the last fold
        assert end.state is State.FOLDED
        return
    assert end.state is State.STOPPED
    assert rig.performed[-2:] == [effect, Effect.HOLD]
    assert end.context.failure.kind is K.STOPPED and "button" in end.context.failure.what
    assert rig.transitions()[-1] == ("stop", "stopped")


def test_a_stop_seen_by_an_effect_is_not_recovered(rig: Rig) -> None:
    rig.special[Effect.FOLD] = failing(K.STOPPED)
    assert rig.run().state is State.STOPPED
    assert rig.performed[-2:] == [Effect.FOLD, Effect.HOLD]


def test_a_stop_while_making_safe_ends_stopped(rig: Rig) -> None:
    rig.special[Effect.LOOK] = failing(K.HARDWARE_FAULT)
    rig.special[Effect.MAKE_SAFE] = failing(K.STOPPED)
    assert rig.run().state is State.STOPPED


# the operator


def test_an_approved_plan_is_approached(rig: Rig) -> None:
    rig.attended(approve=True)
    rig.special[Effect.PLAN_MOTION] = lambda c, x: Result(Event.APPROVAL_NEEDED, x)
    rig.answer(Effect.ASK_APPROVAL, rig.say(Event.APPROVE))
    end = rig.run()
    assert end.state is State.FOLDED
    at = rig.performed.index(Effect.ASK_APPROVAL)
    assert rig.performed[at - 1 : at + 3] == [
        Effect.PLAN_MOTION, Effect.ASK_APPROVAL, Effect.CHECK_PLACE, Effect.APPROACH
    ]  # fmt: skip
    asked = [e for e in rig.entries() if e.name == "ask_approval"]
    assert asked[1].payload["command"] == "approve"
    assert asked[1].cell_time - asked[0].cell_time == pytest.approx(PATIENCE, abs=0.02)
    assert end.context.waited_s == pytest.approx(PATIENCE, abs=0.02)


def test_a_plan_that_is_not_approved_is_not_executed(rig: Rig) -> None:
    rig.attended(approve=True)
    rig.special[Effect.PLAN_MOTION] = lambda c, x: Result(Event.APPROVAL_NEEDED, x)
    rig.answer(Effect.ASK_APPROVAL, rig.say(Event.ABORT))
    assert rig.run().state is State.NOT_FOLDED
    assert rig.performed[-3:] == [Effect.ASK_APPROVAL, Effect.MAKE_SAFE, Effect.NOTHING]
    assert Effect.APPROACH not in rig.performed


def test_a_refused_plan_is_followed_by_a_new_picture(rig: Rig) -> None:
    rig.attended(approve=True)
    rig.special[Effect.PLAN_MOTION] = lambda c, x: Result(Event.APPROVAL_NEEDED, x)
    rig.answer(Effect.ASK_APPROVAL, rig.say(Event.RETRY), rig.say(Event.APPROVE))
    assert rig.run().state is State.FOLDED
    at = rig.performed.index(Effect.ASK_APPROVAL)
    assert rig.performed[at + 1] is Effect.LOOK
    assert rig.performed.count(Effect.APPROACH) == 1


def test_an_approval_is_for_one_plan_only(rig: Rig) -> None:
    """An approval given twice for the first fold must not approve the second one."""
    rig.attended(approve=True)
    rig.special[Effect.PLAN_MOTION] = lambda c, x: Result(Event.APPROVAL_NEEDED, x)
    rig.special[Effect.INSPECT] = lambda c, x: Result(Event.NEXT_FOLD, x)
    approve = rig.say(Event.APPROVE)
    rig.answer(Effect.ASK_APPROVAL, lambda: [approve(), approve()], rig.say(Event.ABORT))
    assert rig.run().state is State.NOT_FOLDED
    assert rig.performed.count(Effect.APPROACH) == 1


def test_a_pause_between_two_effects_lasts_until_resume(rig: Rig) -> None:
    rig.after[Effect.LOOK] = rig.say(Event.PAUSE)
    rig.answer(Effect.WAIT, rig.say(Event.RESUME))
    end = rig.run()
    assert end.state is State.FOLDED
    assert [e for e in rig.performed if e is not Effect.WAIT] == [*STRAIGHT, Effect.NOTHING]
    at = rig.performed.index(Effect.WAIT)
    assert rig.performed[at - 1 : at + 2] == [Effect.LOOK, Effect.WAIT, Effect.RECOGNISE]
    assert ("pause", "paused") in rig.transitions() and ("resume", "recognising") in rig.transitions()
    assert end.context.waited_s == pytest.approx(PATIENCE, abs=0.02)
    assert rig.cell.commands == []


def test_events_within_an_effect_are_recorded_between_its_intent_and_result(rig: Rig) -> None:
    def fold(cell: Any, context: RunContext) -> Result:
        cell.note("paused", {"path_s": 1.25})
        return Result(Event.DONE, context)

    rig.special[Effect.FOLD] = fold
    remarks = record_builder()
    rig.observers = (remarks,)
    rig.run()
    assert [(r.kind, r.title, r.text) for r in remarks.events] == [("command", "paused", "while folding")], (
        "observers get the event too"
    )
    entries = list(rig.journal.entries(rig.journal_file.id))
    k = next(k for k, e in enumerate(entries) if e.name == "paused")
    assert entries[k].state == State.FOLDING.value and entries[k].payload["path_s"] == 1.25
    assert (entries[k - 1].kind, entries[k + 1].kind) == ("intent", "result")
    assert entries[k + 1].answers == entries[k - 1].sequence


def test_a_run_can_be_paused_twice(rig: Rig) -> None:
    rig.after[Effect.LOOK] = rig.say(Event.PAUSE)
    rig.after[Effect.FOLD] = rig.say(Event.PAUSE)
    rig.answer(Effect.WAIT, rig.say(Event.RESUME), rig.say(Event.RESUME))
    assert rig.run().state is State.FOLDED
    assert rig.performed.count(Effect.WAIT) == 2
    resumed = [rig.performed[k + 1] for k, effect in enumerate(rig.performed) if effect is Effect.WAIT]
    assert resumed == [Effect.RECOGNISE, Effect.RELEASE], "the postponed effect follows, once"


def test_a_paused_run_can_be_stopped(rig: Rig) -> None:
    rig.after[Effect.LOOK] = rig.say(Event.PAUSE)
    rig.answer(Effect.WAIT, lambda: rig.workcell.ports.stop.trigger("button"))
    assert rig.run().state is State.STOPPED


def test_the_result_names_the_final_cause_and_not_a_recovered_failure(rig: Rig) -> None:
    rig.special[Effect.GRASP] = failing(K.MISSED_GRASP)
    rig.after[Effect.RETREAT] = rig.say(Event.ABORT)
    end = rig.run()
    assert end.state is State.NOT_FOLDED
    assert end.context.failure.kind is K.ABORTED and end.context.failure.hint


@pytest.mark.parametrize(
    ("fails", "after", "tail"),
    [
        ({}, {Effect.PREPARE: Event.ABORT}, [Effect.PREPARE]),
        ({}, {Effect.RECOGNISE: Event.ABORT}, [Effect.RECOGNISE]),
        ({}, {Effect.FOLD: Event.ABORT}, [Effect.FOLD]),
        ({}, {Effect.LOOK: Event.PAUSE}, [Effect.LOOK, Effect.WAIT]),
        ({}, {Effect.LIFT: Event.PAUSE}, [Effect.LIFT, Effect.WAIT, Effect.LAY_BACK]),
        ({Effect.FOLD: K.ABORTED}, {}, [Effect.FOLD, Effect.LAY_BACK]),
        ({Effect.FOLD: K.SLIPPED, Effect.LAY_BACK: K.ABORTED}, {}, [Effect.FOLD, Effect.LAY_BACK]),
    ],
)
def test_an_abort_makes_the_cell_safe_and_lays_cloth_in_the_hands_back_before(
    rig: Rig, fails: dict[Effect, FailureKind], after: dict[Effect, Event], tail: list[Effect]
) -> None:
    """Between two effects, in a pause, during a motion and while cloth is laid back. No question follows."""
    rig.attended()
    rig.special |= {effect: failing(kind) for effect, kind in fails.items()}
    rig.after = {effect: rig.say(event) for effect, event in after.items()}
    rig.answer(Effect.WAIT, rig.say(Event.ABORT))
    end = rig.run()
    assert end.state is State.NOT_FOLDED and end.context.failure.kind is K.ABORTED
    assert rig.performed[-len(tail) - 2 :] == [*tail, Effect.MAKE_SAFE, Effect.NOTHING]


def laid_back_and_ended(cell: Any, context: RunContext) -> Result:
    assert context.failure is not None and context.failure.kind is K.ABORTED, "the run ends after the laying"
    return Result(Event.GIVE_UP, context)


@pytest.mark.parametrize("presses", [1, 2, 3])
@pytest.mark.parametrize("kind", [K.SLIPPED, K.ABORTED])
def test_an_abort_before_the_laying_does_not_drop_the_cloth(rig: Rig, kind: FailureKind, presses: int) -> None:
    """The key to end the run is pressed twice, or in the tick in which the fold fails."""
    rig.special |= {Effect.FOLD: failing(kind), Effect.LAY_BACK: laid_back_and_ended}
    rig.after[Effect.FOLD] = lambda: [rig.say(Event.ABORT)() for _ in range(presses)]
    assert rig.run().state is State.NOT_FOLDED
    assert rig.performed[-4:] == [Effect.FOLD, Effect.LAY_BACK, Effect.MAKE_SAFE, Effect.NOTHING]
    assert rig.workcell.commands.take({Event.ABORT}) is None


def test_an_abort_in_a_pause_before_the_laying_does_not_drop_the_cloth(rig: Rig) -> None:
    rig.special |= {Effect.FOLD: failing(K.SLIPPED), Effect.LAY_BACK: laid_back_and_ended}
    rig.after[Effect.FOLD] = rig.say(Event.PAUSE)
    rig.answer(Effect.WAIT, rig.say(Event.ABORT))
    assert rig.run().state is State.NOT_FOLDED
    assert rig.performed[-4:] == [Effect.WAIT, Effect.LAY_BACK, Effect.MAKE_SAFE, Effect.NOTHING]


def test_a_pause_does_not_prevent_making_the_cell_safe(rig: Rig) -> None:
    rig.special[Effect.LOOK] = failing(K.HARDWARE_FAULT)
    rig.after[Effect.CHOOSE_RECOVERY] = rig.say(Event.PAUSE)
    assert rig.run().state is State.NOT_FOLDED
    assert Effect.WAIT not in rig.performed


def test_the_operator_is_asked_after_the_last_recovery(rig: Rig) -> None:
    rig.attended()
    rig.special[Effect.LOOK] = failing(K.NO_GARMENT, 6)
    rig.answer(Effect.ASK_OPERATOR, rig.say(Event.RETRY))
    end = rig.run()
    assert end.state is State.FOLDED
    asked = rig.performed.index(Effect.ASK_OPERATOR)
    assert rig.performed[:asked].count(Effect.LOOK) == 6
    assert rig.performed[asked + 1] is Effect.LOOK
    assert end.context.waited_s > 0


# a journal that can no longer be written


def lose(rig: Rig) -> None:
    rig.journal._connection.execute("PRAGMA query_only = ON")


@pytest.mark.parametrize("effect", STRAIGHT)
def test_losing_the_journal_ends_the_run_with_the_arms_held(rig: Rig, effect: Effect) -> None:
    rig.after[effect] = lambda: lose(rig)
    end = rig.run()
    assert end.state is State.FAULT
    assert rig.performed[-2:] == [effect, Effect.HOLD], "nothing moves without a journal entry"
    failure = end.context.failure
    assert failure.kind is K.UNRECORDED and "journal.db" in failure.what
    assert "held where they are" in failure.hint and "read-only" in failure.hint
    last = performed(rig.journal.entries(rig.journal_file.id))[-1]
    assert last.begun.name == effect.value and last.result is None


def test_an_effect_does_not_start_if_its_intent_cannot_be_written(rig: Rig) -> None:
    class AtTheEntry:
        def entered(self, t: float, step: Step) -> None:
            seen.append(step.target)
            if step.target is State.FOLDING:
                lose(rig)

        def performed(self, t: float, step: Step, result: Result) -> None:
            failures.append(result.context.failure)

    seen: list[State] = []
    failures: list[Failure | None] = []
    rig.observers = (AtTheEntry(),)
    assert rig.run().state is State.FAULT
    assert rig.performed[-2:] == [Effect.LIFT, Effect.HOLD]
    assert seen[-2:] == [State.FOLDING, State.FAULT] and failures[-1].kind is K.UNRECORDED


def test_losing_journal_and_arms_asks_for_the_emergency_stop(rig: Rig) -> None:
    def silent(cell: Any, context: RunContext) -> Result:
        raise DriverError(K.HARDWARE_FAULT, "the robot is silent")

    rig.special[Effect.HOLD] = silent
    rig.after[Effect.FOLD] = lambda: lose(rig)
    end = rig.run()
    assert end.state is State.FAULT and "emergency stop" in end.context.failure.hint


def approving(rig: Rig) -> None:
    rig.attended(approve=True)
    rig.special[Effect.PLAN_MOTION] = lambda c, x: Result(Event.APPROVAL_NEEDED, x)


def test_an_approval_given_before_the_plan_exists_is_void(rig: Rig) -> None:
    """A key pressed twice for one fold must not approve the next fold unseen."""
    approving(rig)
    rig.after[Effect.PLAN_MOTION] = rig.say(Event.APPROVE)
    rig.answer(Effect.ASK_APPROVAL, rig.say(Event.ABORT))
    end = rig.run()
    assert end.state is State.NOT_FOLDED and Effect.APPROACH not in rig.performed


def test_an_approval_given_as_the_question_opens_counts(rig: Rig) -> None:
    """An operator may answer immediately, and a noted answer must not get lost."""

    class Hasty:
        def entered(self, t: float, step: Step) -> None:
            if step.target is State.AWAITING_APPROVAL:
                rig.workcell.commands.put(Event.APPROVE)

        def performed(self, t: float, step: Step, result: Result) -> None: ...

    approving(rig)
    rig.observers = (Hasty(),)
    assert rig.run().state is State.FOLDED


def test_a_stop_reported_by_the_driver_has_the_same_message_as_any_stop(rig: Rig) -> None:
    def refused(cell: Any, context: RunContext) -> Result:
        cell.ports.stop.trigger("the button")
        raise DriverError(K.STOPPED, "stopped: the button", "reset the stop, then enable the arms")

    rig.special[Effect.FOLD] = refused
    end = rig.run()
    assert end.state is State.STOPPED and end.context.failure is not None
    assert end.context.failure.what == "the stop was triggered: the button"
    assert end.context.failure.hint == "clear the cause, then resume or begin anew", (
        "a simulated stop needs no reset"
    )


def test_the_checkpoint_is_written_before_the_result_in_the_journal(rig: Rig) -> None:
    """A run killed between the two writes has a checkpoint that is at least as new as its journal."""
    kept: list[tuple[str, bool]] = []

    def keep(context: RunContext) -> None:
        last = performed(rig.journal.entries(rig.journal_file.id))[-1]
        kept.append((last.begun.name, last.result is None))

    rig.keep = keep
    rig.run()
    assert kept == [(effect.value, True) for effect in STRAIGHT[:-1]], (
        "the last inspection has no checkpoint and is repeated"
    )


def test_the_checkpoint_is_written_after_effects_without_a_journal_entry(rig: Rig) -> None:
    """An accepted fold advances the plan without an effect."""
    indices: list[int] = []
    rig.attended()
    drift = Failure(K.STUCK_ON_FINGER, "it clings")
    rig.special[Effect.INSPECT] = lambda c, x: Result(Event.FAILED, x.with_failure(drift))
    rig.special[Effect.CHOOSE_RECOVERY] = lambda c, x: Result(Event.CARRY_ON, x)
    rig.special[Effect.NEXT_STEP] = lambda c, x: Result(Event.NEXT_FOLD, context_with(x, index=x.fold.index + 1))
    rig.special[Effect.CHOOSE_TRAJECTORY] = lambda c, x: Result(Event.ABORT if x.fold.index else Event.DONE, x)
    rig.keep = lambda context: indices.append(context.fold.index)
    rig.run()
    assert indices.count(0) == len(STRAIGHT) + 1 and 1 in indices


@pytest.mark.parametrize("error", [StorageError("the disk is full"), TypeError("cannot pickle")])
def test_a_failing_checkpoint_ends_the_run_with_the_arms_held(rig: Rig, error: Exception) -> None:
    def keep(context: RunContext) -> None:
        if rig.performed[-1] is Effect.LIFT:
            raise error

    rig.keep = keep
    end = rig.run()
    assert end.state is State.FAULT and rig.performed[-2:] == [Effect.LIFT, Effect.HOLD]
    assert end.context.failure.kind is K.UNRECORDED


@pytest.mark.parametrize("effect", STRAIGHT[:-1])
def test_a_simulated_cell_that_no_longer_responds_ends_the_run_as_a_fault_of_the_driver(
    rig: Rig, effect: Effect
) -> None:
    """Its world cannot be saved then. The disk is sound: the journal has each result, and the run is finished."""

    def keep(context: RunContext) -> None:
        if effect in rig.performed:
            raise DriverError(K.HARDWARE_FAULT, "the emulated robot does not respond: its process ended")

    rig.keep = keep
    end = rig.run()
    assert end.state is State.FAULT and Effect.MAKE_SAFE in rig.performed[-2:]
    assert not {Effect.APPROACH, Effect.GRASP, Effect.FOLD} & set(rig.performed[rig.performed.index(effect) + 1 :])
    assert end.context.failure.kind is K.HARDWARE_FAULT and "its process ended" in end.context.failure.what
    assert all(entry.result is not None for entry in performed(rig.entries()))


def test_a_lost_checkpoint_does_not_replace_the_failure_of_its_effect(rig: Rig) -> None:
    """An emulated robot that does not answer in time is gone for the checkpoint too."""
    silent = DriverError(K.HARDWARE_FAULT, "the emulated robot does not respond: no answer in 120 s")

    def keep(context: RunContext) -> None:
        if Effect.LIFT in rig.performed:
            raise DriverError(K.HARDWARE_FAULT, "the emulated robot does not respond: its process ended")

    rig.keep = keep
    rig.special[Effect.LIFT] = lambda c, x: Result(Event.FAILED, x.with_failure(silent.failure()), {"height": 0.1})
    rig.run()
    (lift,) = (entry for entry in performed(rig.entries()) if entry.begun.name == Effect.LIFT.value)
    assert lift.result is not None
    assert lift.result.payload["height"] == 0.1 and "no answer" in lift.result.payload["what"]


def test_an_effect_that_fails_for_its_checkpoint_keeps_its_figures_and_events(rig: Rig) -> None:
    seen: dict[Effect, Result] = {}

    def keep(context: RunContext) -> None:
        if Effect.LIFT in rig.performed:
            raise DriverError(K.HARDWARE_FAULT, "the emulated robot does not respond: its process ended")

    def lift(cell: Any, context: RunContext) -> Result:
        cell.note("contact", {})
        return Result(Event.DONE, context, {"height": 0.1})

    rig.keep = keep
    rig.special[Effect.LIFT] = lift
    rig.observers = (
        SimpleNamespace(
            entered=lambda t, step: None,
            performed=lambda t, step, result: seen.setdefault(step.effect, result),
        ),
    )
    rig.run()
    result = seen[Effect.LIFT]
    assert result.event is Event.FAILED and result.context.failure.kind is K.HARDWARE_FAULT
    assert result.record == {"height": 0.1} and [name for _, name in result.within] == ["contact"]


@pytest.mark.parametrize("event", sorted(set(REENTRIES.values())))
def test_a_run_is_resumed_in_the_requested_state(rig: Rig, event: Event) -> None:
    rig.special[Effect.REENTER] = lambda c, x: Result(event, x)
    rig.run(RunContext(), Event.REENTER)
    first = {Event.START_OVER: Effect.PHOTOGRAPH_TABLE, Event.LAY: Effect.AWAIT_GARMENT}.get(event, Effect.LOOK)
    assert rig.performed[:2] == [Effect.REENTER, first] and Effect.PREPARE not in rig.performed
    states = [state for _, state in rig.transitions()][:2]
    assert (states == ["resuming", "looking_after"]) == (event is Event.LOOK_AFTER)
