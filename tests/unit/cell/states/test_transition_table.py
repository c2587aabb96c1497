"""Invariants of the transition table."""

from __future__ import annotations

from collections.abc import Collection

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from foldcell.cell.executive.machine import Executive, complete_table
from foldcell.cell.states.transition_table import (
    HANDS_CARRY_CLOTH,
    REENTRIES,
    TERMINAL,
    Effect,
    Event,
    State,
)
from foldcell.robots.errors import InternalError

ROWS = complete_table()
HANDS_ON_CLOTH = {
    row.target
    for row in ROWS
    if row.effect
    in {
        Effect.APPROACH, Effect.GRASP, Effect.LIFT, Effect.FOLD, Effect.RELEASE, Effect.RETREAT, Effect.PRESS,
        Effect.LAY_BACK,
    }
}  # fmt: skip
"""States whose failure leaves the hands near the garment."""
WORKING = [s for s in State if s not in TERMINAL and s is not State.IDLE]


def reachable(start: State, without: Collection[Event] = ()) -> set[State]:
    """The states that a run can reach from a state without these events."""
    seen, todo = {start}, [start]
    while todo:
        state = todo.pop()
        for target in {r.target for r in ROWS if r.state is state and r.event not in without} - seen:
            seen.add(target)
            todo.append(target)
    return seen


def test_every_state_is_reachable_and_leads_to_an_end() -> None:
    assert reachable(State.IDLE) == set(State)
    for s in WORKING:
        assert reachable(s) & TERMINAL, s


def test_terminal_states_have_no_transitions() -> None:
    assert not [r for r in ROWS if r.state in TERMINAL]


def test_each_state_and_event_has_one_row() -> None:
    assert len({(r.state, r.event) for r in ROWS}) == len(ROWS)


_GIVEN_UP = (State.GIVING_UP, Effect.MAKE_SAFE)


@pytest.mark.parametrize("state", WORKING)
def test_every_state_accepts_stop_and_crash(state: State) -> None:
    """States that already make the cell safe are not restarted, paused or aborted."""
    to = {r.event: (r.target, r.effect) for r in ROWS if r.state is state}
    safe = state in {State.GIVING_UP, State.MAKING_SAFE}
    assert to[Event.STOP] == (State.STOPPED, Effect.HOLD)
    assert to[Event.UNRECORDED] == (State.FAULT, Effect.HOLD)
    laid = (State.LAYING_BACK, Effect.LAY_BACK) if state in HANDS_CARRY_CLOTH else None
    made_safe = (State.FAULT, Effect.HOLD) if safe else (State.MAKING_SAFE, Effect.MAKE_SAFE)
    assert to[Event.CRASH] == (laid or made_safe), "cloth in the hands is laid down, not dropped"
    assert to.get(Event.ABORT) == (None if safe else laid or _GIVEN_UP)
    waits = safe or state is State.PAUSED
    assert to.get(Event.PAUSE) == (None if waits else (State.PAUSED, Effect.WAIT))


@pytest.mark.parametrize("state", WORKING)
def test_every_state_accepts_a_failure(state: State) -> None:
    """Every effect may fail. A kind then chooses the recovery (`RECOVERIES` has rows for each)."""
    to = {r.event: r.target for r in ROWS if r.state is state}
    assert to[Event.FAILED] in {
        State.RECOVERING, State.CLEARING, State.CLEARING_AGAIN, State.LAYING_BACK, State.MAKING_SAFE, State.FAULT
    }  # fmt: skip


def test_a_state_has_the_same_effect_from_every_previous_state() -> None:
    """INSPECTING and FAULT have two effects: a skipped fold is not inspected, and a safe cell needs no hold."""
    for state in set(State) - {State.IDLE}:
        effects = {r.effect for r in ROWS if r.target is state}
        assert len(effects) == (2 if state in {State.INSPECTING, State.FAULT} else 1), state
        assert Effect.NOTHING not in effects or state in TERMINAL, f"{state} has no effect"


@pytest.mark.parametrize("state", WORKING)
def test_every_working_state_has_a_failure_transition(state: State) -> None:
    """This includes states in which the cell only waits, because the arms can be pushed and the driver can fall
    silent. The run ends as a fault only if the cell could not be made safe."""
    (failed,) = (r for r in ROWS if r.state is state and r.event is Event.FAILED)
    safe = state in {State.GIVING_UP, State.MAKING_SAFE}
    assert (failed.target is State.FAULT) is safe
    aside = {State.LAYING_BACK, State.CLEARING, State.CLEARING_AGAIN, State.RECOVERING, State.MAKING_SAFE}
    assert safe or failed.target in aside


def test_a_failure_with_hands_on_the_cloth_leads_to_clearing() -> None:
    """Cloth in the hands is laid down before. A failed clearing is tried once more, before the cell is made safe
    in any case."""
    failing = {r.state: r.target for r in ROWS if r.event is Event.FAILED}
    for s in HANDS_ON_CLOTH - HANDS_CARRY_CLOTH:
        assert failing[s] is State.CLEARING
    for s in HANDS_CARRY_CLOTH:
        assert failing[s] is State.LAYING_BACK
    assert failing[State.CLEARING] is State.CLEARING_AGAIN
    assert failing[State.CLEARING_AGAIN] is State.MAKING_SAFE


