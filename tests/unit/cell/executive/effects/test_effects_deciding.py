"""The choice of a recovery after a failure, and questions to the operator: limits, dwell, and uncharged time."""

from __future__ import annotations

from dataclasses import replace
from itertools import product
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from foldcell.cell.config.cell_settings import CellSettings, load_settings
from foldcell.cell.config.garments.garment_file import load_garment
from foldcell.cell.control.set_points import LastCommand
from foldcell.cell.executive.effects import EFFECTS
from foldcell.cell.executive.effects.recovery.deciding import ask_approval, ask_operator, pause
from foldcell.cell.record.words import recovery_in_words
from foldcell.cell.states.recovery_table import RECOVERIES, Adjustment
from foldcell.cell.states.run_context import RunContext
from foldcell.cell.states.stages import Repair
from foldcell.cell.states.transition_table import TRANSITIONS, Effect, Event, State
from foldcell.robots.errors import Failure, FailureKind
from foldcell.robots.ports import Side
from foldcell.skills.fold_plan.repair import RepairGoal
from foldcell.skills.state_estimate.estimate import StateEstimate
from foldcell.skills.state_estimate.hypothesis import FoldState
from foldcell.skills.vocabulary import Grasp
from tests.builders.contexts import context_with
from tests.fakes import FakeCell
from tests.workcells import fake_workcell

K = FailureKind
choose_next = EFFECTS[Effect.CHOOSE_RECOVERY]


SEEN = context_with(reference=FakeCell().ports().camera.capture())
"""A context in which the empty table was photographed."""


def failed(kind: FailureKind, times: int = 1, context: RunContext | None = None) -> RunContext:
    context = context or RunContext()
    for _ in range(times):
        context = context.with_failure(Failure(kind, "it failed"))
    return context


def bounded(tmp_path: Path, **bounds: float) -> CellSettings:
    path = tmp_path / "cell.yaml"
    path.write_text("recovery:\n" + "".join(f"  {k}: {v}\n" for k, v in bounds.items()))
    return load_settings(path)


# recoveries


def test_a_pause_before_a_recovery_resumes_from_the_last_set_point() -> None:
    """The arms' reading always differs a little from the last set-point, so a set-point at the reading would be a
    jump."""
    cell = FakeCell()
    workcell = fake_workcell(cell, last_command=LastCommand(np.full(14, 0.008)))
    choose_next(workcell, failed(K.CAMERA_FAULT, context=SEEN))
    assert cell.commands[0][1] == pytest.approx(0.008) and workcell.last_command.q == pytest.approx(
        cell.commands[-1][1]
    )


def test_a_cell_that_sees_nothing_says_for_how_long_it_will_look_again(tmp_path: Path) -> None:
    told: list[str] = []
    for times in (1, 2, 3):
        cell = FakeCell()
        workcell = fake_workcell(
            cell, settings=bounded(tmp_path, patience=5.0, attempts_per_run=0), tell=told.append
        )
        before = cell.ports().clock.now()
        result = choose_next(workcell, failed(K.CAMERA_FAULT, times, SEEN))
        waited = cell.ports().clock.now() - before
        assert result.event is Event.LOOK_AGAIN and waited == pytest.approx([1.0, 2.0, 2.0][times - 1], abs=0.03)
        assert result.context.retries == (), "to look again is no try"
    assert choose_next(workcell, failed(K.CAMERA_FAULT, 4, SEEN)).event is Event.GIVE_UP
    assert ["4 s more" in told[0], "2 s more" in told[1], "last time" in told[2]] == [True] * 3


@pytest.mark.parametrize(
    ("kind", "events"),
    [(K.DRIFT, [Event.CARRY_ON] * 2), (K.OFF_TARGET, [Event.LOOK_AFTER, Event.GIVE_UP])],
)
def test_a_displaced_last_fold_is_accepted_and_a_misshapen_one_only_looked_at_again(
    kind: FailureKind, events: list[Event]
) -> None:
    plan: Any = (SimpleNamespace(name="half"),)
    context = context_with(SEEN, steps=plan, garment=load_garment("t_shirt"), carried=True)
    for looks, event in enumerate(events, 1):
        assert choose_next(fake_workcell(FakeCell()), failed(kind, looks, context)).event is event


