"""Invariants of the transition table and the recovery table."""

from __future__ import annotations

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cell.executive.machine import Executive, complete_table
from cell.states.recovery_table import RECOVERIES, choose_recovery
from cell.states.transition_table import HANDS_ON_CLOTH, REENTRIES, TERMINAL, Effect, Event, State
from robots.errors import FailureKind, InternalError

ROWS = complete_table()
WORKING = [s for s in State if s not in TERMINAL and s is not State.IDLE]


def successors(state: State) -> set[State]:
    return {r.target for r in ROWS if r.state is state}


def reachable(start: State) -> set[State]:
    seen, todo = {start}, [start]
    while todo:
        for s in successors(todo.pop()) - seen:
            seen.add(s)
            todo.append(s)
    return seen


def test_every_state_is_reached_and_can_end() -> None:
    assert reachable(State.IDLE) == set(State)
    for s in WORKING:
        assert reachable(s) & TERMINAL, s


def test_terminal_states_have_no_transitions() -> None:
    assert not [r for r in ROWS if r.state in TERMINAL]


def test_each_state_and_event_has_one_row() -> None:
    assert len({(r.state, r.event) for r in ROWS}) == len(ROWS)


@pytest.mark.parametrize("state", WORKING)
def test_every_state_accepts_stop_and_crash(state: State) -> None:
    """What already makes the cell safe is not begun again, put off or given up."""
    to = {r.event: (r.target, r.effect) for r in ROWS if r.state is state}
    safe = state in {State.GIVING_UP, State.MAKING_SAFE}
    assert to[Event.STOP] == (State.STOPPED, Effect.HOLD)
    assert to[Event.UNRECORDED] == (State.FAULT, Effect.HOLD)
    assert to[Event.CRASH] == ((State.FAULT, Effect.HOLD) if safe else (State.MAKING_SAFE, Effect.MAKE_SAFE))
    assert to.get(Event.ABORT) == (None if safe else (State.GIVING_UP, Effect.MAKE_SAFE))
    waits = safe or state is State.PAUSED
    assert to.get(Event.PAUSE) == (None if waits else (State.PAUSED, Effect.WAIT))


def test_the_effect_of_a_state_does_not_depend_on_the_way_into_it() -> None:
    done = {s: {r.effect for r in ROWS if r.target is s} for s in State if s is not State.IDLE}
    several = {
        State.INSPECTING: {Effect.INSPECT, Effect.NEXT_STEP},
        State.FAULT: {Effect.NOTHING, Effect.HOLD},
        State.AWAITING_APPROVAL: {Effect.ASK_APPROVAL},
        State.AWAITING_PRESSING: {Effect.ASK_APPROVAL},
    }
    for state, effects in done.items():
        assert effects == several.get(state, effects) and (len(effects) == 1 or state in several), state
    assert {s for s, effects in done.items() if Effect.NOTHING in effects} <= TERMINAL, "a state that does nothing"


@pytest.mark.parametrize("state", WORKING)
def test_every_working_state_has_a_failure_transition(state: State) -> None:
    """Also where the cell only waits: the arms can be pushed there, and the driver can fall silent. It ends as a
    fault only where the cell could not be made safe."""
    (failed,) = (r for r in ROWS if r.state is state and r.event is Event.FAILED)
    safe = state in {State.GIVING_UP, State.MAKING_SAFE}
    assert (failed.target is State.FAULT) is safe
    assert safe or failed.target in {State.CLEARING, State.RECOVERING, State.MAKING_SAFE}


def test_hands_on_the_cloth_are_cleared_first() -> None:
    at_work = {
        Effect.APPROACH, Effect.GRASP, Effect.LIFT, Effect.FOLD, Effect.RELEASE, Effect.RETREAT, Effect.PRESS
    }  # fmt: skip
    assert {r.target for r in ROWS if r.effect in at_work} == HANDS_ON_CLOTH
    for s in HANDS_ON_CLOTH:
        target = next(r.target for r in ROWS if r.state is s and r.event is Event.FAILED)
        assert target is State.CLEARING


def test_every_way_into_motion_passes_motion_planning() -> None:
    """Approaching moves the arms on a plan: only a fresh plan (or its approval) may lead there."""
    sources = {r.state for r in ROWS if r.target is State.APPROACHING}
    assert sources == {State.PLANNING_MOTION, State.AWAITING_APPROVAL}


def test_a_run_without_failures_visits_the_nominal_states() -> None:
    machine = Executive()
    events = [Event.START] + [Event.DONE] * 15 + [Event.NEXT_FOLD] + [Event.DONE] * 9 + [Event.ALL_FOLDED]
    for e in events:
        machine.handle(e)
    assert machine.state is State.FOLDED
    assert machine.ended


