"""Predict the folds of a garment's plan one after another, as a run would make them, and judge each."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from foldcell.cell.config.cell_settings import CellSettings
from foldcell.cell.planning.fold_judgement import Reason, claim_limits, judge_edges, judge_fold, judge_hands
from foldcell.cell.planning.fold_planning import (
    motion_rng,
    plan_arms,
    predict_motion,
    search_rng,
    search_trajectory,
    simulated_paths,
    stored_trajectory,
    tool_speed,
)
from foldcell.robots.errors import CellError, ConfigurationError
from foldcell.robots.model import RobotModel
from foldcell.robots.ports import Array
from foldcell.skills.cloth.mesh import ClothMesh
from foldcell.skills.fold_plan.crease_mesh import predictor_mesh
from foldcell.skills.fold_plan.folding import silhouette, target_vertices
from foldcell.skills.fold_plan.ideal_heights import IdealFoldHeights, ideal_fold_heights
from foldcell.skills.fold_plan.plan import plan_folds
from foldcell.skills.garments.garment import Garment
from foldcell.skills.motion.validation.collision import CollisionChecker
from foldcell.skills.scoring.alignment import FinalGarment
from foldcell.skills.scoring.score import keypoint_offsets, named_edge_pairs, score
from foldcell.skills.scoring.verdict import IdealHeights, Score
from foldcell.skills.trajectory.arcs.paths import lifted, tool_paths
from foldcell.skills.trajectory.search.acceptance import acceptance_limit
from foldcell.skills.trajectory.search.objective import dissimilarity
from foldcell.skills.trajectory.search.optimise import plain_trajectory
from foldcell.skills.trajectory.search.problem import Candidate
from foldcell.skills.trajectory.trajectory_library import Library
from foldcell.skills.vocabulary import FoldStep, GarmentState, GraspId, GraspTrajectory, PredictedShape, ToolPath

Progress = Callable[[int, int, str], None]
"""Called before and within each fold with: number done, their total, and what is computed."""

_FIGURES = "check the figures of the fabric in the garment file (`foldcell calibrate` measures them)"
SEARCHES = 2
"""Number of searches for the arms' motion. A run, too, searches again after a failed search."""


@dataclass(frozen=True, eq=False)
class PredictedFold:
    """One predicted fold. trajectory: its arcs, whose source is `library`, `plain` or `optimised`. shape: the
    garment after it; outline: (k, 2) of the garment after the ideal fold [m].

    dissimilarity_m: D of the shape from the ideal fold, limit_m: the largest D with which a run accepts it [m].
    score: figures and limits of the shape. If the simulation did not end, the score is None and D is NaN. The
    heights are judged after the last fold only. reasons: why the fold will fail; empty if it will succeed.
    wall_time_s: duration of the computation [s].
    """

    step: FoldStep
    trajectory: GraspTrajectory | None
    shape: PredictedShape
    outline: Array
    dissimilarity_m: float
    limit_m: float
    score: Score | None
    reasons: tuple[Reason, ...]
    wall_time_s: float

    @property
    def good(self) -> bool:
        return not self.reasons


@dataclass(frozen=True, eq=False)
class PlanPrediction:
    """The predicted folds, in order. The prediction ends at the first fold that will fail. planned: number of
    folds of the plan. optimised: true if each fold was optimised as in a run; false if it was only simulated along
    the library's arc or the plain arc."""

    folds: tuple[PredictedFold, ...]
    planned: int
    optimised: bool

    @property
    def good(self) -> bool:
        return len(self.folds) == self.planned and all(fold.good for fold in self.folds)