@pytest.mark.parametrize(("first", "second"), [(K.SAG, K.DROPPED_CORNER), (K.PILING, K.OFF_TARGET)])
def test_two_looks_that_refuse_a_fold_for_different_reasons_are_two_verdicts(
    first: FailureKind, second: FailureKind
) -> None:
    poor = {"iou_aligned": 0.7}
    context = context_with(SEEN, carried=True).with_failure(Failure(first, "it failed", "", poor))
    again = choose_next(fake_workcell(FakeCell()), context)
    assert again.event is Event.LOOK_AFTER
    last = choose_next(
        fake_workcell(FakeCell()), again.context.with_failure(Failure(second, "it failed", "", poor))
    )
    assert last.event is Event.GIVE_UP and "what is off now" in last.context.asking


@pytest.mark.parametrize(
    ("values", "event"),
    [
        ({"iou_aligned": 0.9, "edge_deviation_m": -0.024}, Event.CARRY_ON),
        ({"iou_aligned": 0.9, "edge_deviation_m": -0.079}, Event.LOOK_AFTER),
        ({"iou_aligned": 0.9, "edge_deviation_m": 0.024, "left_behind_m": 0.045}, Event.LOOK_AFTER),
    ],
)
def test_the_next_fold_builds_only_on_edges_that_lie_near_their_place(
    values: dict[str, float], event: Event
) -> None:
    context = context_with(SEEN, carried=True).with_failure(Failure(K.OFF_TARGET, "it failed", "", values))
    assert choose_next(fake_workcell(FakeCell()), context).event is event


@pytest.mark.parametrize(
    ("second", "anew", "event"),
    [
        (K.PILING, True, Event.GIVE_UP),
        (K.TOO_HIGH, True, Event.GIVE_UP),
        (K.DROPPED_CORNER, True, Event.REPAIR),
        (K.PILING, False, Event.REPAIR),
    ],
)
def test_a_fold_that_was_made_anew_and_failed_alike_is_not_made_a_third_time(
    second: FailureKind, anew: bool, event: Event
) -> None:
    """Heaped-up cloth and too much height are alike. If the repair failed, the same fold is refused again."""
    found: Any = SimpleNamespace(
        state=FoldState.AFTER, likeliest_shape=object(), best=object(), confidence=0.99,
        probabilities=dict.fromkeys(FoldState, 0.0) | {FoldState.AFTER: 0.99},
    )  # fmt: skip
    cell = fake_workcell(FakeCell())
    first: Any = object()
    last: Any = (SimpleNamespace(name="half"),)
    context = context_with(SEEN, steps=last, garment=ONE_WAY, carried=True, motion=first, estimate=found)
    looked = choose_next(cell, failed(K.PILING, context=context))
    assert looked.event is Event.LOOK_AFTER
    repaired = choose_next(cell, failed(K.PILING, context=looked.context))
    assert repaired.event is Event.REPAIR
    again: Any = object() if anew else first
    made = context_with(repaired.context, carried=True, motion=again, estimate=found)
    assert choose_next(cell, failed(second, context=made)).event is event


ONE_WAY: Any = SimpleNamespace(plan=[SimpleNamespace(variants=(None,))] * 9)
"""A garment with one variant of each fold."""


def planned(**changes: Any) -> RunContext:
    """A context in which all stages before the approach are done."""
    known: dict[str, Any] = {
        "garment": ONE_WAY, "perception": None, "trajectory": SimpleNamespace(source="library")
    }  # fmt: skip
    return context_with(SEEN, **{**known, **changes})


