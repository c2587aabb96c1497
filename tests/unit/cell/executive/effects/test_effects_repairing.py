"""The plan of a repair, on a simulated towel whose fold ended early."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from cell.config.garments.garment_file import load_garment
from cell.executive.effects import EFFECTS, repairing
from cell.executive.effects.gripping import _goal
from cell.executive.effects.planning import _task
from cell.states.run_context import RunContext
from cell.states.transition_table import Effect, Event
from robots.errors import CellError, FailureKind
from robots.ports import Array
from skills.cloth.mesh import mesh_from_contour
from skills.perception.state_estimate.comparison import Fit
from skills.perception.state_estimate.estimate import StateEstimate
from skills.perception.state_estimate.hypothesis import FoldState, Hypothesis
from skills.planning.plan import plan_folds
from skills.trajectory.bezier import initial_controls
from skills.trajectory.frame import frames_of
from skills.vocabulary import Grasp, GraspTrajectory, PredictedShape
from tests.builders.contexts import context_with
from tests.fakes import FakeCell
from tests.workcells import fake_workcell

TOWEL = load_garment("small_towel")
THICKNESS = TOWEL.material.thickness
STATE = TOWEL.flat_state(*TOWEL.poses.middle)
HALF = plan_folds(STATE, TOWEL).unwrap()[0]
MESH = mesh_from_contour(STATE.contour, 0.03, TOWEL.layers)
FLAT = MESH.lay_flat(THICKNESS)
DRIFT = np.array([0.02, 0.01])


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
    found = StateEstimate(FoldState.HALF_WAY, 0.95, best, {}, (), 12, np.zeros((3, 2)))
    arcs = {i: initial_controls(f.start, f.end) for i, f in frames_of(HALF, THICKNESS).items()}
    return context_with(
        garment=TOWEL, steps=(HALF,), mesh=MESH, vertices=FLAT, step=HALF, estimate=found,
        trajectory=GraspTrajectory(arcs, 2.0, "optimised", 1.0, 0.004), touched=True,
        predicted=PredictedShape(FLAT, MESH.triangles, MESH.rest),
    )  # fmt: skip


def attempted(context: RunContext) -> RunContext:
    """The same context with the arcs in the attempt, too."""
    attempt: Any = context.fold.attempt
    return context.with_attempt(SimpleNamespace(**{**vars(attempt), "trajectory": context.fold.trajectory}))  # type: ignore[arg-type]


def test_the_repair_carries_the_cloth_from_where_it_lies_to_where_it_lay(monkeypatch: pytest.MonkeyPatch) -> None:
    tops = []

    def simulated(mesh: Any, positions: Array, material: Any, paths: Any, **_: Any) -> Any:
        tops.append(max(float(path.position[:, 2].max()) for path in paths.values()))
        return SimpleNamespace(vertices=FLAT + np.append(DRIFT, 0.01 * len(tops)))

    monkeypatch.setattr(repairing, "predict_fold", simulated)
    result = EFFECTS[Effect.PLAN_REPAIR](fake_workcell(FakeCell()), attempted(failed_fold(half_way())))
    repair = result.context.fold.repair
    assert result.event is Event.DONE and repair is not None and len(tops) == 2
    assert repair.trajectory.dissimilarity == pytest.approx(0.01), "the better one of two"
    assert repair.flat == pytest.approx(FLAT + np.append(DRIFT, 0.0))
    assert repair.vertices == pytest.approx(half_way() + np.append(DRIFT, 0.0))
    for grasp_id, grasp in HALF.grasps.items():
        assert repair.step.targets[grasp_id][:2] == pytest.approx(grasp.point + DRIFT)
        assert np.linalg.norm(repair.step.grasps[grasp_id].point - grasp.point - DRIFT) > 0.03
        assert repair.step.grasps[grasp_id].height == pytest.approx(2 * THICKNESS, rel=0.1)
    assert result.context.plan is not None and result.context.fold.trajectory is not None
    task = _task(result.context.fold, result.context.plan, result.context.fold.trajectory, 0.3)
    assert task.step is repair.step and task.vertices is repair.vertices and task.target is repair.flat
    assert set(task.paths) == set(repair.step.grasps)


@pytest.mark.parametrize(("shape", "why"), [(None, "not known"), (FLAT, "where it was taken")])
def test_a_fold_that_cannot_be_undone_says_why(shape: Array | None, why: str) -> None:
    result = EFFECTS[Effect.PLAN_REPAIR](fake_workcell(FakeCell()), attempted(failed_fold(shape)))
    failure = result.context.failure
    assert result.event is Event.FAILED and result.context.fold.repair is None
    assert failure is not None and failure.kind is FailureKind.HALF_FOLDED and why in failure.what


def test_arcs_whose_simulation_fails_are_the_last_choice(monkeypatch: pytest.MonkeyPatch) -> None:
    calls = []

    def simulated(*_: Any, **__: Any) -> Any:
        calls.append(1)
        if len(calls) == 1:
            raise CellError("the cloth is torn")
        return SimpleNamespace(vertices=FLAT)

    monkeypatch.setattr(repairing, "predict_fold", simulated)
    result = EFFECTS[Effect.PLAN_REPAIR](fake_workcell(FakeCell()), attempted(failed_fold(half_way())))
    repair = result.context.fold.repair
    assert repair is not None and np.isfinite(repair.trajectory.dissimilarity)


@pytest.mark.parametrize("table", [0.0, 0.0011, -0.0006])
def test_the_tips_stop_between_the_layers_to_be_held_and_those_below(table: float) -> None:
    """The hand's height is in error by what it felt the table at. Through the whole stack, the table ends it."""
    two, one = (Grasp(np.zeros(2), 0.0, layers, 2 * THICKNESS) for layers in (2, 1))
    upper = _goal(one, -0.02, True, THICKNESS, table)
    assert upper.stop == pytest.approx(1.5 * THICKNESS + table) and upper.through == 0.0
    whole = _goal(two, -0.02, True, THICKNESS, table)
    assert whole.stop is None and whole.through == pytest.approx(2 * THICKNESS) and whole.bottom < 0.0