def test_arms_approach_only_after_motion_planning_or_its_approval_and_a_look_at_the_garment() -> None:
    """Approaching moves the arms on a plan: only a fresh plan (or its approval) may lead there, and the garment
    must still lie where it was planned."""
    sources = {r.state for r in ROWS if r.target is State.APPROACHING}
    assert sources == {State.CHECKING}
    assert {r.state for r in ROWS if r.target is State.CHECKING} == {
        State.PLANNING_MOTION,
        State.AWAITING_APPROVAL,
    }


@pytest.mark.parametrize("folds", [1, 2, 5])
def test_the_machine_grasps_and_inspects_each_fold_and_ends_folded(folds: int) -> None:
    machine, entered = Executive(), list[State]()
    machine.handle(Event.START)
    while not machine.ended and len(entered) < 100:
        entered.append(machine.state)
        all_folded = entered.count(State.INSPECTING) == folds
        inspected = Event.ALL_FOLDED if all_folded else Event.NEXT_FOLD
        machine.handle(inspected if machine.state is State.INSPECTING else Event.DONE)
    assert machine.state is State.FOLDED
    assert entered.count(State.GRASPING) == entered.count(State.INSPECTING) == folds
    assert entered.count(State.RECOGNISING) == 1, "later folds are planned from the inspected shape"


def test_a_fold_is_pressed_only_right_after_it_was_inspected() -> None:
    """The hands' paths were planned in the inspection, and the approval is for this plan."""
    ways_in = {(r.state, r.event) for r in ROWS if r.target is State.PRESSING and r.event is not Event.RESUME}
    assert ways_in == {(State.INSPECTING, Event.PRESS), (State.AWAITING_PRESSING, Event.APPROVE)}
    assert {r.state for r in ROWS if r.target is State.AWAITING_PRESSING} == {State.INSPECTING}
    done = next(r for r in ROWS if (r.state, r.event) == (State.PRESSING, Event.DONE))
    assert done.target is State.RETREATING, "a pressed fold is inspected again after the retreat"


def test_an_unknown_event_is_an_error_that_names_the_known_ones() -> None:
    with pytest.raises(InternalError, match="'approve' in state 'idle'") as e:
        Executive().handle(Event.APPROVE)
    assert "start" in e.value.hint


def test_an_abort_of_a_pause_is_an_abort_of_the_interrupted_state() -> None:
    """Between two effects the hands may carry cloth."""
    for events, target in (
        ([Event.START], State.GIVING_UP),
        ([Event.START, *[Event.DONE] * 11], State.LAYING_BACK),
    ):
        machine = Executive()
        for event in [*events, Event.PAUSE]:
            machine.handle(event)
        step = machine.handle(Event.ABORT)
        assert (step.source, step.target) == (State.PAUSED, target)
        assert machine.state is target


def test_resume_enters_the_interrupted_state_again() -> None:
    machine = Executive()
    entered = machine.handle(Event.START)
    machine.handle(Event.PAUSE)
    assert machine.state is State.PAUSED
    resumed = machine.handle(Event.RESUME)
    assert (resumed.target, resumed.effect) == (entered.target, entered.effect)
    assert machine.state is entered.target


def test_an_interrupted_run_resumes_only_in_states_that_lead_to_a_new_picture() -> None:
    """A resumed run never enters a state with hands on the cloth. It begins no later than with the picture that
    locates the garment."""
    to = {r.event: (r.target, r.effect) for r in ROWS if r.state is State.RESUMING}
    assert set(REENTRIES.values()) == to.keys() - {
        Event.STOP, Event.CRASH, Event.ABORT, Event.PAUSE, Event.UNRECORDED, Event.FAILED
    }  # fmt: skip
    for event in REENTRIES.values():
        target, effect = to[event]
        assert target not in HANDS_ON_CLOTH
        assert effect in {Effect.PHOTOGRAPH_TABLE, Effect.AWAIT_GARMENT, Effect.LOOK}
    assert {r.state for r in ROWS if r.target is State.RESUMING} == {State.IDLE}


def test_every_state_of_a_run_without_failures_and_every_plan_has_a_reentry() -> None:
    interruptions = {
        Event.FAILED, Event.STOP, Event.CRASH, Event.ABORT, Event.PAUSE, Event.UNRECORDED, Event.GIVE_UP,
        Event.REENTER,
    }  # fmt: skip
    undisturbed = reachable(State.IDLE, interruptions) & set(WORKING)
    assert set(REENTRIES) == undisturbed | {State.PLANNING_REPAIR, State.PLANNING_SPREAD}


@settings(max_examples=200)
@given(st.lists(st.sampled_from(list(Event)), max_size=40))
def test_any_sequence_of_allowed_events_follows_the_table(events: list[Event]) -> None:
    machine = Executive()
    for e in [Event.START, *events]:
        if e in machine.allowed():
            before = machine.state
            step = machine.handle(e)
            assert step.source is before
            assert machine.state is step.target
        else:
            with pytest.raises(InternalError):
                machine.handle(e)