def test_the_recoveries_of_a_failure_are_used_in_order_until_a_person_is_asked() -> None:
    context, tried = planned(), []
    while not context.asking:
        result = choose_next(fake_workcell(FakeCell()), failed(K.MISSED_GRASP, context=context))
        context, tried = result.context, [*tried, (result.event, result.record["change"])]
    assert tried == [
        (Event.GRASP_AGAIN, "lower"),
        (Event.GRASP_AGAIN, "inward"),
        (Event.LOOK_AGAIN, "none"),
        (Event.GIVE_UP, "none"),
    ]
    assert context.fold.adjustments == (Adjustment.LOWER, Adjustment.INWARD)
    assert context.asking == result.record["reason"] == RECOVERIES[K.MISSED_GRASP][-1].reason


@pytest.mark.parametrize(
    ("layers", "repaired", "decided"),
    [
        (2, None, "0.35` in cell.yaml;"),
        (1, None, "or a lower `table.height: -0.1`"),
        (2, 0.0013, "or a lower `table.height: -0.1`"),
    ],
)
def test_a_question_about_a_grasp_names_the_settings_that_would_change_it(
    layers: int, repaired: float | None, decided: str
) -> None:
    """Hands that take two layers of two take the whole stack, so the touch alone decides how low they close.
    repaired: thickness of a layer with which a repair was planned [m]; 4 mm are then three layers."""
    step = SimpleNamespace(name="half", grasps={"left": Grasp(np.zeros(2), 0.0, layers, 0.004)})
    context = context_with(SEEN, steps=(step,), tool_speed=0.3, recoveries=((0, "slipped -> grasp_again"),) * 6)
    if repaired:
        plan, nothing = SimpleNamespace(thickness=repaired), SimpleNamespace(ended=lambda _: None)
        context = context_with(context, repair=Repair(plan, nothing, nothing, nothing, nothing, nothing))
    missed = Failure(K.MISSED_GRASP, "the left pads feel no cloth", "grasp lower or further in", {"force_n": 0.0})
    result = choose_next(fake_workcell(FakeCell()), context.with_failure(missed))
    failure = result.context.failure
    assert result.event in {Event.ASK, Event.GIVE_UP} and failure is not None
    assert failure.what == missed.what and failure.hint.startswith(missed.hint) and decided in failure.hint


def test_a_hand_that_stood_low_enough_grasps_further_inward_then_upright() -> None:
    """Going deeper would not help. The journal says what the grasp has shown and what changes."""
    context, tried = planned(), []
    values = {"side": "left", "too_high_m": -0.0004, "layers": 2, "layers_expected": 4}
    missed = Failure(K.MISSED_GRASP, "the left hand holds 2 layers, not 4", "", values)
    for _ in range(3):
        result = choose_next(fake_workcell(FakeCell()), context.with_failure(missed))
        context, tried = result.context, [*tried, result.record["change"]]
        said = str(result.record.get("because", ""))
        assert ("stood low enough" in said) is (result.event is Event.GRASP_AGAIN)
        assert not said or said in recovery_in_words(result.event, result.record)
    assert tried == ["inward", "upright", "none"]


def lying(
    state: FoldState, confidence: float = 0.9, second: FoldState = FoldState.BEFORE, off: float = 0.0
) -> StateEstimate:
    """An estimate of the garment's state, with a shape that fits unless it is a heap. second: the next probable
    state. off: distance of the cloth from its predicted place [m]."""
    shape = SimpleNamespace(vertices=np.array([[off, 0.0, 0.0]]))
    fit: Any = SimpleNamespace(hypothesis=SimpleNamespace(interruption=None, shape=shape))
    best = None if state is FoldState.HEAP else fit
    probabilities = dict.fromkeys(FoldState, 0.0) | {second: 1.0 - confidence} | {state: confidence}
    return StateEstimate(state, confidence, best, probabilities, (fit,), 0, np.zeros((3, 2)))


@pytest.mark.parametrize(
    ("estimate", "events"),
    [
        (None, [Event.CARRY_ON]),
        (lying(FoldState.HALF_WAY, 0.91, off=0.058), [Event.LOOK_AFTER, Event.REPAIR]),
        (lying(FoldState.HALF_WAY, 0.91, off=0.025), [Event.CARRY_ON]),
        (lying(FoldState.HALF_WAY, 0.7, off=0.058), [Event.CARRY_ON]),
    ],
)
def test_a_sleeve_that_was_dropped_far_off_is_not_folded_under_although_the_outline_is_good(
    estimate: StateEstimate | None, events: list[Event]
) -> None:
    context = planned(carried=True, estimate=estimate)
    piled = Failure(K.PILING, "it failed", "", {"iou_aligned": 0.99, "edge_deviation_m": 0.007})
    for event in events:
        result = choose_next(fake_workcell(FakeCell()), context.with_failure(piled))
        context = result.context
        assert result.event is event


