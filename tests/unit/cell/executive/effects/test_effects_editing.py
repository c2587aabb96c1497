"""The operator changes the plan of a fold before it is approved: what is changed, refused and recorded."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from foldcell.cell.config.garments.garment_file import load_garment
from foldcell.cell.executive.effects import EFFECTS
from foldcell.cell.executive.effects.editing import edited_step, refusal, with_plan_edit
from foldcell.cell.executive.effects.recovery.deciding import ask_approval, choose_next
from foldcell.cell.states.plan_edit import PlanEdit
from foldcell.cell.states.recovery_table import Adjustment
from foldcell.cell.states.run_context import RunContext
from foldcell.cell.states.transition_table import Effect, Event
from foldcell.robots.errors import Failure, FailureKind
from foldcell.skills.fold_plan.plan import plan_folds
from foldcell.skills.vocabulary import FoldStep, GraspId
from tests.builders.contexts import context_with
from tests.fakes import FakeCell
from tests.workcells import fake_workcell

TOWEL = load_garment("medium_towel")
STATE = TOWEL.flat_state(*TOWEL.poses.middle)
STEPS = plan_folds(STATE, TOWEL).unwrap()
HALF = STEPS[0]
LEFT = GraspId.LEFT


class Perceived:
    """A stand-in for a perception."""

    garment = "medium_towel"
    state = STATE


def asked(**changes: Any) -> RunContext:
    """The context of the question about the first fold."""
    return context_with(perception=Perceived(), garment=TOWEL, flat=STATE, steps=STEPS, step=HALF, **changes)


def moved(grasp_id: GraspId, offset: tuple[float, float]) -> PlanEdit:
    x, y = HALF.grasps[grasp_id].point + offset
    return PlanEdit("page 1", grasps={grasp_id: (float(x), float(y))})


def planned(context: RunContext) -> RunContext:
    result = EFFECTS[Effect.PLAN_FOLDS](fake_workcell(FakeCell(), expected=TOWEL), context)
    assert result.event is Event.DONE
    return result.context


def step_of(context: RunContext) -> FoldStep:
    return context.steps[context.fold.index]


@pytest.mark.parametrize(
    "edit",
    [
        PlanEdit("page 1", keypoints={"near_left": (0.5, 0.25)}),
        PlanEdit("page 1", grasps={LEFT: (0.5, 0.25), GraspId.RIGHT: (0.1, -0.2)}),
        PlanEdit("terminal", variant="far_onto_near"),
        PlanEdit("page 1", other_arc=True),
    ],
)
def test_an_edit_can_be_written_and_read(edit: PlanEdit) -> None:
    assert PlanEdit.read(edit.text()) == edit and edit.in_words()


def test_a_moved_grasp_lands_at_the_mirror_image_of_its_new_place() -> None:
    """Its target keeps its distance from the mirror image: the tension of the plan."""
    edit = moved(LEFT, (0.03, -0.02))
    step = step_of(planned(with_plan_edit(asked(), edit)))
    np.testing.assert_allclose(step.grasps[LEFT].point, edit.grasps[LEFT])
    before, now = (s.targets[LEFT][:2] - s.line.reflect(s.grasps[LEFT].point) for s in (HALF, step))
    np.testing.assert_allclose(now, before, atol=1e-12)
    assert step.targets[LEFT][2] == HALF.targets[LEFT][2]
    np.testing.assert_array_equal(step.grasps[GraspId.RIGHT].point, HALF.grasps[GraspId.RIGHT].point)


def test_a_moved_key_point_moves_the_fold() -> None:
    name = next(iter(STATE.keypoints))
    place = STATE.keypoints[name] + 0.03
    context = planned(with_plan_edit(asked(), PlanEdit("page 1", keypoints={name: (place[0], place[1])})))
    assert context.plan is not None
    np.testing.assert_allclose(context.plan.flat.keypoints[name], place)
    assert not np.allclose(step_of(context).line.direction, HALF.line.direction)


def test_another_variant_can_be_chosen_in_every_fold() -> None:
    first = planned(with_plan_edit(asked(), PlanEdit("page 1", variant="right_onto_left")))
    assert [s.variant for s in first.steps] == ["right_onto_left", "far_onto_near"]
    second = context_with(first, index=1, edits=(PlanEdit("page 1", variant="near_onto_far"),))
    other = planned(second)
    assert [s.variant for s in other.steps] == ["right_onto_left", "near_onto_far"]
    assert other.steps[0] is first.steps[0], "folds that were made stay"


def test_a_grasp_of_another_variant_is_forgotten() -> None:
    context = with_plan_edit(asked(), moved(LEFT, (0.02, 0.0)))
    context = with_plan_edit(context, PlanEdit("page 1", variant="right_onto_left"))
    assert [edit.variant for edit in context.fold.edits] == ["right_onto_left"]


def test_another_arc_is_optimised_then_the_initial_one_then_the_first_again() -> None:
    edit, context, chosen = PlanEdit("page 1", other_arc=True), asked(), []
    for source in ("library", "optimised", "initial", "library"):
        attempt = context.fold.attempt
        assert attempt is not None
        context = context.with_attempt(replace(attempt, trajectory=replace_source(attempt.trajectory, source)))
        context = with_plan_edit(context, edit)
        chosen.append(context.fold.adjustments)
    assert chosen == [(Adjustment.OPTIMISE,), (Adjustment.PLAIN_ARC,), (), (Adjustment.OPTIMISE,)]


def replace_source(trajectory: Any, source: str) -> Any:
    return type(trajectory)(source=source)


@pytest.mark.parametrize(
    ("edit", "why"),
    [
        (PlanEdit("p", keypoints={"sleeve": (0.5, 0.0)}), "no key point sleeve"),
        (PlanEdit("p", keypoints={next(iter(STATE.keypoints)): (5.0, 0.0)}), "is the limit"),
        (moved(LEFT, (2.0, 0.0)), "not on the garment"),
        (PlanEdit("p", grasps={LEFT: tuple(HALF.line.point + 0.005 * HALF.line.normal)}), "from the fold line"),
        (PlanEdit("p", grasps={LEFT: tuple(HALF.line.reflect(HALF.grasps[LEFT].point))}), "from the fold line"),
        (PlanEdit("p", variant="inside_out"), "no variant inside_out"),
        (PlanEdit("p", variant=HALF.variant), "planned already"),
    ],
)  # fmt: skip
def test_impossible_edits_are_refused(edit: PlanEdit, why: str) -> None:
    assert why in (refusal(edit, asked()) or "")


def test_key_points_cannot_be_moved_after_the_first_fold() -> None:
    edit = PlanEdit("p", keypoints={next(iter(STATE.keypoints)): (0.5, 0.0)})
    assert "first fold only" in (refusal(edit, asked(index=1)) or "")
    assert refusal(moved(LEFT, (0.01, 0.01)), RunContext()) == "there is no plan of a fold that can be changed"


def test_the_journal_gets_the_edit_and_who_made_it() -> None:
    cell = FakeCell()
    workcell = fake_workcell(cell)
    edit = moved(LEFT, (0.02, 0.0))
    cell.at(0.2, lambda: workcell.commands.put(Event.EDIT, moved(LEFT, (2.0, 0.0))))
    cell.at(0.5, lambda: workcell.commands.put(Event.EDIT, edit))
    result = ask_approval(workcell, asked())
    assert result.event is Event.EDIT and cell.now >= 0.5, "the impossible edit was refused"
    assert result.record["edit"] == {"by": "page 1", "grasps_m": {"left": list(edit.grasps[LEFT])}}
    assert result.context.fold.edits == (edit,)
    assert cell.commands == [], "the arms get no command during a question"


def test_a_plan_that_the_edit_makes_impossible_is_made_again_without_it() -> None:
    context = with_plan_edit(asked(), moved(LEFT, (0.02, 0.0)))
    failure = Failure(FailureKind.UNREACHABLE, "no arm reaches the left grasp", "")
    result = choose_next(fake_workcell(FakeCell()), context.with_failure(failure), failure)
    fold = result.context.fold
    assert result.event is Event.PLAN_AGAIN and fold.edits == () and fold.refused_edit == failure.what
    np.testing.assert_array_equal(step_of(planned(result.context)).grasps[LEFT].point, HALF.grasps[LEFT].point)


def test_an_edited_step_without_edits_is_the_same() -> None:
    same = edited_step(HALF, ())
    assert all(same.grasps[i].point is HALF.grasps[i].point for i in GraspId)
