"""How the folds of a plan are predicted one after another. The simulation is replaced by geometry."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from foldcell.cell.config.cell_settings import load_settings
from foldcell.cell.config.garments.garment_file import load_garment
from foldcell.cell.config.trajectory_library.library_file import load_library
from foldcell.cell.planning import plan_prediction
from foldcell.cell.planning.plan_prediction import PlanPrediction, predict_plan
from foldcell.robots.errors import ConfigurationError, Failure, FailureKind, InternalError
from foldcell.robots.ports import Array
from foldcell.skills.cloth.mesh import mesh_from_contour
from foldcell.skills.cloth.pinch import PinchReport
from foldcell.skills.fold_plan.folding import target_vertices
from foldcell.skills.fold_plan.ideal_heights import IdealFoldHeights
from foldcell.skills.trajectory.trajectory_library import Library
from foldcell.skills.vocabulary import FoldStep, GraspTrajectory, Outcome

TOWEL = load_garment("small_towel")
FIRST_VARIANTS = {step.name: step.variants[0].name for step in TOWEL.plan}
MESH = mesh_from_contour(TOWEL.flat_state(*TOWEL.poses.middle).contour, 0.04, TOWEL.layers)
IDEAL = tuple(IdealFoldHeights(length, 0.02, 0.03, 0.01) for length in (0.01, 0.03))


class Simulated:
    """Stands in for the arms' planning, the optimiser and the simulation, and notes what they were asked."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.starts: list[Array] = []
        self.arcs: list[str] = []
        self.planned: list[FoldStep] = []
        self.short: dict[str, float] = {}
        """Length by which the simulation leaves cloth short of its target, by source of the arc [m]."""
        self.layers: int | None = None
        self.error: Exception | None = None
        self.unreachable = False
        self.refused: Failure | None = None
        """Failure of the optimiser; `ended`: whether any of its simulations came to an end."""
        self.ended = True
        monkeypatch.setattr(plan_prediction, "CollisionChecker", lambda *_: None)
        monkeypatch.setattr(plan_prediction, "predictor_mesh", lambda *_: MESH)
        monkeypatch.setattr(plan_prediction, "plan_arms", self.plan_arms)
        monkeypatch.setattr(plan_prediction, "simulated_paths", lambda settings, motion: motion)
        monkeypatch.setattr(plan_prediction, "predict_motion", self.predict)
        monkeypatch.setattr(plan_prediction, "search_trajectory", self.search)
        arcs = plan_prediction.tool_paths

        def noted(trajectory: GraspTrajectory, step: FoldStep, speed: float) -> Any:
            self.arcs.append(trajectory.source)
            self.planned.append(step)
            return arcs(trajectory, step, speed)

        monkeypatch.setattr(plan_prediction, "tool_paths", noted)

    def plan_arms(self, *args: Any) -> Outcome[Any]:
        if self.unreachable:
            return Outcome(failure=Failure(FailureKind.UNREACHABLE, "the left hand reaches 0.9 m", "move it"))
        return Outcome(args[6])

    def predict(self, settings: Any, garment: Any, mesh: Any, vertices: Array, paths: Any) -> Any:
        if self.error:
            raise self.error
        self.starts.append(vertices)
        step = self.planned[-1]
        end = np.array(target_vertices(mesh, step.lines, garment.material))
        end[:, :2] += self.short.get(self.arcs[-1], 0.0) * np.sign(end[:, :1] - end[:, 0].mean())
        pinches = {i: PinchReport(5, self.layers or g.layers) for i, g in step.grasps.items()}
        return SimpleNamespace(vertices=end, pinches=pinches, dropped=())

    def search(self, settings: Any, garment: Any, step: FoldStep, *args: Any, watch: Any, **_: Any) -> Any:
        stored = plan_prediction.plain_trajectory(step, garment, 0.3)
        best = SimpleNamespace(
            controls=stored.control_points, duration=2.0, cost=1.0, dissimilarity=0.04, failed=not self.ended
        )
        watch(1, best, best)
        notes: dict[str, float | int | str] = {"simulations": 7}
        if self.refused is not None:
            return Outcome[GraspTrajectory](failure=self.refused, notes=notes)
        return Outcome(replace(stored, source="optimised", simulations=7), notes=notes)

    def predicted(self, library: Library | None = None, **options: Any) -> PlanPrediction:
        model: Any = SimpleNamespace(q_park=np.zeros(14), limits=lambda *_: None)
        lib = Library() if library is None else library
        return predict_plan(TOWEL, load_settings(), model, lib, FIRST_VARIANTS, IDEAL, **options)