@pytest.mark.parametrize(
    ("kind", "change"),
    [
        (K.HALF_FOLDED, Adjustment.NONE),
        (K.DROPPED_CORNER, Adjustment.STRONGER),
        (K.MISSED_LAYER, Adjustment.LOWER),
        (K.SAG, Adjustment.OPTIMISE),
        (K.PILING, Adjustment.OPTIMISE),
        (K.TOO_HIGH, Adjustment.OPTIMISE),
        (K.OFF_TARGET, Adjustment.NONE),
    ],
)
def test_a_fold_that_fails_again_in_the_same_way_is_repaired_two_or_three_times_at_most(
    kind: FailureKind, change: Adjustment
) -> None:
    verdict = kind is not K.HALF_FOLDED
    context = planned(carried=verdict, touched=True, estimate=lying(FoldState.HALF_WAY))
    poor = {"iou_aligned": 0.5}
    events = []
    repairs = 2 if verdict else 3
    for _ in range(repairs + 2):
        result = choose_next(fake_workcell(FakeCell()), context.with_failure(Failure(kind, "it failed", "", poor)))
        context = result.context
        events.append(result.event)
    look = Event.LOOK_AFTER if verdict else Event.LOOK_AGAIN
    assert events == [look, *[Event.REPAIR] * repairs, Event.GIVE_UP]
    assert set(context.fold.adjustments) <= {change} and context.asking


@pytest.mark.parametrize("estimate", [None, lying(FoldState.HEAP), lying(FoldState.HALF_WAY, 0.6)])
def test_a_fold_of_which_the_state_is_not_known_is_not_repaired(estimate: StateEstimate | None) -> None:
    context = failed(K.DROPPED_CORNER, 2, planned(carried=True, estimate=estimate))
    poor = Failure(K.DROPPED_CORNER, "it failed", "", {"iou_aligned": 0.5})
    assert choose_next(fake_workcell(FakeCell()), replace(context, failure=poor)).event is Event.GIVE_UP


@pytest.mark.parametrize(("overlap", "event"), [(0.93, Event.REPAIR), (0.80, Event.GIVE_UP)])
@pytest.mark.parametrize("estimate", [lying(FoldState.HEAP, 0.5), lying(FoldState.HALF_WAY, 0.6)])
def test_a_piled_up_fold_in_good_outline_is_no_heap(estimate: StateEstimate, overlap: float, event: Event) -> None:
    context = failed(K.PILING, 2, planned(carried=True, estimate=estimate))
    piled = Failure(K.PILING, "it failed", "", {"iou_aligned": overlap, "edge_deviation_m": 0.043})
    assert choose_next(fake_workcell(FakeCell()), replace(context, failure=piled)).event is event


@pytest.mark.parametrize("ends", [(FoldState.AFTER, FoldState.HALF_WAY), (FoldState.HALF_WAY, FoldState.AFTER)])
def test_a_refused_fold_is_repaired_whether_it_is_half_made_or_made_amiss(
    ends: tuple[FoldState, FoldState],
) -> None:
    """Its edge has moved, and the best fit shows where it lies."""
    context = failed(K.OFF_TARGET, 2, planned(carried=True, estimate=lying(ends[0], 0.6, ends[1])))
    poor = Failure(K.OFF_TARGET, "it failed", "", {"iou_aligned": 0.5})
    assert choose_next(fake_workcell(FakeCell()), replace(context, failure=poor)).event is Event.REPAIR


