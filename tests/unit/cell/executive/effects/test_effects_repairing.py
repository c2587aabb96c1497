"""The plan of a repair, on a simulated towel whose fold ended early."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from foldcell.cell.config.garments.garment_file import load_garment
from foldcell.cell.executive.effects import EFFECTS
from foldcell.cell.executive.effects.grasping import HIGHEST, LOWEST, STOP, _goal
from foldcell.cell.executive.effects.planning import _task
from foldcell.cell.executive.effects.recovery import repairing
from foldcell.cell.states.run_context import RunContext
from foldcell.cell.states.transition_table import Effect, Event
from foldcell.robots.errors import CellError, Failure, FailureKind
from foldcell.robots.ports import Array
from foldcell.skills.cloth.mesh import mesh_from_contour
from foldcell.skills.fold_plan.folding import target_vertices
from foldcell.skills.fold_plan.plan import RELEASE_CLEARANCE, plan_folds
from foldcell.skills.fold_plan.repair import RepairGoal, ways_to_hold
from foldcell.skills.perception.inspection.moved_edge import MovedEdge
from foldcell.skills.state_estimate.comparison import Fit
from foldcell.skills.state_estimate.estimate import StateEstimate
from foldcell.skills.state_estimate.hypothesis import FoldState, Hypothesis, Interruption
from foldcell.skills.trajectory.arcs.bezier import arc_controls
from foldcell.skills.trajectory.arcs.frame import frames_of
from foldcell.skills.trajectory.search.acceptance import PROMISE_SLACK
from foldcell.skills.vocabulary import Grasp, GraspId, GraspTrajectory, PredictedShape
from tests.builders.contexts import context_with
from tests.fakes import FakeCell
from tests.inspections import a_claim, inspection
from tests.workcells import fake_workcell

TOWEL = load_garment("small_towel")
THICKNESS = TOWEL.material.thickness
STATE = TOWEL.flat_state(*TOWEL.poses.middle)
HALF = plan_folds(STATE, TOWEL).unwrap()[0]
MESH = mesh_from_contour(STATE.contour, 0.03, TOWEL.layers)
FLAT = MESH.lay_flat(THICKNESS)
DRIFT = np.array([0.02, 0.01])
FOLDED = target_vertices(MESH, HALF.lines, TOWEL.material)
PLANNED = 0.004
"""Dissimilarity with which the fold was planned [m]."""


def half_way() -> Array:
    """The towel with a quarter of it turned over."""
    line = HALF.line
    quarter = 0.5 * line.signed_distance(FLAT[:, :2]).max()
    beyond = line.signed_distance(FLAT[:, :2]) - quarter
    now = FLAT.copy()
    turned = beyond > 0.0
    now[turned, :2] -= 2.0 * np.outer(beyond[turned], line.normal)
    now[turned, 2] += THICKNESS
    return now


def failed_fold(shape: Array | None) -> RunContext:
    """The fold ended early; the garment was displaced by DRIFT, and is believed to have this shape."""
    best = None
    if shape is not None:
        hypothesis = Hypothesis(FoldState.HALF_WAY, PredictedShape(shape, MESH.triangles, MESH.rest))
        best = Fit(hypothesis, FLAT[:, :2].mean(axis=0), DRIFT, 0.0, np.zeros((3, 2)), 1.0, 9, 0.0)
    likely = dict.fromkeys(FoldState, 0.0) | {FoldState.HALF_WAY: 0.95}
    found = StateEstimate(FoldState.HALF_WAY, 0.95, best, likely, (), 12, np.zeros((3, 2)))
    arcs = {i: arc_controls(f.start, f.end) for i, f in frames_of(HALF, THICKNESS).items()}
    return context_with(
        garment=TOWEL, steps=(HALF,), mesh=MESH, vertices=FLAT, step=HALF, estimate=found,
        trajectory=GraspTrajectory(arcs, 2.0, "optimised", 1.0, PLANNED), touched=True,
        predicted=PredictedShape(FLAT, MESH.triangles, MESH.rest), dissimilarity_m=PLANNED,
    )  # fmt: skip


def attempted(context: RunContext) -> RunContext:
    """The same context with the arcs in the attempt, too."""
    attempt, trajectory = context.fold.attempt, context.fold.trajectory
    assert attempt is not None and trajectory is not None
    return context.with_attempt(replace(attempt, trajectory=trajectory))


def predicting(monkeypatch: pytest.MonkeyPatch, amiss: dict[RepairGoal, float]) -> None:
    """Let the simulation of each way end this far above its aim [m]; the second of two arcs ends twice as far."""
    calls: dict[RepairGoal, int] = {goal: 0 for goal in RepairGoal}

    def simulated(mesh: Any, positions: Array, material: Any, paths: Any, **_: Any) -> Any:
        release = next(iter(paths.values())).position[-1, :2]
        back = min(np.linalg.norm(release - grasp.point - DRIFT) for grasp in HALF.grasps.values()) < 1e-6
        goal = RepairGoal.UNDO if back else RepairGoal.COMPLETE
        calls[goal] += 1
        aim = FLAT if back else FOLDED
        return SimpleNamespace(vertices=aim + np.append(DRIFT, amiss[goal] * calls[goal]))

    monkeypatch.setattr(repairing, "predict_fold", simulated)


@pytest.mark.parametrize(
    ("short", "goal"), [(0.001, RepairGoal.COMPLETE), (PLANNED + PROMISE_SLACK + 0.001, RepairGoal.UNDO)]
)
def test_a_fold_is_completed_if_it_is_then_as_good_as_planned_and_undone_otherwise(
    monkeypatch: pytest.MonkeyPatch, short: float, goal: RepairGoal
) -> None:
    predicting(monkeypatch, {RepairGoal.COMPLETE: short, RepairGoal.UNDO: 0.002})
    result = EFFECTS[Effect.PLAN_REPAIR](fake_workcell(FakeCell()), attempted(failed_fold(half_way())))
    repair = result.context.fold.repair
    assert result.event is Event.DONE and repair is not None
    assert repair.plan.goal is goal and result.record["goal"] == goal.value
    assert repair.trajectory.dissimilarity == pytest.approx({RepairGoal.UNDO: 0.002}.get(goal, short)), (
        "of two arcs"
    )
    aim = FLAT if goal is RepairGoal.UNDO else FOLDED
    assert repair.target == pytest.approx(aim + np.append(DRIFT, 0.0))
    assert repair.vertices == pytest.approx(half_way() + np.append(DRIFT, 0.0))
    for grasp_id, grasp in HALF.grasps.items():
        there = grasp.point if goal is RepairGoal.UNDO else HALF.targets[grasp_id][:2]
        assert repair.plan.step.targets[grasp_id][:2] == pytest.approx(there + DRIFT)
        assert np.linalg.norm(repair.plan.step.grasps[grasp_id].point - grasp.point - DRIFT) > 0.03
        assert repair.plan.step.grasps[grasp_id].height == pytest.approx(2 * THICKNESS, rel=0.1)
    assert result.context.plan is not None and result.context.fold.trajectory is not None
    task = _task(result.context.fold, result.context.plan, result.context.fold.trajectory, 0.3)
    assert task.step is repair.plan.step and task.vertices is repair.vertices and task.target is repair.target
    assert set(task.paths) == set(repair.plan.step.grasps)
    assert task.promised == (None if goal is RepairGoal.UNDO else repair.trajectory.dissimilarity)


def test_cloth_is_laid_back_on_the_layers_below_whatever_thickness_was_measured(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The fold was planned with the stated thickness, its repair with the measured one."""
    predicting(monkeypatch, {RepairGoal.COMPLETE: np.inf, RepairGoal.UNDO: 0.0})
    context = attempted(context_with(failed_fold(half_way()), layer_thickness=0.8 * THICKNESS))
    repair = EFFECTS[Effect.PLAN_REPAIR](fake_workcell(FakeCell()), context).context.fold.repair
    assert repair is not None and repair.plan.thickness == pytest.approx(0.8 * THICKNESS)
    assert [target[2] for target in repair.plan.step.targets.values()] == pytest.approx([RELEASE_CLEARANCE] * 2)


