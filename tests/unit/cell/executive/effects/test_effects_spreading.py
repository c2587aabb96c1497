"""Spreading a heap: when it is tried, what is pulled, and when the cell asks instead."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import cv2
import numpy as np
import pytest

from foldcell.cell.config.cell_settings import load_settings
from foldcell.cell.config.garments.garment_file import load_garment
from foldcell.cell.executive.effects import EFFECTS
from foldcell.cell.executive.effects.planning import _task
from foldcell.cell.executive.effects.recovery import spreading
from foldcell.cell.executive.effects.recovery.deciding import ask_operator
from foldcell.cell.executive.effects.recovery.spreading import lies_elsewhere, not_spread
from foldcell.cell.states.recovery_table import VERDICTS
from foldcell.cell.states.run_context import RunContext
from foldcell.cell.states.stages import FirstLook, Spread
from foldcell.cell.states.transition_table import Effect, Event
from foldcell.robots.errors import Failure, FailureKind
from foldcell.robots.ports import Array
from foldcell.skills.cloth.mesh import mesh_from_contour
from foldcell.skills.fold_plan.plan import plan_folds
from foldcell.skills.perception.inspection.height_expectation import CameraBias
from foldcell.skills.perception.rectification.table_view import TableView
from foldcell.skills.state_estimate.observation import Observation
from foldcell.skills.vocabulary import Outcome
from tests.builders.contexts import context_with
from tests.fakes import FakeCell
from tests.inspections import inspection
from tests.workcells import fake_workcell

K = FailureKind
TOWEL = load_garment("medium_towel")
STATE = TOWEL.flat_state(*TOWEL.poses.middle)
HALF = plan_folds(STATE, TOWEL).unwrap()[0]
MESH = mesh_from_contour(STATE.contour, 0.05, TOWEL.layers)
FLAT = MESH.lay_flat(TOWEL.material.thickness)
FIRST = FirstLook(STATE.contour, CameraBias(0.002, 0.001, measured=True))
DRAWN_IN = 0.10
"""Distance by which a corner of the heap was drawn in [m]."""


def heap(shift: tuple[float, float] = (0.0, 0.0), drawn_in: float = DRAWN_IN) -> Array:
    """The towel with its corner at the far left drawn in towards the middle."""
    contour = STATE.contour.copy()
    far_left = int(np.argmax(contour.sum(axis=1)))
    inward = contour.mean(axis=0) - contour[far_left]
    contour[far_left] += drawn_in * inward / np.linalg.norm(inward)
    return contour + np.array(shift)


def sees(monkeypatch: pytest.MonkeyPatch, contour: Array, height: float = 0.006) -> None:
    cell = fake_workcell(FakeCell())
    view = TableView(cell.calibration, cell.table)
    mask = np.zeros(view.shape, np.uint8)
    cv2.fillPoly(mask, [np.round(view.to_pixel(contour)).astype(np.int32)], (1.0,))
    field = np.where(mask > 0, height, 0.0).astype(np.float32)
    seen = Observation(view, mask > 0, field, contour, np.zeros((*view.shape, 3), np.uint8))
    monkeypatch.setattr(spreading, "observe", lambda *_, **__: Outcome(seen))


def heaped(**changes: Any) -> RunContext:
    context = context_with(garment=TOWEL, steps=(HALF,), flat=STATE, mesh=MESH, vertices=FLAT, step=HALF)
    frame = FakeCell().ports().camera.capture()
    sight = replace(context.sight, frame=frame, reference=frame)
    return context_with(replace(context, sight=sight, first_look=FIRST), **changes)


def chosen(context: RunContext, kind: FailureKind, times: int = 1) -> Event:
    failure = Failure(kind, "it failed")
    for _ in range(times):
        context = context.with_failure(failure)
    return EFFECTS[Effect.CHOOSE_RECOVERY](fake_workcell(FakeCell()), context).event


def test_a_heap_of_the_first_fold_is_spread_after_a_second_look() -> None:
    assert chosen(heaped(), K.HEAPED) is Event.LOOK_AGAIN
    assert chosen(heaped(), K.HEAPED, 2) is Event.SPREAD
    assert chosen(heaped(), K.HALF_FOLDED, 3) is Event.SPREAD, "its edge lies under other cloth"


@pytest.mark.parametrize("kind", sorted(VERDICTS))
def test_a_refused_first_fold_is_spread_if_it_can_neither_be_repaired_nor_built_on(kind: FailureKind) -> None:
    assert chosen(heaped(), kind, 2) is (Event.GIVE_UP if kind is K.TOO_HIGH else Event.SPREAD)
    assert chosen(heaped(carried=True, steps=(HALF, HALF)), kind, 2) is Event.CARRY_ON


def test_a_fold_that_looks_good_is_not_spread_because_its_claim_is_in_doubt() -> None:
    good = heaped(carried=True, inspection=inspection())
    assert good.fold.attempt is not None and good.fold.attempt.inspection is not None
    assert chosen(good, K.OFF_TARGET, 2) is Event.GIVE_UP


@pytest.mark.parametrize("kind", [K.NOT_FLAT, K.LOW_CONFIDENCE, K.UNKNOWN_GARMENT, K.CATEGORY_MISMATCH])
def test_what_recognition_refuses_is_spread_only_after_another_pull(kind: FailureKind) -> None:
    assert chosen(heaped(), kind) is Event.LOOK_AGAIN
    assert [chosen(heaped(), kind, times) for times in (5, 6)] == [Event.LOOK_AGAIN, Event.GIVE_UP]
    assert chosen(heaped(pulls=1), kind) is Event.LOOK_AGAIN, "no verdict from one look"
    assert chosen(heaped(pulls=1), kind, 2) is Event.SPREAD


@pytest.mark.parametrize(
    "changes", [{"index": 1, "steps": (HALF, HALF)}, {"pulls": 4}, {"spread": False}, {"first_look": None}]
)
def test_a_heap_is_not_spread_in_later_folds_nor_without_bound_nor_in_vain(changes: dict[str, Any]) -> None:
    assert load_settings().recovery.pulls == 4
    assert chosen(heaped(**changes), K.HEAPED, 2) is Event.GIVE_UP


def test_the_corner_of_a_heap_is_pulled_to_where_it_belongs(monkeypatch: pytest.MonkeyPatch) -> None:
    sees(monkeypatch, heap())
    result = EFFECTS[Effect.PLAN_SPREAD](fake_workcell(FakeCell()), heaped())
    fold = result.context.fold
    assert result.event is Event.DONE and isinstance(fold.repair, Spread) and fold.pulls == 1
    step = fold.repair.step
    lengths = {i: float(np.linalg.norm(t[:2] - step.grasps[i].point)) for i, t in step.targets.items()}
    assert sorted(lengths.values()) == pytest.approx([0.0, DRAWN_IN], abs=0.015), (
        "the other hand holds the garment"
    )
    for target in step.targets.values():
        assert np.linalg.norm(STATE.contour - target[:2], axis=1).min() < 0.025
    assert "corner" in fold.repair.in_words() and not fold.repair.home
    assert fold.repair.aim == pytest.approx(FLAT, abs=0.01)
    plan = result.context.plan
    assert plan is not None and fold.arcs is not None
    assert not _task(fold, plan, fold.arcs, 0.1).simulated, "how the cloth lies is not known"


def test_the_next_look_recognises_the_garment_anew(monkeypatch: pytest.MonkeyPatch) -> None:
    sees(monkeypatch, heap())
    fold = EFFECTS[Effect.PLAN_SPREAD](fake_workcell(FakeCell()), heaped()).context.fold
    assert fold.after_repair().covered == (), "nothing was pulled"
    attempt: Any = SimpleNamespace(carried=True)
    after = replace(fold, attempt=attempt).after_repair()
    assert after.repair is None and after.attempt is None and not after.uncertain
    assert len(after.covered) == 1 and after.note() is None


def test_a_pull_that_did_not_help_is_not_followed_by_another(monkeypatch: pytest.MonkeyPatch) -> None:
    """There is none left: one corner only lies beside its place."""
    sees(monkeypatch, heap())
    cell = fake_workcell(FakeCell())
    first = EFFECTS[Effect.PLAN_SPREAD](cell, heaped())
    covered = float(str(first.record["covered_m2"]))
    result = EFFECTS[Effect.PLAN_SPREAD](cell, heaped(pulls=1, covered=(covered - 0.001,)))
    assert result.event is Event.FAILED and result.context.failure is not None
    assert result.context.failure.kind is K.HEAPED and "has not spread" in result.context.failure.what
    assert EFFECTS[Effect.CHOOSE_RECOVERY](cell, result.context).event is not Event.SPREAD
    grown = EFFECTS[Effect.PLAN_SPREAD](cell, heaped(pulls=1, covered=(covered - 0.02,)))
    assert grown.event is Event.DONE


def test_cloth_that_stands_higher_than_the_pads_is_not_taken(monkeypatch: pytest.MonkeyPatch) -> None:
    depth = load_settings().gripper.pad_depth
    sees(monkeypatch, heap(), depth + 0.004)
    result = EFFECTS[Effect.PLAN_SPREAD](fake_workcell(FakeCell()), heaped())
    assert result.context.failure is not None and "no hand can take" in result.context.failure.what
    assert not result.context.fold.spread
    sees(monkeypatch, heap(), depth + 0.001)  # the camera sees cloth 2 mm too high
    assert EFFECTS[Effect.PLAN_SPREAD](fake_workcell(FakeCell()), heaped()).event is Event.DONE


def test_a_spread_garment_is_drawn_back_to_where_it_was_laid(monkeypatch: pytest.MonkeyPatch) -> None:
    moved = STATE.contour + np.array([0.0, 0.09])
    pulled = heaped(pulls=1, covered=(0.2,))
    assert lies_elsewhere(pulled, moved) and not lies_elsewhere(pulled, STATE.contour + 0.01)
    assert not lies_elsewhere(heaped(), moved), "a person may have laid it there"
    sees(monkeypatch, moved)
    result = EFFECTS[Effect.PLAN_SPREAD](fake_workcell(FakeCell()), pulled)
    repair = result.context.fold.repair
    assert isinstance(repair, Spread) and repair.home and len(repair.step.grasps) == 2
    for grasp_id, target in repair.step.targets.items():
        assert target[:2] - repair.step.grasps[grasp_id].point == pytest.approx([0.0, -0.09], abs=0.01)


@pytest.mark.parametrize(("share", "spread"), [(0.97, True), (0.9, False)])
def test_a_recognised_garment_that_covers_too_little_is_not_spread(share: float, spread: bool) -> None:
    """A smaller towel has the same outline as one that is folded over along its whole edge."""
    middle = STATE.contour.mean(axis=0)
    smaller = middle + np.sqrt(share) * (STATE.contour - middle)
    perception: Any = SimpleNamespace(
        view=SimpleNamespace(to_table=lambda pixels: pixels), segmentation=SimpleNamespace(contour=smaller)
    )
    failure = not_spread(heaped(pulls=1), perception)
    assert (failure is None) is spread
    assert failure is None or (failure.kind is K.NOT_FLAT and "not spread" in failure.what)
    assert not_spread(heaped(), perception) is None, "no pull was planned, or a person laid it since"


def test_after_a_person_has_laid_the_garment_pulls_are_allowed_again() -> None:
    cell = FakeCell()
    workcell = fake_workcell(cell, attended=True)
    workcell.commands.put(Event.RETRY)
    fold = ask_operator(workcell, heaped(pulls=3, covered=(0.1,), spread=False)).context.fold
    assert (fold.pulls, fold.covered, fold.spread) == (0, (), True)