def test_a_refused_fold_of_which_nothing_has_moved_is_made_anew_without_a_repair() -> None:
    """The next look finds the garment as before the fold, because the hands did not take it along."""
    context = planned(carried=True, touched=True, estimate=lying(FoldState.BEFORE))
    poor = Failure(K.MISSED_LAYER, "it failed", "", {"iou_aligned": 0.5})
    context = failed(K.MISSED_LAYER, 2, context)
    result = choose_next(fake_workcell(FakeCell()), replace(context, failure=poor))
    assert result.event is Event.LOOK_AGAIN and result.context.fold.uncertain


def test_a_hand_that_held_too_many_layers_grasps_higher_and_one_with_too_few_does_not() -> None:
    for layers, change in ((2, Adjustment.HIGHER), (0, Adjustment.NONE)):
        context = failed(K.MISSED_LAYER, 1, planned(garment=load_garment("pants"), touched=True))
        held = Failure(
            K.MISSED_LAYER, "it held more", "", {"layers": layers, "layers_expected": 1, "iou_aligned": 0.0}
        )
        result = choose_next(fake_workcell(FakeCell()), replace(context, failure=held))
        assert result.record["change"] == change.value and result.event is Event.LOOK_AGAIN
        assert result.context.fold.count(Adjustment.HIGHER) == (change is Adjustment.HIGHER)


@pytest.mark.parametrize("kind", list(RECOVERIES))
def test_a_repair_that_fails_is_tried_again_or_ends_with_a_look(kind: FailureKind) -> None:
    """Nothing is planned for the fold while the garment lies half folded, and no grasp of the repair is changed
    without a look."""
    repair: Any = SimpleNamespace(failed=None)
    for times in (1, 2, 3):
        context = failed(kind, times, planned(garment=load_garment("pants"), repair=repair, touched=True))
        result = choose_next(fake_workcell(FakeCell()), context)
        assert result.event in {Event.LOOK_AGAIN, Event.GRASP_AGAIN, Event.GIVE_UP, Event.CARRY_ON}
        if result.event is Event.GRASP_AGAIN:
            assert result.record["change"] in {Adjustment.NONE, Adjustment.OTHER_SEARCH}
        if result.event is Event.CARRY_ON:
            assert kind not in {K.HALF_FOLDED, K.DROPPED_CORNER}


ENTRY = {row.event: row.target for row in TRANSITIONS if row.state is State.RECOVERING}
NEEDS = {
    State.PLANNING: ("recognition",),
    State.OPTIMISING: ("plan",),
    State.PLANNING_MOTION: ("plan", "trajectory"),
    State.PLANNING_REPAIR: ("plan", "trajectory"),
    State.PLANNING_SPREAD: ("plan", "first_look"),
}
"""What the effect of a state takes from the context."""
STAGES = {
    State.PHOTOGRAPHING: RunContext(),
    State.AWAITING_GARMENT: SEEN,
    State.LOOKING: SEEN,
    State.RECOGNISING: SEEN,
    State.PLANNING: context_with(SEEN, perception=None),
    State.OPTIMISING: context_with(SEEN, perception=None, garment=load_garment("medium_towel")),
}
"""The knowledge in the states before a trajectory was chosen. All later states know everything."""
FAILING = [
    row.state
    for row in TRANSITIONS
    if row.event is Event.FAILED and row.target in {State.RECOVERING, State.CLEARING}
]


@pytest.mark.usefixtures("waits_pass_at_once")
@pytest.mark.parametrize("state", FAILING)
def test_every_failure_in_every_state_leads_to_a_state_that_has_what_it_needs(state: State) -> None:
    carried = state in {State.RETREATING, State.LOOKING_AFTER, State.INSPECTING, State.PRESSING}
    context = STAGES.get(state) or planned(carried=carried)
    for kind, attended in product(FailureKind, (True, False)):
        going, events = context, []
        while not events or events[-1] not in {Event.ASK, Event.GIVE_UP, Event.CARRY_ON}:
            result = choose_next(fake_workcell(FakeCell(), attended=attended), failed(kind, context=going))
            going, events = result.context, [*events, result.event]
            known = {
                "recognition": going.recognition is not None, "plan": going.plan is not None,
                "trajectory": going.fold.trajectory is not None, "first_look": going.first_look is not None,
            }  # fmt: skip
            assert all(known[need] for need in NEEDS.get(ENTRY[result.event], ())), (kind, events)
            assert len(events) < 10, (kind, events)
        assert events[-1] is Event.CARRY_ON or len(going.asking.split()) >= 4, (kind, events)