@pytest.mark.parametrize(
    ("lag", "hands"),
    [(np.zeros(9), 2), (np.r_[0.05, 0.05, np.zeros(7)], 1), (np.r_[np.nan, np.zeros(8)], 1), (None, 1)],
)
def test_a_corner_that_was_seen_in_its_place_is_not_carried_on(
    monkeypatch: pytest.MonkeyPatch, lag: Array | None, hands: int
) -> None:
    """The estimate says that the left hand has lost its corner. lag: of the moved edge, as the inspection has seen
    it [m]; None: not at all. Seen in its place, the whole edge is undone; otherwise the corner is completed."""
    predicting(monkeypatch, {RepairGoal.COMPLETE: 0.0, RepairGoal.UNDO: 0.001})
    corner = np.linalg.norm(FOLDED[:, :2] - HALF.targets[GraspId.LEFT][:2], axis=1) < 0.06
    dropped = FOLDED - np.outer(corner, [*(0.1 * HALF.line.normal), 0.0])
    context = attempted(failed_fold(dropped))
    found = context.fold.estimate
    assert found is not None and found.best is not None and context.fold.attempt is not None
    lost = replace(found.best.hypothesis, interruption=Interruption({GraspId.LEFT: 0.9}))
    shape = PredictedShape(FOLDED, MESH.triangles, MESH.rest)
    folded = replace(found.best, hypothesis=Hypothesis(FoldState.AFTER, shape))
    found = replace(found, best=replace(found.best, hypothesis=lost), as_folded=folded)
    seen = inspection(edge=None if lag is None else MovedEdge(lag, THICKNESS))
    context = replace(context, fold=replace(context.fold, estimate=found))
    attempt = replace(context.fold.attempt, inspection=seen)
    result = EFFECTS[Effect.PLAN_REPAIR](fake_workcell(FakeCell()), context.with_attempt(attempt))
    repair = result.context.fold.repair
    assert repair is not None and len(repair.plan.step.grasps) == hands
    assert repair.plan.goal is (RepairGoal.UNDO if hands == 2 else RepairGoal.COMPLETE)