def test_a_fold_is_pressed_only_right_after_it_was_inspected() -> None:
    """The hands' path was planned at that time, and the approval is for that plan."""
    ways_in = {(r.state, r.event) for r in ROWS if r.target is State.PRESSING and r.event is not Event.RESUME}
    assert ways_in == {(State.INSPECTING, Event.PRESS), (State.AWAITING_PRESSING, Event.APPROVE)}
    assert {r.state for r in ROWS if r.target is State.AWAITING_PRESSING} == {State.INSPECTING}
    done = next(r for r in ROWS if (r.state, r.event) == (State.PRESSING, Event.DONE))
    assert done.target is State.RETREATING, "and it is looked at again"


def test_an_unknown_event_is_an_error_that_names_the_known_ones() -> None:
    with pytest.raises(InternalError, match="'approve' in state 'idle'") as e:
        Executive().handle(Event.APPROVE)
    assert "start" in e.value.hint


def test_resume_enters_the_interrupted_state_again() -> None:
    machine = Executive()
    entered = machine.handle(Event.START)
    machine.handle(Event.PAUSE)
    assert machine.state is State.PAUSED
    resumed = machine.handle(Event.RESUME)
    assert (resumed.target, resumed.effect) == (entered.target, entered.effect)
    assert machine.state is entered.target, "and it is there"


def test_an_interrupted_run_is_resumed_only_in_states_that_look_first() -> None:
    """Never with hands on the cloth, and no later than the picture that locates the garment."""
    to = {r.event: (r.target, r.effect) for r in ROWS if r.state is State.RESUMING}
    assert set(REENTRIES.values()) == to.keys() - {
        Event.STOP, Event.CRASH, Event.ABORT, Event.PAUSE, Event.UNRECORDED, Event.FAILED
    }  # fmt: skip
    for event in REENTRIES.values():
        target, effect = to[event]
        assert target not in HANDS_ON_CLOTH
        assert effect in {Effect.PHOTOGRAPH_TABLE, Effect.AWAIT_GARMENT, Effect.LOOK}
    assert {r.state for r in ROWS if r.target is State.RESUMING} == {State.IDLE}


def test_every_state_that_locates_the_garment_has_a_reentry() -> None:
    tells_nothing = {
        State.RESUMING, State.CLEARING, State.RECOVERING, State.ASKING, State.PAUSED, State.GIVING_UP,
        State.MAKING_SAFE,
    }  # fmt: skip
    assert set(REENTRIES) == set(WORKING) - tells_nothing


@settings(max_examples=200)
@given(st.lists(st.sampled_from(list(Event)), max_size=40))
def test_any_sequence_of_allowed_events_reaches_states_of_the_table_only(events: list[Event]) -> None:
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


@pytest.mark.parametrize("kind", list(FailureKind))
@pytest.mark.parametrize("attended", [True, False])
def test_recoveries_are_bounded_and_known_to_the_machine(kind: FailureKind, attended: bool) -> None:
    known = {r.event for r in ROWS if r.state is State.RECOVERING}
    tried = [choose_recovery(kind, n, attended).event for n in range(1, 10)]
    assert set(tried) <= known
    accepted = Event.CARRY_ON in tried  # which leads past the fold
    assert tried[-1] is (Event.CARRY_ON if accepted else Event.ASK if attended else Event.GIVE_UP)
    assert not accepted or set(tried) == {Event.CARRY_ON}


def test_a_stop_is_never_recovered_by_itself() -> None:
    for kind in (FailureKind.STOPPED, FailureKind.HARDWARE_FAULT, FailureKind.ABORTED):
        assert kind not in RECOVERIES


@pytest.mark.parametrize("kind", [FailureKind.TRACKING_ERROR, FailureKind.STALE_STATE])
def test_strayed_arms_are_moved_again_once_after_half_a_second(kind: FailureKind) -> None:
    """As stated in docs/safety.md."""
    first, second = (choose_recovery(kind, n, attended=False) for n in (1, 2))
    assert first.event is Event.GRASP_AGAIN and first.dwell_s == 0.5
    assert second.event is Event.GIVE_UP


@pytest.mark.parametrize(
    "kind", [FailureKind.SLIPPED, FailureKind.NO_CONTACT, FailureKind.MISSED_GRASP, FailureKind.IN_COLLISION]
)
def test_a_failed_grasp_is_retried_two_or_three_times_with_different_adjustments(kind: FailureKind) -> None:
    tried = [choose_recovery(kind, n, attended=False) for n in range(1, 6)]
    made = [(r.event, r.adjust) for r in tried if r.event is not Event.GIVE_UP]
    assert 2 <= len(made) <= 3 and len(set(made)) == len(made)
    assert all(r.event is Event.GIVE_UP for r in tried[len(made) :])


@pytest.mark.parametrize(("overlap", "good_enough"), [(0.84, False), (0.86, True)])
def test_a_fold_that_is_too_far_from_its_prediction_is_never_good_enough(
    overlap: float, good_enough: bool
) -> None:
    for attempt in (1, 2, 3):
        chosen = choose_recovery(FailureKind.OFF_TARGET, attempt, attended=True, overlap=overlap)
        assert chosen.event is (Event.CARRY_ON if good_enough else Event.ASK)
        last = choose_recovery(FailureKind.OFF_TARGET, attempt, attended=True, last_fold=True, overlap=overlap)
        assert last.event is Event.ASK