@pytest.mark.parametrize("kind", [K.UNREACHABLE, K.IN_COLLISION])
@pytest.mark.parametrize(("garment", "index", "ways"), [("pants", 0, 2), ("pants", 1, 1), ("t_shirt", 0, 2)])
def test_a_fold_is_retried_in_the_other_variant_of_the_plan(
    kind: FailureKind, garment: str, index: int, ways: int
) -> None:
    context = planned(garment=load_garment(garment), index=index, avoided=({},))
    events = []
    while True:
        result = choose_next(fake_workcell(FakeCell()), failed(kind, context=context))
        context, events = result.context, [*events, result.event]
        if result.event is Event.GIVE_UP:
            break
        assert (context.fold.avoided == ()) == (Event.PLAN_AGAIN in events), (
            "another variant has other postures, so none is avoided"
        )
    again = [Event.PLAN_AGAIN, Event.GRASP_AGAIN, Event.GRASP_AGAIN] if ways == 2 else []
    assert events == [Event.GRASP_AGAIN] * 2 + again + [Event.GIVE_UP]


def test_the_variant_is_not_changed_while_the_hands_hold_cloth() -> None:
    """The hands release the garment somewhere, so it is located first and the plan is made from the new
    picture."""
    held: Any = {Side.LEFT: None}
    context = planned(garment=load_garment("pants"), held=held)
    result = choose_next(fake_workcell(FakeCell()), failed(K.UNREACHABLE, 3, context))
    assert result.event is Event.LOOK_AGAIN and result.context.fold.count(Adjustment.OTHER_VARIANT) == 1


def test_each_step_has_a_limit_on_retries(tmp_path: Path) -> None:
    """Failures of different kinds must not add up to endless retries."""
    workcell = fake_workcell(FakeCell(), settings=bounded(tmp_path, attempts_per_step=3))
    context, events = RunContext(), []
    for kind in (K.NO_CONTACT, K.SLIPPED, K.TRACKING_ERROR, K.OFF_TARGET, K.DRIFT):
        result = choose_next(workcell, failed(kind, context=context))
        context = result.context
        events.append(result.event)
    assert events[3:] == [Event.GIVE_UP, Event.GIVE_UP]
    assert Event.GIVE_UP not in events[:3]


def test_a_run_has_a_limit_on_retries_over_all_steps(tmp_path: Path) -> None:
    workcell = fake_workcell(FakeCell(), settings=bounded(tmp_path, attempts_per_step=2, attempts_per_run=3))
    context, events = RunContext(), []
    for index in (0, 0, 1, 2):
        result = choose_next(workcell, failed(K.MISSED_GRASP, context=context_with(context, index=index)))
        context = result.context
        events.append(result.event)
    assert Event.GIVE_UP not in events[:3] and events[3] is Event.GIVE_UP


def test_folds_that_are_carried_on_from_use_up_no_attempts(tmp_path: Path) -> None:
    """They repeat nothing. A garment of many folds drifts a little in each, and must still be grasped again."""
    workcell = fake_workcell(FakeCell(), settings=bounded(tmp_path, attempts_per_step=2, attempts_per_run=2))
    context = context_with(SEEN, carried=True)
    for index in range(5):
        result = choose_next(workcell, failed(K.DRIFT, context=context_with(context, index=index)))
        assert result.event is Event.CARRY_ON
        context = result.context
    missed = choose_next(workcell, failed(K.MISSED_GRASP, context=context_with(context, index=4, carried=False)))
    assert missed.event is not Event.GIVE_UP and len(missed.context.recoveries) == 6


