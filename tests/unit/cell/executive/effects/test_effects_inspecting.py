"""The result of an inspection: the next fold, the end of the run, or a typed failure."""

from __future__ import annotations

from dataclasses import replace
from types import MethodType, SimpleNamespace
from typing import Any

import cv2
import numpy as np
import pytest

import foldcell.cell.executive.effects.claiming as claiming
import foldcell.cell.executive.effects.inspecting as inspecting
from foldcell.cell.executive.effects import EFFECTS
from foldcell.cell.executive.effects.inspecting import figures, next_step
from foldcell.cell.states.fold_context import FoldContext
from foldcell.cell.states.recovery_table import Adjustment
from foldcell.cell.states.run_context import RunContext
from foldcell.cell.states.stages import FirstLook, FoldNote, Repair
from foldcell.cell.states.transition_table import Effect, Event
from foldcell.robots.errors import Failure, FailureKind
from foldcell.skills.cloth.mesh import ClothMesh
from foldcell.skills.fold_plan.repair import RepairGoal
from foldcell.skills.garments.garment import Garment
from foldcell.skills.perception.inspection.height_expectation import CameraBias
from foldcell.skills.perception.inspection.result import Inspection
from foldcell.skills.perception.inspection.target_view import StackHeights, TargetView
from foldcell.skills.perception.rectification.table_view import TableView
from foldcell.skills.plane import rotation
from foldcell.skills.state_estimate.hypothesis import FoldState
from foldcell.skills.vocabulary import FoldLine, FoldStep, GarmentState, Outcome, PredictedShape
from tests.builders.contexts import context_with
from tests.fakes import FakeCell
from tests.inspections import a_claim, inspection
from tests.scenes import TABLE, camera
from tests.workcells import fake_workcell

K = FailureKind
inspect_fold = EFFECTS[Effect.INSPECT]
TRIANGLE = np.array([[0, 1, 2]], np.int32)
CORNERS = np.array([[0.5, 0.0], [0.7, 0.0], [0.5, 0.2]])
FLAT = np.column_stack([CORNERS, np.full(3, 0.001)])
FOLDED = FLAT + np.array([0.0, 0.05, 0.002])
MESH = ClothMesh(CORNERS, np.zeros(3, np.int32), TRIANGLE, np.zeros(1, np.int32), np.zeros((0, 2), np.int32))
LINE = FoldLine(np.array([0.6, 0.0]), np.array([1.0, 0.0]))
STEPS = tuple(FoldStep(name, k, LINE, (), {}, {}) for k, name in enumerate(("half", "quarter")))


def seen(diagnosis: FailureKind | None = None, **changes: Any) -> Inspection:
    return inspection(diagnosis=diagnosis, contour=CORNERS, **changes)


def made(**changes: Any) -> RunContext:
    """The first of two folds was carried through."""
    known: dict[str, Any] = {
        "steps": STEPS, "mesh": MESH, "vertices": FLAT, "predicted": PredictedShape(FOLDED, TRIANGLE, CORNERS),
        "carried": True, "frame": FakeCell().ports().camera.capture(),
    }  # fmt: skip
    return context_with(**{**known, **changes})


def look(monkeypatch: pytest.MonkeyPatch, looked: Inspection) -> None:
    """Every inspection has this result; nothing is pressed and nothing learned."""
    monkeypatch.setattr(inspecting, "inspect", lambda *_, **__: Outcome(looked))
    monkeypatch.setattr(inspecting, "plan_pressing", lambda *_: None)
    monkeypatch.setattr(inspecting, "adapt", lambda cell, index, plan, *_: (plan.garment, {}))


@pytest.mark.parametrize(("index", "event"), [(0, Event.NEXT_FOLD), (1, Event.ALL_FOLDED)])
def test_a_fold_as_predicted_leads_to_the_next_step(
    index: int, event: Event, monkeypatch: pytest.MonkeyPatch
) -> None:
    look(monkeypatch, seen())
    before: Any = SimpleNamespace(name="half")
    result = inspect_fold(fake_workcell(FakeCell()), made(index=index, done=(before,) * index))
    assert result.event is event and result.record["iou"] == 0.96
    assert [note.name for note in result.context.done] == ["half", "quarter"][: index + 1]