def predict_plan(
    garment: Garment,
    settings: CellSettings,
    model: RobotModel,
    library: Library,
    variants: Mapping[str, str],
    ideal: Sequence[IdealFoldHeights] = (),
    optimise: bool = False,
    begin: Callable[[], None] = lambda: None,
    progress: Progress = lambda done, total, remark: None,
    tell: Callable[[str], None] = lambda line: None,
) -> PlanPrediction:
    """Predict the folds of a flat garment in the middle of its poses. Each fold starts from the predicted shape of
    the fold before. The prediction ends at the first fold that will fail.

    Each fold is simulated once, along the arms' path for an arc. The arc comes from the library if the library has
    one for such a garment, else it is the plain arc. If a fold will fail and another arc may help, all folds are
    predicted again, and each is optimised as in a run. optimise: whether to optimise at once. variants: step name
    -> name of the variant. ideal: heights of the garment's ideal folds over the range of its fabric; if they are
    not known, those of its nominal fabric are computed. begin: called before each computation whose progress
    `progress` shows. tell: shows a line.

    Raises ConfigurationError if the plan cannot be made.
    """
    state = garment.flat_state(*garment.poses.middle)
    planned = plan_folds(state, garment, variants, pads=settings.gripper.pads)
    if planned.failure is not None:
        raise ConfigurationError(f"{garment.name}: {planned.failure.what}", planned.failure.hint)
    mesh = predictor_mesh(state, garment)
    shared = _Prediction(
        garment, settings, model, CollisionChecker(model, settings.table), library, state, mesh, planned.unwrap(),
        _IdealFold(garment, ideal, begin, progress), begin, progress,
    )  # fmt: skip
    found = shared.predicted(optimise)
    if found.good or optimise or not all(reason.arc for reason in found.folds[-1].reasons):
        return found
    last = found.folds[-1]
    tell(
        f"fold {last.step.index + 1} {last.step.name}: {last.reasons[0].what}; predicted again with optimised"
        " arcs, as in a run"
    )
    return shared.predicted(True)


@dataclass(eq=False)
class _IdealFold:
    """Heights of the ideal fold of the garment's nominal fabric, computed when they are first needed."""

    garment: Garment
    known: Sequence[IdealFoldHeights]
    begin: Callable[[], None]
    progress: Progress
    computed: list[IdealHeights] = field(default_factory=list)

    def heights(self) -> IdealHeights:
        """Raises CellError if the ideal fold cannot be simulated."""
        if not self.computed:
            self.computed.append(self._heights())
        return self.computed[0]

    def _heights(self) -> IdealHeights:
        bending = self.garment.material.bending_length
        if self.known:
            lengths = [h.bending_length for h in self.known]
            height, crease = (
                float(np.interp(bending, lengths, np.maximum.accumulate([getattr(h, name) for h in self.known])))
                for name in ("height", "crease_height")
            )
            return IdealHeights(height, crease)
        self.begin()
        self.progress(0, 1, "the ideal fold of this fabric, for the heights")
        found = ideal_fold_heights(self.garment, bending)
        return IdealHeights(found.height, found.crease_height)