@pytest.mark.parametrize("kind", [K.STOPPED, K.HARDWARE_FAULT, K.ABORTED, K.UNRECORDED])
@pytest.mark.parametrize(("attended", "event"), [(True, Event.ASK), (False, Event.GIVE_UP)])
def test_a_failure_without_a_recovery_row_is_not_retried(kind: FailureKind, attended: bool, event: Event) -> None:
    result = choose_next(fake_workcell(FakeCell(), attended=attended), failed(kind))
    assert result.event is event
    assert result.context.recoveries == (), "asking and giving up do not count as recoveries"


def test_the_dwell_is_waited_with_the_arms_held(tmp_path: Path) -> None:
    cell = FakeCell()
    choose_next(fake_workcell(cell), failed(K.NO_GARMENT))
    assert cell.now == pytest.approx(1.0)
    gaps = [b - a for (a, _), (b, _) in zip(cell.commands, cell.commands[1:], strict=False)]
    assert gaps and max(gaps) < 0.2, "no command to the arms times out"
    cell = FakeCell()
    choose_next(fake_workcell(cell, settings=bounded(tmp_path, dwell=2.0)), failed(K.OFF_TARGET))
    assert cell.now == pytest.approx(2.0)


def test_a_stop_ends_the_dwell() -> None:
    cell = FakeCell()
    workcell = fake_workcell(cell)
    cell.at(0.3, lambda: workcell.ports.stop.trigger("button"))
    result = choose_next(workcell, failed(K.NO_GARMENT))
    assert result.event is Event.FAILED and result.context.failure.kind is K.STOPPED
    assert cell.now < 0.4


# the operator


@pytest.mark.parametrize(
    ("ask", "known"),
    [
        (ask_approval, {Event.APPROVE, Event.RETRY, Event.SKIP, Event.ABORT}),
        (ask_operator, {Event.RETRY, Event.SKIP, Event.ABORT}),
        (pause, {Event.RESUME, Event.ABORT}),
    ],
)
def test_an_answer_ends_the_wait(ask, known: set[Event]) -> None:
    for answer in known:
        cell = FakeCell()
        cell.now = 20.0
        workcell = fake_workcell(cell)
        cell.at(20.3, lambda queue=workcell.commands, answer=answer: queue.put(answer))
        result = ask(workcell, replace(SEEN, waited_s=2.0))
        assert result.event is answer
        assert result.record == {"command": answer.value}
        assert result.context.waited_s == pytest.approx(2.0 + cell.now - 20.0) and cell.now >= 20.3
        assert cell.commands == [], "the arms get no command during a question"
        failure = result.context.failure
        assert (failure.kind if failure else None) is (K.ABORTED if answer is Event.ABORT else None)


def test_a_retry_photographs_the_table_if_it_was_not_seen() -> None:
    """The garment is laid after this picture, so looking for it before would fail."""
    assert choose_next(fake_workcell(FakeCell()), failed(K.CAMERA_FAULT)).event is Event.START_OVER
    cell = FakeCell()
    workcell = fake_workcell(cell)
    cell.at(0.3, lambda: workcell.commands.put(Event.RETRY))
    said = ask_operator(workcell, RunContext())
    assert said.event is Event.START_OVER and said.record == {"command": "retry"}


def test_a_retry_looks_for_the_garment_if_no_reference_picture_is_taken(tmp_path: Path) -> None:
    (tmp_path / "cell.yaml").write_text("camera: {reference: none}\n")
    workcell = fake_workcell(FakeCell(), settings=load_settings(tmp_path / "cell.yaml"))
    assert choose_next(workcell, failed(K.CAMERA_FAULT)).event is Event.LOOK_AGAIN


@pytest.mark.parametrize("kind", [K.CAMERA_FAULT, K.NO_GARMENT, K.STUCK_ON_FINGER])
def test_an_uninspected_fold_is_inspected_before_a_retry(kind: FailureKind) -> None:
    """Without the inspection, a folded garment could be recognised as a smaller flat one."""
    carried = failed(kind, context=context_with(SEEN, carried=True))
    result = choose_next(fake_workcell(FakeCell()), carried)
    assert result.event is Event.LOOK_AFTER and result.record["recovery"] == "look_after"
    assert result.context.recoveries == ((0, f"{kind.value} -> look_after"),)