@pytest.fixture
def simulated(monkeypatch: pytest.MonkeyPatch) -> Simulated:
    return Simulated(monkeypatch)


def test_each_fold_starts_from_the_predicted_shape_of_the_one_before(simulated: Simulated) -> None:
    found = simulated.predicted()
    assert found.good and [fold.step.name for fold in found.folds] == ["half", "quarter"]
    first, second = simulated.starts
    assert np.ptp(first[:, 2]) == 0.0 and second is found.folds[0].shape.vertices
    assert [fold.dissimilarity_m for fold in found.folds] == pytest.approx([0.0, 0.0])


def test_a_stored_arc_is_used_and_else_the_plain_one(simulated: Simulated) -> None:
    simulated.predicted(load_library(None).library)
    simulated.predicted()
    assert simulated.arcs == ["library", "library", "plain", "plain"]


def test_heights_are_judged_after_the_last_fold_only(simulated: Simulated) -> None:
    first, last = simulated.predicted().folds
    assert first.score is not None and first.score.ideal is None
    assert last.score is not None and last.score.flat is True


def test_a_fold_that_fails_with_a_plain_arc_is_optimised_as_in_a_run(simulated: Simulated) -> None:
    simulated.short = {"plain": 0.08}
    told: list[str] = []
    found = simulated.predicted(tell=told.append)
    assert found.good and found.optimised and len(told) == 1 and "as in a run" in told[0]
    assert simulated.arcs == ["plain", "optimised", "optimised"]
    assert [fold.trajectory.simulations for fold in found.folds if fold.trajectory] == [7, 7]


def test_the_first_fold_that_will_not_go_is_the_last_one(simulated: Simulated) -> None:
    simulated.short = {"plain": 0.08, "optimised": 0.08}
    found = simulated.predicted()
    assert not found.good and len(found.folds) == 1 and found.planned == 2 and found.folds[0].reasons


def test_a_grasp_that_takes_too_few_layers_is_not_optimised(simulated: Simulated) -> None:
    simulated.layers = 1
    found = simulated.predicted()
    assert not found.good and not found.optimised and [fold.good for fold in found.folds] == [True, False]
    assert "1 of 2 layers" in found.folds[-1].reasons[0].what


def test_arms_without_a_path_are_told_beside_the_simulation_of_the_arc(simulated: Simulated) -> None:
    simulated.unreachable = True
    (fold,) = simulated.predicted(optimise=True).folds
    assert "no path" in fold.reasons[0].what and "0.9 m" in fold.reasons[0].what and fold.score is not None


def test_a_failed_optimisation_gives_its_reason_and_the_shape_of_its_best_arc(simulated: Simulated) -> None:
    simulated.refused = Failure(FailureKind.PREDICTION_POOR, "misses its target", "a hint")
    (fold,) = simulated.predicted(optimise=True).folds
    assert fold.score is not None and [reason.what for reason in fold.reasons] == ["misses its target"]
    simulated.ended = False
    (fold,) = simulated.predicted(optimise=True).folds
    assert fold.score is None and fold.trajectory is None and np.isnan(fold.dissimilarity_m)


@pytest.mark.parametrize(
    ("error", "again"),
    [(ConfigurationError("the mesh is finer than the cloth is thick"), False), (InternalError("unstable"), True)],
)
def test_a_fold_that_cannot_be_simulated_says_why(simulated: Simulated, error: Exception, again: bool) -> None:
    simulated.error = error
    found = simulated.predicted()
    assert found.optimised is again, "a fabric that cannot be simulated is the same with every arc"
    assert str(error) in found.folds[0].reasons[0].what and found.folds[0].score is None