@dataclass(frozen=True, eq=False)
class _Prediction:
    """Predicts the folds. It holds everything that all folds of one prediction share."""

    garment: Garment
    settings: CellSettings
    model: RobotModel
    checker: CollisionChecker
    library: Library
    state: GarmentState
    mesh: ClothMesh
    steps: tuple[FoldStep, ...]
    ideal: _IdealFold
    begin: Callable[[], None]
    progress: Progress

    def predicted(self, optimise: bool) -> PlanPrediction:
        vertices: Array = self.mesh.lay_flat(self.garment.material.thickness)
        folds: list[PredictedFold] = []
        self.begin()
        for step in self.steps:
            self.progress(step.index, len(self.steps), f"predicting fold {step.index + 1} {step.name}")
            folds.append(self._fold(step, vertices, optimise))
            vertices = folds[-1].shape.vertices
            if not folds[-1].good:
                break
        return PlanPrediction(tuple(folds), len(self.steps), optimise)

    def _fold(self, step: FoldStep, vertices: Array, optimise: bool) -> PredictedFold:
        began = time.monotonic()
        trajectory, reasons = self._optimised(step, vertices) if optimise else (self._at_hand(step), ())
        limit = acceptance_limit(self.mesh.rest)
        fold = PredictedFold(
            step, trajectory, self._shape(vertices), silhouette(step.lines, np.asarray(self.state.contour)),
            float("nan"), limit, None, reasons, 0.0,
        )  # fmt: skip
        if trajectory is not None:
            fold = self._simulated(fold, trajectory, vertices)
        return replace(fold, wall_time_s=time.monotonic() - began)

    def _at_hand(self, step: FoldStep) -> GraspTrajectory:
        """Return the library's arcs for the step, else its plain arcs."""
        use = self.settings.optimiser.use_library
        stored = stored_trajectory(self.settings, self.library, self.garment, step) if use else None
        return stored or plain_trajectory(step, self.garment, tool_speed(self.settings, self.garment))

    def _optimised(self, step: FoldStep, vertices: Array) -> tuple[GraspTrajectory | None, tuple[Reason, ...]]:
        """Return the arcs that a run would use. If no arcs are good enough, return the best arcs found and the
        reasons. If every simulation failed, the arcs are None."""
        settings, seen = self.settings.optimiser, list[Candidate]()
        use = settings.use_library
        found = stored_trajectory(self.settings, self.library, self.garment, step) if use else None
        self.begin()

        def show(done: int, budget: int, best: float) -> None:
            remark = f"simulations of fold {step.index + 1} {step.name}: best D {1e3 * best:.1f} mm"
            self.progress(done, budget, remark)

        outcome = search_trajectory(
            self.settings, self.garment, step, self.mesh, vertices, settings.method,
            None if settings.method == "initial" else settings.simulations, found, found is not None,
            progress=show, watch=lambda done, candidate, best: seen.append(best),
        )  # fmt: skip
        if outcome.failure is None:
            return outcome.unwrap(), ()
        reasons = (Reason(outcome.failure.what, outcome.failure.hint),)
        best = seen[-1]
        if best.failed:
            return None, reasons
        controls = best.controls
        return GraspTrajectory(
            controls, best.duration, "optimised", best.cost, best.dissimilarity, int(outcome.notes["simulations"])
        ), reasons  # fmt: skip

    def _simulated(self, fold: PredictedFold, trajectory: GraspTrajectory, vertices: Array) -> PredictedFold:
        """Simulate and judge the fold along the arms' motion, or along its arcs if the arms have no motion."""
        step, garment = fold.step, self.garment
        paths, unreached = self._paths(step, trajectory)
        last = step is self.steps[-1]
        try:
            prediction = predict_motion(self.settings, garment, self.mesh, vertices, paths)
            pairs = named_edge_pairs(garment.edge_pairs, self.state.keypoints) if last else ()
            final = FinalGarment(
                prediction.vertices, self.mesh.triangles, self.mesh.rest, step.lines, garment.material.thickness,
                pairs, self.state.keypoints,
            )  # fmt: skip
            limits = claim_limits(self.settings.inspection.claim_settings())
            seen, offsets = score(final, limits), keypoint_offsets(final)
        except CellError as e:
            fabric = isinstance(e, ConfigurationError)  # no other arc can help
            how = "this fabric cannot be simulated" if fabric else "its simulation comes to no end"
            reason = Reason(f"{how}: {e.what}", _FIGURES, arc=not fabric)
            return replace(fold, reasons=(*fold.reasons, *unreached, reason))
        apart = judge_edges(garment, step.lines, self.state.keypoints, limits.edges) if last else ()
        reasons = apart
        if last:
            try:
                seen = seen.with_ideal(self.ideal.heights(), limits)
            except CellError as e:
                what = f"not even an ideal fold of this fabric can be simulated: {e.what}"
                reasons = (*reasons, Reason(what, _FIGURES, arc=False))
        target = target_vertices(self.mesh, step.lines, garment.material)
        error = dissimilarity(target, prediction.vertices, self.mesh.triangles, self.mesh.area)
        judged = judge_fold(garment, step, self.state.keypoints, offsets, error, fold.limit_m, seen, not apart)
        found = (*unreached, *judge_hands(step, prediction), *reasons, *judged)
        return replace(
            fold, shape=self._shape(prediction.vertices), dissimilarity_m=error, score=seen,
            reasons=found or fold.reasons,
        )  # fmt: skip

    def _paths(
        self, step: FoldStep, trajectory: GraspTrajectory
    ) -> tuple[Mapping[GraspId, ToolPath], tuple[Reason, ...]]:
        """Return the tool paths of the arms' motion. If the arms have no motion, return the tool paths of the arcs
        and the reason."""
        settings, model = self.settings, self.model
        paths = tool_paths(trajectory, step, tool_speed(settings, self.garment))
        limits = model.limits(settings.motion.accelerations, settings.motion.velocity_scale)
        for search in range(SEARCHES):
            planned = plan_arms(
                settings, model, self.checker, limits, self.garment, step, paths, model.q_park,
                search_rng(motion_rng(), search),
            )  # fmt: skip
            if planned.failure is None:
                return simulated_paths(settings, planned.unwrap()), ()
        assert planned.failure is not None
        reason = Reason(f"the arms have no path along its arc: {planned.failure.what}", planned.failure.hint)
        return {i: lifted(path, settings.grasp.lift_height) for i, path in paths.items()}, (reason,)

    def _shape(self, vertices: Array) -> PredictedShape:
        return PredictedShape(vertices, self.mesh.triangles, self.mesh.rest)