def test_a_repair_that_would_not_bring_the_garment_nearer_to_its_aim_is_not_begun(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    now = float(np.linalg.norm(half_way() - FOLDED, axis=1).mean())
    predicting(monkeypatch, dict.fromkeys(RepairGoal, 2.0 * now))
    result = EFFECTS[Effect.PLAN_REPAIR](fake_workcell(FakeCell()), attempted(failed_fold(half_way())))
    assert result.event is Event.FAILED and "nearer to its aim" in result.context.failure.what
    assert result.context.fold.repair is None


def test_a_fold_that_was_not_begun_is_completed_only_if_it_cannot_be_undone(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    predicting(monkeypatch, {RepairGoal.COMPLETE: 0.1, RepairGoal.UNDO: 0.0})
    result = EFFECTS[Effect.PLAN_REPAIR](fake_workcell(FakeCell()), attempted(failed_fold(FLAT)))
    repair = result.context.fold.repair
    assert repair is not None and repair.plan.goal is RepairGoal.COMPLETE, "motion planning judges its prediction"


def test_a_fold_that_was_to_be_completed_before_is_undone(monkeypatch: pytest.MonkeyPatch) -> None:
    context = attempted(failed_fold(half_way()))
    for goal in (RepairGoal.COMPLETE, RepairGoal.UNDO, RepairGoal.UNDO):
        predicting(monkeypatch, {RepairGoal.COMPLETE: 0.0, RepairGoal.UNDO: 0.01})
        context = EFFECTS[Effect.PLAN_REPAIR](fake_workcell(FakeCell()), context).context
        assert context.fold.repair is not None and context.fold.repair.plan.goal is goal
        context = replace(context, fold=replace(context.fold, repair=None))


@pytest.mark.parametrize(
    ("good", "words", "hands"),
    [
        (0, "", 2),
        (1, "further from the edge", 2),
        (2, "nearer to each other", 2),
        (3, "alone", 1),
        (4, "alone", 1),
    ],
)
def test_a_repair_that_is_predicted_to_miss_is_sought_in_other_ways(
    good: int, words: str, hands: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The good way number `good` leaves the garment in its place. No more ways than needed are simulated."""
    seen: list[tuple[Any, ...]] = []

    def simulated(mesh: Any, positions: Array, material: Any, paths: Any, **_: Any) -> Any:
        way = tuple(sorted((i.value, *np.round(p.position[0, :2], 3)) for i, p in paths.items()))
        if way not in seen:
            seen.append(way)
        return SimpleNamespace(vertices=FLAT + np.append(DRIFT, 0.0 if len(seen) > good else 0.2))

    monkeypatch.setattr(repairing, "predict_fold", simulated)
    context = attempted(failed_fold(half_way()))
    tried = replace(context, fold=replace(context.fold, tried=(RepairGoal.COMPLETE,)))
    result = EFFECTS[Effect.PLAN_REPAIR](fake_workcell(FakeCell()), tried)
    repair = result.context.fold.repair
    assert repair is not None and repair.plan.goal is RepairGoal.UNDO and len(seen) == good + 1
    assert words in str(result.record.get("held", "")) and bool(words) == ("held" in result.record)
    assert len(repair.plan.step.grasps) == hands
    assert repair.trajectory.dissimilarity == pytest.approx(0.0, abs=1e-6)


def test_each_way_to_hold_the_cloth_carries_it_where_the_fold_does() -> None:
    """Each grasp and its target are mirror images at the fold line."""
    ways = dict(ways_to_hold(HALF))
    assert len(ways) == 5 and ways[""] is HALF
    edge = max(HALF.line.signed_distance(g.point[None])[0] for g in HALF.grasps.values())
    for words, step in ways.items():
        for grasp_id, grasp in step.grasps.items():
            moved = grasp.point - HALF.grasps[grasp_id].point
            target = step.targets[grasp_id][:2] - HALF.targets[grasp_id][:2]
            mirrored = moved - 2.0 * (moved @ HALF.line.normal) * HALF.line.normal
            assert target == pytest.approx(mirrored), words
            assert HALF.line.signed_distance(grasp.point[None])[0] <= edge + 1e-9


def test_a_fold_that_cannot_be_repaired_says_why() -> None:
    result = EFFECTS[Effect.PLAN_REPAIR](fake_workcell(FakeCell()), attempted(failed_fold(None)))
    failure = result.context.failure
    assert result.event is Event.FAILED and result.context.fold.repair is None
    assert failure is not None and failure.kind is FailureKind.HALF_FOLDED and "not known" in failure.what


def test_a_repair_that_cannot_be_planned_is_not_planned_again_from_the_same_estimate() -> None:
    covered = half_way()
    covered[covered[:, 2] < 1.5 * THICKNESS, 2] += 2 * THICKNESS  # the layer that stayed lies on top
    cell = fake_workcell(FakeCell())
    half = Failure(FailureKind.HALF_FOLDED, "the fold is half made")
    context = attempted(failed_fold(covered)).with_failure(half).with_failure(half)
    assert EFFECTS[Effect.CHOOSE_RECOVERY](cell, context).event is Event.REPAIR
    result = EFFECTS[Effect.PLAN_REPAIR](cell, context)
    assert result.context.failure is not None and "under other cloth" in result.context.failure.what
    assert EFFECTS[Effect.CHOOSE_RECOVERY](cell, result.context).event is Event.GIVE_UP


@pytest.mark.parametrize("goal", list(RepairGoal))
def test_a_refused_fold_counts_as_repaired_only_when_the_hands_have_carried_its_cloth(
    monkeypatch: pytest.MonkeyPatch, goal: RepairGoal
) -> None:
    """The motion of the repair may not be found. The hands had carried the fold itself."""
    predicting(monkeypatch, {RepairGoal.COMPLETE: 0.1 * (goal is RepairGoal.UNDO), RepairGoal.UNDO: 0.0})
    refused = context_with(attempted(failed_fold(half_way())), carried=True)
    fold = EFFECTS[Effect.PLAN_REPAIR](fake_workcell(FakeCell()), refused).context.fold
    assert fold.repair is not None and fold.repair.plan.goal is goal and not fold.carried
    after = fold.after_repair()
    assert after.uncertain and after.attempt is not None and not after.attempt.repaired


@pytest.mark.parametrize("goal", list(RepairGoal))
@pytest.mark.parametrize("carried", [True, False])
def test_a_completed_fold_is_inspected_where_the_garment_was_found_and_any_other_is_estimated_again(
    monkeypatch: pytest.MonkeyPatch, goal: RepairGoal, carried: bool
) -> None:
    poor = {RepairGoal.COMPLETE: 0.0 if goal is RepairGoal.COMPLETE else 0.1, RepairGoal.UNDO: 0.0}
    predicting(monkeypatch, poor)
    refused = context_with(
        attempted(failed_fold(half_way())), carried=True, inspection=inspection(), claim=a_claim(),
        pressed=(inspection(),), press_tries=1, unpressed=True,
    )  # fmt: skip
    context = EFFECTS[Effect.PLAN_REPAIR](fake_workcell(FakeCell()), refused).context
    failed, repair = context.fold.attempt, context.fold.repair
    assert failed is not None and repair is not None
    shape = PredictedShape(FOLDED + np.append(DRIFT, 0.0), MESH.triangles, MESH.rest)
    pictures = (FakeCell().ports().camera.capture(),)
    motion: Any = SimpleNamespace(fold=SimpleNamespace(duration=3.5))
    performed = replace(
        failed, predicted=shape, carried=carried, dissimilarity_m=0.003, pictures=pictures, motion=motion
    )
    after = replace(context.fold, attempt=performed).after_repair()
    completed = carried and goal is RepairGoal.COMPLETE
    assert after.repair is None and after.estimate is None and after.attempt is not None
    assert after.uncertain != completed and after.attempt.repaired == completed
    assert after.attempt.inspection is None and after.attempt.claim is None, "the cloth has moved since"
    assert not (after.attempt.pressed or after.attempt.press_tries or after.attempt.unpressed)
    if completed:
        assert after.attempt.predicted.vertices == pytest.approx(FOLDED), (
            "the inspection measures the displacement"
        )
        assert after.attempt.dissimilarity_m == 0.003 and after.attempt.step is failed.step
        assert after.attempt.pictures is pictures, "the report shows the motion that made the fold"
        assert after.attempt.carrying_s == 3.5
    else:
        assert after.attempt.predicted is failed.predicted


@pytest.mark.parametrize(("failing", "goal"), [(1, RepairGoal.COMPLETE), (2, RepairGoal.UNDO), (20, None)])
def test_arcs_whose_simulation_fails_are_not_chosen(
    monkeypatch: pytest.MonkeyPatch, failing: int, goal: RepairGoal | None
) -> None:
    """Two arcs that complete the fold are simulated first, then two that undo it; then the same for each of four
    other ways to hold the cloth."""
    calls = []

    def simulated(*_: Any, **__: Any) -> Any:
        calls.append(1)
        if len(calls) <= failing:
            raise CellError("the cloth is torn")
        return SimpleNamespace(vertices=(FOLDED if len(calls) <= 2 else FLAT) + np.append(DRIFT, 0.0))

    monkeypatch.setattr(repairing, "predict_fold", simulated)
    result = EFFECTS[Effect.PLAN_REPAIR](fake_workcell(FakeCell()), attempted(failed_fold(half_way())))
    repair, failure = result.context.fold.repair, result.context.failure
    assert (None if repair is None else repair.plan.goal) is goal
    assert (failure is None) == (goal is not None) and (failure is None or "simulation fails" in failure.what)


@pytest.mark.parametrize("table", [0.0, 0.0011, -0.0006])
def test_the_tips_stop_between_the_layers_to_be_held_and_those_below(table: float) -> None:
    """The hand's height is in error by what it felt the table at. Through the whole stack, the table ends it."""
    two, one = (Grasp(np.zeros(2), 0.0, layers, 2 * THICKNESS) for layers in (2, 1))
    upper = _goal(one, -0.02, True, THICKNESS, table)
    assert upper.stop == pytest.approx((1.0 + STOP) * THICKNESS + table)
    assert upper.through == pytest.approx((1.0 - STOP) * THICKNESS), "no touch but a hard one ends it before"
    whole = _goal(two, -0.02, True, THICKNESS, table)
    assert whole.stop is None and whole.through == pytest.approx(2 * THICKNESS) and whole.bottom < 0.0


def test_recoveries_shift_where_the_tips_stop_within_bounds() -> None:
    three_below = Grasp(np.zeros(2), 0.0, 1, 4 * THICKNESS)
    stops = [_goal(three_below, -0.02, True, THICKNESS, 0.0, shift).stop for shift in (-9.0, -1.0, 0.0, 0.25, 9.0)]
    expected = [LOWEST, 2.0 + STOP, 3.0 + STOP, 3.25 + STOP, 3.0 + HIGHEST]
    assert stops == pytest.approx(np.array(expected) * THICKNESS)