@pytest.mark.parametrize("pressed", [False, True])
def test_a_second_look_is_averaged_with_the_first_unless_the_fold_was_pressed(
    pressed: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    first, given = seen(K.SAG), []
    look(monkeypatch, seen())
    monkeypatch.setattr(
        inspecting, "inspect", lambda *_, **looks: given.append(looks["earlier"]) or Outcome(seen())
    )
    context = made(inspection=first, pressed=(first,) if pressed else ())
    inspect_fold(fake_workcell(FakeCell()), context)
    assert given == [None if pressed else first]


@pytest.mark.parametrize("kind", [K.DRIFT, K.PILING, K.SAG, K.DROPPED_CORNER])
def test_the_state_is_estimated_after_each_refusal_but_a_drift(
    kind: FailureKind, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Also within a good outline: only a fold whose state is known is repaired."""
    asked: list[Any] = []
    look(monkeypatch, seen(kind))
    nothing = Outcome[Any](failure=Failure(K.NO_GARMENT, "nothing there"))
    monkeypatch.setattr(inspecting, "note_estimate", lambda *_: asked.append(kind) or nothing)
    inspect_fold(fake_workcell(FakeCell()), made())
    assert asked == ([] if kind is K.DRIFT else [kind])


@pytest.mark.parametrize("kind", [K.DRIFT, K.PILING, K.SAG, K.DROPPED_CORNER, K.MISSED_LAYER, K.OFF_TARGET])
def test_a_fold_unlike_its_prediction_is_a_failure_of_its_kind(
    kind: FailureKind, monkeypatch: pytest.MonkeyPatch
) -> None:
    look(monkeypatch, seen(kind, iou_aligned=0.87))
    result = inspect_fold(fake_workcell(FakeCell()), made())
    failure = result.context.failure
    assert result.event is Event.FAILED and failure is not None and failure.kind is kind
    assert "fold half: overlap 0.87" in failure.what and failure.hint
    assert failure.values["iou_aligned"] == 0.87, (
        "the recovery uses this overlap to decide whether the fold is good enough"
    )
    assert result.context.fold.attempt.inspection is not None and not result.context.done


BIAS = 0.0025
SQUARE = np.array([[0.5, 0.0], [0.7, 0.0], [0.7, 0.2], [0.5, 0.2]])


def as_seen(height: float, crease: float = 0.020, iou: float = 0.97) -> TargetView:
    """The view of a fold of these true heights [m] in two layers of 2 mm, predicted 10 and 20 mm high."""
    observed = StackHeights(height + BIAS, crease + BIAS)
    flat = StackHeights(0.003, 0.003)
    return TargetView(
        iou, np.array([0.6, 0.1]), np.zeros(2), 0.0, 0.25, observed, StackHeights(0.010, 0.020), flat
    )


def last_fold(earlier: Inspection | None = None, **changes: Any) -> RunContext:
    """The last of two folds was carried. earlier: the inspection that refused the first one."""
    flat = GarmentState("towel", SQUARE, {}, 1.0)
    unpressed = SimpleNamespace(pressed=(), disturbed=False, inspection=None)
    before: Any = SimpleNamespace(
        name="half", claim=None, accepted=False, inspected=earlier, hidden=False, anew=None,
        attempt=unpressed,
    )  # fmt: skip
    garment: Any = SimpleNamespace(
        plan=[SimpleNamespace(variants=())] * 2,
        material=SimpleNamespace(thickness=0.002, bending_length=0.015),
        bending_factors=(0.8, 1.2),
        thickness_sigma=lambda spread: spread * 0.002,
        layers=1,
        fabric=SimpleNamespace(thickness=(0.001, 0.003)),
    )
    garment.thickness_of = MethodType(Garment.thickness_of, garment)
    first_look = FirstLook(SQUARE, CameraBias(BIAS, 0.0001, True))
    return made(index=1, done=(before,), garment=garment, flat=flat, first_look=first_look, **changes)


def test_a_last_fold_within_its_limits_is_claimed(monkeypatch: pytest.MonkeyPatch) -> None:
    look(monkeypatch, seen(target=as_seen(0.011)))
    result = inspect_fold(fake_workcell(FakeCell()), last_fold())
    claim = result.context.claim()
    assert result.event is Event.ALL_FOLDED and claim is not None and claim.holds
    assert claim.height_m == pytest.approx(0.011) and claim.height_limit_m == pytest.approx(0.014)
    assert result.record["claim"]["says"] == claim.says


@pytest.mark.parametrize(
    ("deviation", "says"),
    [(0.024, "folded as planned"), (0.029, "half was not found good")],
)
def test_an_earlier_fold_refutes_the_claim_only_beyond_the_claims_own_limit(
    deviation: float, says: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The inspection refused this fold, while it could still be repaired."""
    look(monkeypatch, seen(target=as_seen(0.011)))
    earlier = seen(K.OFF_TARGET, edge_deviation_m=deviation)
    claim = inspect_fold(fake_workcell(FakeCell()), last_fold(earlier)).context.claim()
    assert claim is not None and says in claim.says and claim.holds is (deviation < 0.025)


@pytest.mark.parametrize(
    ("earlier", "claimed"), [({"piled_area_m2": 0.0014}, True), ({"iou_aligned": 0.8}, False)]
)
def test_cloth_heaped_up_in_an_earlier_fold_is_judged_by_the_height_of_the_finished_garment(
    earlier: dict[str, float], claimed: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    for height, flat in ((0.011, True), (0.031, False)):
        look(monkeypatch, seen(target=as_seen(height)))
        context = last_fold(seen(K.PILING, **earlier))
        claim = inspect_fold(fake_workcell(FakeCell()), context).context.claim()
        assert claim is not None and (claim.shape, claim.flat) == (claimed, flat)


@pytest.mark.parametrize(("height", "event"), [(0.011, Event.ALL_FOLDED), (0.031, Event.FAILED)])
def test_cloth_higher_than_a_usual_fabric_is_no_heap_if_the_first_crease_explains_it(
    height: float, event: Event, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A large towel of stiff terry was made anew and refused: 21 cm2 of it stood too high for the prediction, and
    all of it 6 mm lower than its fabric may."""
    look(monkeypatch, seen(K.PILING, piled_area_m2=0.0021, target=as_seen(height)))
    assert inspect_fold(fake_workcell(FakeCell()), last_fold(seen(target=as_seen(0.011)))).event is event


def test_the_claim_takes_the_thickness_of_a_layer_from_the_hands(monkeypatch: pytest.MonkeyPatch) -> None:
    """The fabric's class is at most 3 mm thick."""
    look(monkeypatch, seen(target=as_seen(0.011)))
    limits = []
    for thickness in (None, 0.0025, 0.003, 0.004):
        context = context_with(last_fold(), layer_thickness=thickness)
        claim = inspect_fold(fake_workcell(FakeCell()), context).context.claim()
        assert claim is not None
        limits.append(claim.height_limit_m)
    stated, thick, thickest, implausible = limits
    assert stated < thick < thickest == implausible


@pytest.mark.parametrize(
    ("earlier", "repaired", "known"),
    [({}, None, True), ({}, 1, True), ({}, 0, False), ({"iou_aligned": 0.8}, None, False)],
)
def test_the_first_crease_shows_the_fabric_although_cloth_is_heaped_up(
    earlier: dict[str, float], repaired: int | None, known: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A fold of the wrong shape shows nothing: its crease may lie elsewhere. Nor does a fold that was made anew:
    its cloth stands higher than its fabric explains. repaired: index of the fold that was repaired."""
    claims = []
    for crease in (0.010, 0.026):
        look(monkeypatch, seen(target=as_seen(0.011)))
        heap = seen(K.PILING, piled_area_m2=0.0014, target=as_seen(0.011, crease), **earlier)
        repairs = () if repaired is None else ((repaired, "undone"),)
        context = context_with(last_fold(heap), repairs=repairs)
        claims.append(inspect_fold(fake_workcell(FakeCell()), context).context.claim())
    soft, stiff = claims
    assert soft is not None and stiff is not None
    assert (stiff.bending_length_m > soft.bending_length_m) is known


@pytest.mark.parametrize(
    ("view", "kind", "words"),
    [
        (as_seen(0.031), K.TOO_HIGH, "folded, but stands 31 mm high, 17 mm more than it should"),
        (as_seen(0.011, 0.041), K.TOO_HIGH, "folded, but a crease stands 41 mm high, 11 mm more than it should"),
        (as_seen(0.011, iou=0.85), K.OFF_TARGET, "overlap with the plan is 0.85"),
    ],
)
def test_a_last_fold_whose_claim_does_not_hold_is_not_folded(
    view: TargetView, kind: FailureKind, words: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    look(monkeypatch, seen(target=view))
    workcell = fake_workcell(FakeCell())
    result = inspect_fold(workcell, last_fold())
    failure = result.context.failure
    assert result.event is Event.FAILED and failure is not None
    assert failure.kind is kind and words in failure.what and failure.hint
    again = EFFECTS[Effect.CHOOSE_RECOVERY](workcell, result.context)
    assert again.event is not Event.GIVE_UP, "a verdict that ends the run is not taken from one look"
    result = inspect_fold(workcell, again.context)
    assert EFFECTS[Effect.CHOOSE_RECOVERY](workcell, result.context).event is Event.GIVE_UP
    note = result.context.notes()["quarter"]
    assert not note.accepted and note.attempt.claim is not None and not note.attempt.claim.holds


@pytest.mark.parametrize("drifted", [None, K.DRIFT])
@pytest.mark.parametrize(
    ("view", "undone"), [(as_seen(0.031), True), (as_seen(np.nan), False), (as_seen(0.011, iou=0.85), False)]
)
def test_a_last_fold_is_made_anew_if_it_is_seen_to_stand_too_high(
    view: TargetView, undone: bool, drifted: FailureKind | None, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Only a fold whose state is estimated is undone. A height that is not visible, or a place that is not the
    planned one, does not get better by it: an estimate of an earlier look is forgotten."""
    lies: Any = SimpleNamespace(state=FoldState.AFTER)
    asked: list[Any] = []
    monkeypatch.setattr(
        inspecting, "note_estimate", lambda cell, context, *_: asked.append(1) or Outcome((context, lies))
    )
    look(monkeypatch, seen(drifted, target=view))
    before = last_fold()
    if not undone:
        before = replace(before, fold=replace(before.fold, estimate=lies))
    result = inspect_fold(fake_workcell(FakeCell()), before)
    failure = result.context.failure
    assert bool(asked) == undone and failure is not None
    assert drifted or undone or result.context.fold.estimate is None
    if undone:
        assert failure.kind is K.TOO_HIGH, (
            "also if it has drifted from its prediction, which is accepted otherwise"
        )


def test_only_the_last_fold_is_claimed(monkeypatch: pytest.MonkeyPatch) -> None:
    look(monkeypatch, seen(target=as_seen(0.031)))
    result = inspect_fold(fake_workcell(FakeCell()), made())
    assert result.event is Event.NEXT_FOLD and result.context.claim() is None


def test_a_fold_that_is_too_high_is_pressed_first(monkeypatch: pytest.MonkeyPatch) -> None:
    """Also if it has drifted from its prediction, which is accepted otherwise."""
    for diagnosis in (None, K.DRIFT):
        look(monkeypatch, seen(diagnosis, target=as_seen(0.031)))
        plan: Any = SimpleNamespace(dabs=4)
        monkeypatch.setattr(inspecting, "plan_pressing", lambda *_, plan=plan: plan)
        assert inspect_fold(fake_workcell(FakeCell()), last_fold()).event is Event.PRESS


def test_a_claim_that_does_not_hold_ends_the_run_as_not_folded_whatever_leads_to_the_end() -> None:
    """A drifted fold is accepted by its recovery, and an operator may skip a refused one."""
    says = "folded, but stands 31 mm high, 6 mm more than it should"
    high = last_fold(inspection=seen(K.DRIFT), claim=a_claim(flat=False, says=says))
    result = next_step(fake_workcell(FakeCell()), high)
    assert result.event is Event.GIVE_UP and result.context.through
    assert result.context.failure is not None and result.context.failure.what == says
    good = next_step(fake_workcell(FakeCell()), last_fold(inspection=seen(K.DRIFT), claim=a_claim()))
    assert good.event is Event.ALL_FOLDED and good.context.failure is None
    claim = good.context.claim()
    assert claim is not None and claim.holds, "the claim stays after the run's end"


@pytest.mark.parametrize("disturbed", [True, False])
def test_a_shove_by_a_person_does_not_count_as_the_cells_drift(
    disturbed: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The claim compares the plan's place with that of the first look, so both move with a shoved garment."""
    shift = np.array([0.08, -0.02])
    look(monkeypatch, seen(K.DRIFT, drift=shift, drift_m=float(np.linalg.norm(shift))))
    context = context_with(last_fold(), disturbed=disturbed)
    assert context.plan is not None and context.sight.frame is not None
    result = inspecting.find_folded(fake_workcell(FakeCell()), context, context.plan, context.sight.frame)
    after = result.context
    assert result.event is Event.DONE and not after.disturbed and after.plan is not None
    np.testing.assert_allclose(after.plan.flat.contour, SQUARE + shift)
    assert after.first_look is not None
    np.testing.assert_allclose(after.first_look.contour, SQUARE + (shift if disturbed else 0.0))


@pytest.mark.parametrize("cause", ["touched", "disturbed", ""])
def test_what_was_seen_before_a_disturbance_is_seen_anew_or_counts_as_hidden(
    cause: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of two folds that were found good, the last one is looked at again. The third one is yet to be made."""
    attempt: Any = SimpleNamespace(
        predicted=PredictedShape(FOLDED, TRIANGLE, CORNERS), step=STEPS[1], before=None, claim=None, pressed=(),
        inspection=seen(target=as_seen(0.011)), disturbed=False,
    )  # fmt: skip
    notes = (FoldNote(SimpleNamespace(**{**vars(attempt), "step": STEPS[0]}), 1), FoldNote(attempt, 1))
    looked = [seen(K.DRIFT, drift_m=0.1), seen(K.DRIFT, drift_m=0.1, iou_aligned=0.8)]
    monkeypatch.setattr(inspecting, "inspect", lambda *_, **__: Outcome(looked.pop(0)))
    context = context_with(last_fold(), done=notes, disturbed=cause == "disturbed", touched=cause == "touched")
    assert context.plan is not None and context.sight.frame is not None
    found = inspecting.find_folded(fake_workcell(FakeCell()), context, context.plan, context.sight.frame).context
    first, last = found.done
    assert (first.hidden, last.accepted) == ((True, False) if cause else (False, True))
    assert len(looked) == (0 if cause else 1), "an undisturbed fold is not looked at again"
    assert last.inspected is not None and last.inspected.target is attempt.inspection.target
    assert last.inspected.diagnosis is (K.OFF_TARGET if cause else None)


VIEW = TableView(camera(), TABLE)


def outline_off(near: float, far: float) -> Inspection:
    """A garment that was predicted from x = 0.4 to 0.8 m. Its outline lies this far outside at both ends [m]."""
    square = np.array([[0.4, -0.15], [0.8, -0.15], [0.8, 0.15], [0.4, 0.15]])
    predicted = np.zeros(VIEW.shape, np.uint8)
    cv2.fillPoly(predicted, [np.rint(VIEW.to_pixel(square)).astype(np.int32)], (1.0,))
    ends = np.where(square[:, :1] < 0.6, [-near, 0.0], [far, 0.0])
    return replace(seen(view=VIEW, predicted=predicted > 0), contour=square + ends)


def laid_over_the_near_end(attempt: Any) -> None:
    """Give an attempt a fold that has laid cloth over the near end of the garment of `outline_off`."""
    strip = np.array([[x, y] for x in (0.36, 0.39) for y in np.arange(-0.15, 0.16, 0.02)])
    attempt.step = replace(STEPS[0], line=FoldLine(np.array([0.4, 0.0]), np.array([0.0, 1.0])))
    assert (attempt.step.line.signed_distance(strip) > 0.0).all()
    laid = np.column_stack([attempt.step.line.reflect(strip), np.full(len(strip), 0.003)])
    attempt.predicted = PredictedShape(laid, TRIANGLE, strip)


@pytest.mark.parametrize(
    ("before", "near", "far", "claimed"),
    [
        (0.002, 0.004, 0.002, True),
        (0.002, 0.006, 0.002, False),
        (0.002, -0.012, 0.002, False),
        (0.008, 0.009, 0.002, True),
        (0.002, 0.003, -0.014, True),
    ],
)
def test_a_fold_whose_layers_a_disturbance_has_distorted_is_not_claimed(
    before: float, near: float, far: float, claimed: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The fold has laid cloth over the near end. In the last case, recorded with a shirt, only the hem at the far
    end was laid back crooked; it was folded once more."""
    look(monkeypatch, seen(target=as_seen(0.011)))
    context = last_fold()
    attempt: Any = context.done[0].attempt
    laid_over_the_near_end(attempt)
    attempt.inspection = outline_off(before, 0.002)
    context.done[0].anew = outline_off(near, far)
    claim = inspect_fold(fake_workcell(FakeCell()), context).context.claim()
    assert claim is not None and claim.holds is claimed
    assert claimed or "half was not found good" in claim.says


def test_a_garment_that_was_turned_as_a_whole_is_not_distorted(monkeypatch: pytest.MonkeyPatch) -> None:
    """Somebody has turned it by 12 degrees, more than a fold may turn it (10), and shifted it."""
    turn, shift, about = np.deg2rad(12.0), np.array([0.03, -0.02]), np.array([0.6, 0.0])
    before = outline_off(0.002, 0.002)
    turned = (before.contour - about) @ rotation(turn).T + about + shift
    look(
        monkeypatch, replace(before, contour=turned, drift=shift, drift_about=about, drift_m=0.036, drift_rad=turn)
    )
    attempt: Any = SimpleNamespace(before=None, claim=None, pressed=(), inspection=before, disturbed=False)
    laid_over_the_near_end(attempt)
    context = context_with(last_fold(), done=(FoldNote(attempt, 1),), disturbed=True)
    assert context.plan is not None and context.sight.frame is not None
    found = inspecting.find_folded(fake_workcell(FakeCell()), context, context.plan, context.sight.frame).context
    (note,) = found.done
    assert note.anew is not None and note.accepted, "neither its drift nor its angle counts"
    assert claiming._more_off(note) == pytest.approx(0.0, abs=0.001)


def test_a_claim_knows_which_folds_are_hidden(monkeypatch: pytest.MonkeyPatch) -> None:
    look(monkeypatch, seen(target=as_seen(0.011)))
    known = inspect_fold(fake_workcell(FakeCell()), last_fold()).context.claim()
    doubted = inspect_fold(fake_workcell(FakeCell()), last_fold(interrupted=True)).context.claim()
    assert known is not None and doubted is not None
    assert doubted.reliability == pytest.approx(0.95 * known.reliability)


@pytest.mark.parametrize("disturbance", ["", "repaired", "seen anew", "laid back on"])
def test_a_claim_knows_whether_the_garment_was_disturbed(
    disturbance: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The same overlap is near enough to its limit to be doubted after a disturbance only."""
    look(monkeypatch, seen(target=as_seen(0.011), iou_aligned=0.910))
    context = last_fold(interrupted=disturbance == "laid back on")
    if disturbance == "seen anew":
        context.done[0].anew = seen()
    context = context_with(context, repairs=((1, "undone"),) if disturbance == "repaired" else ())
    claim = inspect_fold(fake_workcell(FakeCell()), context).context.claim()
    assert claim is not None and claim.flat and claim.shape is (not disturbance)
    assert ("good with a probability of 0." in claim.says) is bool(disturbance)


def test_a_claim_knows_how_far_off_the_earlier_folds_were(monkeypatch: pytest.MonkeyPatch) -> None:
    look(monkeypatch, seen(target=as_seen(0.011)))
    near, off = last_fold(), last_fold()
    off.done[0].inspected = seen(edge_deviation_m=0.020)
    claims = [inspect_fold(fake_workcell(FakeCell()), context).context.claim() for context in (near, off)]
    assert all(claim is not None and claim.holds for claim in claims)
    assert claims[1].reliability < 0.95 * claims[0].reliability  # type: ignore[union-attr]


def test_the_next_fold_starts_with_a_new_context() -> None:
    """Otherwise values of the previous fold would affect recoveries, pressing and inspection."""
    before = made(
        inspection=seen(), failure=Failure(K.DRIFT, "it moved"), press_tries=2, adjustments=(Adjustment.LOWER,),
        grasps=3, waited_s=4.0, recoveries=((0, "drift -> carry_on"),),
    )  # fmt: skip
    after = next_step(fake_workcell(FakeCell()), before).context
    assert vars(after.fold) == vars(FoldContext(1)) and after.failure is None
    assert (after.waited_s, after.recoveries) == (4.0, before.recoveries)


def test_an_uninspected_fold_is_assumed_but_does_not_count_as_made() -> None:
    """The fold was carried, and the operator continued without an inspection."""
    result = next_step(fake_workcell(FakeCell()), made())
    assert result.context.done == ()
    np.testing.assert_array_equal(result.context.plan.vertices, FOLDED)


def test_a_fold_neither_carried_nor_seen_leaves_the_assumed_shape_unchanged() -> None:
    result = next_step(fake_workcell(FakeCell()), made(carried=False))
    assert result.context.done == ()
    np.testing.assert_array_equal(result.context.plan.vertices, FLAT)


@pytest.mark.parametrize(
    ("left", "why"), [((), None), (("half",), "half"), (("half", "quarter"), "half, quarter")]
)
def test_a_run_is_folded_only_if_every_fold_was_made(left: tuple[str, ...], why: str | None) -> None:
    notes: Any = tuple(
        SimpleNamespace(name=s.name, attempt=SimpleNamespace(claim=None)) for s in STEPS if s.name not in left
    )
    after = context_with(steps=STEPS, index=1, done=notes, failure=Failure(K.SLIPPED, "lost"))
    result = next_step(fake_workcell(FakeCell()), after)
    assert result.event is (Event.GIVE_UP if left else Event.ALL_FOLDED)
    if why is not None:
        assert result.context.failure is not None and result.context.failure.what.endswith(f"operator: {why}")
        assert result.context.through, "the run is complete although folds were skipped"


@pytest.mark.parametrize(("overlap", "event"), [(0.91, Event.DONE), (0.89, Event.FAILED), (0.3, Event.FAILED)])
def test_a_garment_displaced_since_the_last_fold_is_not_folded_further(
    overlap: float, event: Event, monkeypatch: pytest.MonkeyPatch
) -> None:
    look(monkeypatch, seen(iou_aligned=overlap, drift=np.array([0.01, 0.02])))
    context = made(index=1, vertices=FOLDED, carried=False)
    result = EFFECTS[Effect.RECOGNISE](fake_workcell(FakeCell()), context)
    assert result.event is event and result.record["iou_aligned"] == overlap
    moved = FOLDED + np.array([0.01, 0.02, 0.0]) if event is Event.DONE else FOLDED
    np.testing.assert_allclose(result.context.plan.vertices, moved, atol=1e-12)
    if event is Event.FAILED:
        assert result.context.failure is not None and result.context.failure.kind is K.NOT_FLAT


@pytest.mark.parametrize(("effect", "index"), [(Effect.INSPECT, 0), (Effect.RECOGNISE, 1)])
def test_an_inspection_without_a_visible_garment_fails(
    effect: Effect, index: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    lost = Failure(K.NO_GARMENT, "the garment is not seen on the table any more")
    monkeypatch.setattr(inspecting, "inspect", lambda *_, **__: Outcome(failure=lost))
    frame: Any = object()
    result = EFFECTS[effect](fake_workcell(FakeCell()), made(frame=frame, index=index))
    assert result.event is Event.FAILED and result.context.failure is lost


def test_unseen_figures_are_left_out_of_the_journal() -> None:
    nothing = float("nan")
    told = figures(seen(height_m=nothing, missing_layer=nothing))
    assert np.isfinite(list(told.values())).all() and not {"height_m", "missing_layer", "edge_sag_m"} & set(told)
    edge: Any = SimpleNamespace(corner=0.004, sag=nothing)
    half = figures(seen(edge=edge))
    assert half["edge_corner_m"] == 0.004 and half["height_m"] == 0.01 and "edge_sag_m" not in half


@pytest.mark.parametrize("goal", list(RepairGoal))
def test_a_fold_that_is_skipped_after_its_repair_does_not_count_as_made(goal: RepairGoal) -> None:
    """Its inspection was before the repair. After an undone fold the garment is believed to lie as before it."""
    failed = made(inspection=seen(K.SAG)).fold.attempt
    plan: Any = SimpleNamespace(goal=goal)
    displaced: Any = SimpleNamespace(taken_back=lambda vertices: vertices + 0.01)
    nothing: Any = None
    repair = Repair(plan, nothing, FLAT, FLAT, displaced, failed)
    result = next_step(fake_workcell(FakeCell()), made(repair=repair))
    assert result.event is Event.NEXT_FOLD and result.context.done == () and result.context.plan is not None
    believed = FLAT if goal is RepairGoal.UNDO else FOLDED + 0.01
    assert result.context.plan.vertices == pytest.approx(believed)