def test_a_finished_fold_is_not_repeated() -> None:
    """The arms strayed during the retreat. The garment is folded already, so a new grasp would fold it once
    more."""
    strayed = failed(K.TRACKING_ERROR, context=context_with(SEEN, carried=True))
    assert choose_next(fake_workcell(FakeCell()), strayed).event is Event.LOOK_AFTER
    before = failed(K.TRACKING_ERROR, context=planned())
    assert choose_next(fake_workcell(FakeCell()), before).event is Event.GRASP_AGAIN


def test_a_retry_by_the_operator_starts_the_attempt_anew() -> None:
    cell = FakeCell()
    workcell = fake_workcell(cell)
    cell.at(0.3, lambda: workcell.commands.put(Event.RETRY))
    half_made: Any = {"repair": SimpleNamespace(), "tried": (RepairGoal.COMPLETE,), "touched": True}
    said = ask_operator(workcell, context_with(SEEN, carried=True, press_tries=2, **half_made))
    fold = said.context.fold
    assert said.event is Event.RETRY and fold.attempt is None, "the new attempt has no history"
    assert fold.repair is None and not fold.tried and fold.after_repair() is fold and not fold.uncertain
    blind = choose_next(workcell, failed(K.CAMERA_FAULT, context=said.context))
    assert blind.event is Event.LOOK_AGAIN


def test_after_a_retry_by_the_operator_failures_are_counted_anew(tmp_path: Path) -> None:
    """A person has changed something, so the table begins with its first recovery, within the same limits."""
    workcell = fake_workcell(FakeCell(), settings=bounded(tmp_path, attempts_per_step=2, attempts_per_run=2))

    def tried(context: RunContext) -> tuple[list[Event], RunContext]:
        events = []
        while not events or events[-1] is not Event.GIVE_UP:
            result = choose_next(workcell, failed(K.MISSED_GRASP, context=context))
            context, events = result.context, [*events, result.event]
        return events, context

    earlier = {(5, K.SLIPPED.value): 1}
    first, context = tried(planned(attempts=earlier))
    cell = FakeCell()
    asked = fake_workcell(cell)
    cell.at(0.3, lambda: asked.commands.put(Event.RETRY))
    again = ask_operator(asked, context).context
    assert again.attempts == earlier, "failures of other folds are not forgotten"
    assert again.recoveries == context.recoveries, "the report tells all"
    second, _ = tried(planned(attempts=earlier, recoveries=again.recoveries, forgiven=again.forgiven))
    assert second == first and len(first) == 3


def test_commands_that_do_not_answer_the_question_are_ignored() -> None:
    cell = FakeCell()
    workcell = fake_workcell(cell)
    cell.at(0.2, lambda: workcell.commands.put(Event.RESUME))
    cell.at(0.6, lambda: workcell.commands.put(Event.APPROVE))
    assert ask_approval(workcell, RunContext()).event is Event.APPROVE
    assert cell.now >= 0.6


def test_a_fold_and_its_pressing_can_be_skipped_and_a_repair_cannot() -> None:
    for changes, said in (
        ({"carried": True}, Event.SKIP),
        ({}, Event.SKIP),
        ({"repair": object()}, Event.APPROVE),
    ):
        cell = FakeCell()
        workcell = fake_workcell(cell)
        cell.at(0.3, lambda workcell=workcell: workcell.commands.put(Event.SKIP))
        cell.at(0.6, lambda workcell=workcell: workcell.commands.put(Event.APPROVE))
        result = ask_approval(workcell, context_with(**{"carried": False, **changes}))
        assert result.event is said and result.context.fold.attempt.unpressed is ("carried" in changes)


@pytest.mark.parametrize("ask", [ask_approval, ask_operator, pause])
def test_a_stop_ends_a_question_to_the_operator(ask) -> None:
    cell = FakeCell()
    workcell = fake_workcell(cell)
    cell.at(0.3, lambda: workcell.ports.stop.trigger("button"))
    result = ask(workcell, RunContext())
    assert result.event is Event.FAILED and result.context.failure.kind is K.STOPPED
    assert cell.now < 0.4
