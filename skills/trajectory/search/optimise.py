"""Optimisation of a fold's arcs for the paper's objective (objective.py), by the paper's method and by better
methods."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Executor, ThreadPoolExecutor
from dataclasses import dataclass, replace

import numpy as np

from foldcell.skills.cloth.mesh import ClothMesh
from foldcell.skills.cloth.pinch import PadGeometry
from foldcell.skills.cloth.predict import predict_fold
from foldcell.skills.garments.garment import Garment
from foldcell.skills.trajectory.arcs.bezier import PAPER_H, arc_controls
from foldcell.skills.trajectory.arcs.frame import FoldFrame, frames_of
from foldcell.skills.trajectory.arcs.paths import LIFT_HEIGHT, fold_duration, tool_paths
from foldcell.skills.trajectory.search.acceptance import (
    NEARLY,
    acceptance_limit,
    gains_as_promised,
    judge_prediction,
)
from foldcell.skills.trajectory.search.levenberg_marquardt import SecantOptions, secant_levenberg_marquardt
from foldcell.skills.trajectory.search.problem import (
    MAX_HEIGHT,
    Candidate,
    Controls,
    Evaluator,
    FoldProblem,
    Predictor,
)
from foldcell.skills.trajectory.search.robust import MARGIN, most_robust, simulations
from foldcell.skills.vocabulary import (
    Array,
    Failure,
    FailureKind,
    FoldStep,
    GraspId,
    GraspTrajectory,
    Material,
    Outcome,
    ToolPath,
)

Progress = Callable[[int, int, float], None]
"""Function called after each simulation with: simulations done, budget, best D so far [m]."""

Watch = Callable[[int, Candidate, Candidate], None]
"""Function called after each candidate with: simulations done, the candidate, the best candidate so far."""

HEIGHTS = (PAPER_H, 0.5, 0.7)
SKEWS = (0.0, 0.15, -0.15)
"""Heights and skews of the two-parameter method's grid, in units of the fold's distance. The first point of the
grid is the paper's initial arc."""

PROBES = ((1 / 3, 0.6, 2 / 3, 0.6), (0.0, 0.3, 1.0, 0.3))
"""Two arcs that test whether the choice of the arc matters at all. Each arc is given by four numbers, in units of
the fold's distance: position along the fold and height of the first inner control point, then the same of the
second. The first arc is high. The second arc rises and descends steeply and lays the cloth down from the crease to
the edge; no arc that is given by height and skew alone does this. If a better arc can gain much, at least one of
these two arcs gains part of it. If a folded stack opens again by itself, as under a second fold, all arcs give the
same result."""
FORMS = (
    ((0.483, 0.5, 0.817, 0.5), (-0.15, 0.5, 1.15, 0.3)),
    ((-0.07, 0.52, 0.98, 0.43), (0.183, 0.7, 0.517, 0.7), (0.15, 0.3, 0.85, 0.5)),
)
"""Further arcs, in the format of PROBES, for folds in which the choice of the arc matters. The second group is
simulated only if no arc is good yet. Each arc was the best or the second best for the first fold of some
garment."""

POLISH_DELTA = 0.05
"""Difference step of the polish (`_polish`) [m]. It is large because the simulated cost is rough at steps below
about 5 mm."""

ROUNDING = 1e-9
"""Arcs whose control points differ by less count as equal [m]."""

LEAST_POLISH = 3
"""A polish begins only if at least this number of simulations per variable is left; a third of them are used for
the first differences."""

PAPER_DELTAS = (0.1, 0.001)
"""Difference steps of the paper's method [m]. The paper states delta = 1e-1 without a unit. This is 10 cm if the
unit is the metre, and 1 mm if the unit is the centimetre, as in the paper's simulator. Both are tried."""

LOWEST, HIGHEST = 0.3, 1.2
BACK, BEYOND, OVERLAP = -0.2, 1.2, 0.6
"""Bounds of the inner control points, in units of the fold's distance: of their height (LOWEST, HIGHEST) and of
their position along the fold (BACK, BEYOND). LOWEST is necessary because a low arc drags the garment in the cell,
although it is short and, in a simulation with the correct friction, as good as any other arc. Arcs have to lead
forward. Therefore the first half of the points have a position of at most OVERLAP along the fold, the other points
one of at least (1 - OVERLAP)."""

FINALISTS = 3
"""Largest number of arcs that are simulated again to choose the most robust one. If the budget is small, fewer
arcs are simulated again. For five garments, a fourth arc was never chosen."""

GOOD = 0.002
"""If D of the plain arc (PLAIN_H) is at most this [m], the search for a better arc is omitted: a gain could not be
distinguished from noise."""

GAIN = 0.15
"""The search continues after the probes only if a probe has a D that is lower than the best D of the first arcs by
at least this share. The measured share is 0.2 to 0.8 in first folds for which a better arc exists, and at most
0.12 where no arc is better on a finer mesh."""

ALIKE = 0.0001
"""If the plain arc is good (GOOD), it is chosen unless D of the best arc is lower by at least this [m]."""

LUCK_SHARE = 0.1
"""If no probe gains enough (GAIN), the plain arc is chosen unless the first guess is better by at least this share
of D (or by MARGIN, if that is less). For the half fold of a medium towel, this rule chooses the first guess (1.8
mm) instead of the plain arc (2.1 mm). This fold and the quarter fold after it then end better in the simulated
cell."""

PLAIN_H = 0.45
"""Height of the two inner control points of the plain arc, as a fraction of the distance from grasp to release.
Any value from 0.33 to 0.5 gave the same results within the noise, in 8 to 10 randomly drawn worlds per setting."""


def optimise_fold(
    step: FoldStep,
    mesh: ClothMesh,
    positions: Array,
    material: Material,
    method: str = "default",
    budget: int | None = None,
    executor: Executor | None = None,
    threads: int = 2,
    progress: Progress | None = None,
    predict: Predictor | None = None,
    max_tool_speed: float = 0.35,
    start: Controls | None = None,
    promised: float | None = None,
    promised_initial: float | None = None,
    watch: Watch | None = None,
    lift_height: float = LIFT_HEIGHT,
    bending_factors: tuple[float, float] = (0.85, 1.15),
) -> Outcome[GraspTrajectory]:
    """Find the best arcs, one for each grasp of the step, to fold the mesh from `positions` (n, 3).

    method: 'initial' (h = 1/3, one simulation), 'two_parameter' (height and skew), 'paper' (all inner control
    points, secant Levenberg-Marquardt), 'default' (arcs of several heights, skews and steepnesses, a polish of
    variables that the arcs share, and the most robust of the best few). budget: number of simulations (default 1,
    25, 120, 25 in this order; where the choice of the arc does not matter, 'default' takes 2 to 4). predict: the
    simulation, default `ClothPredictor()`. lift_height: height of the straight lift before the arc [m];
    bending_factors: smallest and largest bending length for which 'default' judges its best arcs, relative to the
    material's.

    start: additional initial arcs (warm start) or, if `promised` is given, arcs from the library. promised: the D
    [m] that the library states for these arcs. Library arcs are simulated first, outside the budget. If their D is
    as low as promised (acceptance.py), they are the result: a look-up is an optimisation without iterations. The
    trajectory's `source` and the note `method` are then 'library'. promised_initial: D [m] of the first guess when
    the library arcs were optimised. If it is given and the library arcs miss their promise slightly, the first
    guess for the present fold is simulated too. The library arcs are then the result only if they gain as much
    over the first guess as in their optimisation.

    The result is deterministic: `threads` and `executor` change the speed only. Notes of the outcome:
    dissimilarity_m, dissimilarity_initial_m (absent for a look-up), simulations, failed_simulations, method. Fails
    with OPTIMISER_FAILED when every simulation failed, PREDICTION_POOR when the best fold is not accepted. Raises
    ValueError for an unknown method.
    """
    if method not in METHODS:
        raise ValueError(f"unknown method {method!r}; known: {', '.join(METHODS)}")
    search, default_budget = METHODS[method]
    problem = FoldProblem(
        step,
        mesh,
        positions,
        material,
        predict or ClothPredictor(),
        max_tool_speed,
        lift_height,
        bending_factors,
    )
    own = ThreadPoolExecutor(threads) if executor is None else None
    try:
        problem.prepare()
        total = (budget or default_budget) + (promised is not None)
        evaluator = Evaluator(problem, total, executor or own, progress, watch)  # type: ignore[arg-type]
        if start is not None and promised is not None:
            looked_up = evaluator.one(start)
            evaluator.first = None
            if looked_up.dissimilarity <= acceptance_limit(mesh.rest, promised):
                if promised_initial is None or looked_up.dissimilarity <= promised + NEARLY:
                    return _looked_up(evaluator, looked_up)
                evaluator.first = evaluator.one(arcs_of(problem.frames, PAPER_H))
                here = looked_up.dissimilarity, evaluator.first.dissimilarity
                if gains_as_promised(*here, promised, promised_initial):
                    return _looked_up(evaluator, looked_up)
        _begin(problem, evaluator, start if promised is None else None, plain=method == "default")
        search(problem, evaluator)
    finally:
        if own is not None:
            own.shutdown()
    return _outcome(problem, evaluator, method)


def _begin(problem: FoldProblem, evaluator: Evaluator, warm: Controls | None, *, plain: bool) -> None:
    """Simulate in parallel, within the budget: the first guess (unless it was simulated before), the warm start
    (if any) and the plain arc (if `plain` is set)."""
    arcs = [arcs_of(problem.frames, PAPER_H)] if evaluator.first is None else []
    least = len(arcs)
    arcs += [] if warm is None else [warm]
    arcs += [arcs_of(problem.frames, PLAIN_H)] if plain else []
    candidates = evaluator.many(arcs[: max(least, evaluator.left)])
    if plain and len(candidates) == len(arcs):
        evaluator.plain = candidates[-1]


@dataclass(frozen=True)
class ClothPredictor:
    """The cell's cloth simulation at its default settings, as an object that can be sent to another process.
    pads: of the hands; None: the default pads."""

    pads: PadGeometry | None = None

    def __call__(
        self, mesh: ClothMesh, positions: Array, material: Material, paths: Mapping[GraspId, ToolPath], /
    ) -> Array:
        return predict_fold(mesh, positions, material, paths, pads=self.pads).vertices


def _looked_up(evaluator: Evaluator, kept: Candidate) -> Outcome[GraspTrajectory]:
    """Return the outcome of library arcs that keep their promise."""
    trajectory = GraspTrajectory(
        kept.controls, kept.duration, "library", kept.cost, kept.dissimilarity, evaluator.count
    )
    notes: dict[str, float | int | str] = {
        "method": "library",
        "dissimilarity_m": kept.dissimilarity,
        "simulations": evaluator.count,
        "failed_simulations": evaluator.failed,
    }
    return Outcome(trajectory, notes=notes)


def _outcome(problem: FoldProblem, evaluator: Evaluator, method: str) -> Outcome[GraspTrajectory]:
    first, best = evaluator.first, evaluator.best
    assert first is not None and best is not None
    notes: dict[str, float | int | str] = {
        "method": method,
        "dissimilarity_initial_m": first.dissimilarity,
        "dissimilarity_m": best.dissimilarity,
        "simulations": evaluator.count,
        "failed_simulations": evaluator.failed,
    }
    if best.failed:
        what = f"none of {evaluator.count} simulations of step {problem.step.name} came to an end"
        hint = "look again; check the garment's material figures"
        return Outcome(failure=Failure(FailureKind.OPTIMISER_FAILED, what, hint, notes), notes=notes)
    failure = judge_prediction(problem.step.name, best.dissimilarity, acceptance_limit(problem.mesh.rest))
    if failure is not None:
        return Outcome(failure=replace(failure, values={**notes, **failure.values}), notes=notes)
    trajectory = GraspTrajectory(
        best.controls, best.duration, "optimised", best.cost, best.dissimilarity, evaluator.count
    )
    return Outcome(trajectory, notes=notes)


def _capped(frames: Mapping[GraspId, FoldFrame], height: float) -> float:
    """Return `height` of both inner control points, as a fraction of the fold's distance. It is reduced if the arc
    would rise above MAX_HEIGHT. The top of the arc lies at 3/4 of the inner points' height."""
    return min(height, MAX_HEIGHT / (0.75 * max(f.distance for f in frames.values())))


def arcs_of(frames: Mapping[GraspId, FoldFrame], height: float, skew: float = 0.0) -> Controls:
    """Return the arc of each grasp with a height and a skew of its inner control points, in units of the fold's
    distance. Both are limited, and the height is reduced for a long fold."""
    height = _capped(frames, float(np.clip(height, LOWEST, HIGHEST)))
    skew = float(np.clip(skew, -0.4, 0.4))
    return {s: arc_controls(f.start, f.end, height, skew) for s, f in frames.items()}


def plain_trajectory(step: FoldStep, garment: Garment, max_speed: float) -> GraspTrajectory:
    """Compute the plain arc (PLAIN_H, lower for a long fold) of each grasp. max_speed: of the tools
    [m/s]. The dissimilarity of the trajectory is not known."""
    controls = arcs_of(frames_of(step, garment.material.thickness), PLAIN_H)
    return GraspTrajectory(controls, fold_duration(controls, max_speed), "plain", 0.0, 0.0)


def plain_paths(step: FoldStep, garment: Garment) -> dict[GraspId, ToolPath]:
    """Compute the tool paths of the plain arc at the speed that the cloth allows."""
    speed = garment.max_tool_speed
    return tool_paths(plain_trajectory(step, garment, speed), step, speed)


def _search_initial(problem: FoldProblem, evaluator: Evaluator) -> None:
    """No search: the initial arc has been simulated."""


def _search_grid(problem: FoldProblem, evaluator: Evaluator) -> tuple[float, float]:
    """Simulate the points of the grid except the first one, the initial arc. Returns the best height and skew."""
    points = [(h, s) for h in HEIGHTS for s in SKEWS][1 : evaluator.left + 1]
    assert evaluator.first is not None
    candidates = evaluator.many([arcs_of(problem.frames, *p) for p in points])
    costs = [evaluator.first.cost, *(c.cost for c in candidates)]
    return [(PAPER_H, 0.0), *points][int(np.argmin(costs))]


def _search_two_parameter(problem: FoldProblem, evaluator: Evaluator) -> None:
    best = _search_grid(problem, evaluator)
    _polish(problem, evaluator, np.array(best), lambda x: arcs_of(problem.frames, x[0], x[1]))


def _search_default(problem: FoldProblem, evaluator: Evaluator) -> None:
    """Simulate two probes (PROBES), then arcs of other forms (FORMS), then polish four variables that the arcs of
    all grasps share: position along the fold and height of both inner points. The result is the most robust arc
    among the best few and the plain one.

    The search ends early if the plain arc is good or if the probes show that no arc is better. A good arc is not
    polished.
    """
    plain, first = evaluator.plain, evaluator.first
    if plain is None or first is None or plain.dissimilarity <= GOOD:
        _keep_plain(evaluator, ALIKE)
        return
    common = min(first, plain, key=lambda c: c.dissimilarity)
    evaluator.many([_shared(problem, np.array(x)) for x in PROBES[: evaluator.left]])
    assert evaluator.best is not None
    if evaluator.best.dissimilarity > (1.0 - GAIN) * common.dissimilarity:
        luck = min(MARGIN, LUCK_SHARE * plain.dissimilarity)
        evaluator.best = plain if plain.dissimilarity - common.dissimilarity < luck else common
        return
    finalists = FINALISTS
    while finalists > 0 and simulations(finalists) > evaluator.left - sum(map(len, FORMS)):
        finalists -= 1
    reserve = simulations(finalists)
    for k, lot in enumerate(FORMS):
        if k == 0 or evaluator.best.dissimilarity > GOOD:
            evaluator.many([_shared(problem, np.array(x)) for x in lot[: max(0, evaluator.left - reserve)]])
    if evaluator.best.dissimilarity > GOOD:
        inner = np.mean([problem.frames[s].normalise(c) for s, c in evaluator.best.controls.items()], axis=0)
        _polish(problem, evaluator, inner[:, [0, 2]].ravel(), lambda x: _shared(problem, x), reserve)
    if not reserve:
        _keep_plain(evaluator, MARGIN)
        return
    evaluator.best = most_robust(evaluator, plain, finalists)


def _keep_plain(evaluator: Evaluator, least: float) -> None:
    """Choose the plain arc, which is more robust, unless D of the best arc is lower by at least `least` [m]."""
    plain, best = evaluator.plain, evaluator.best
    if plain is not None and best is not None and not plain.failed:
        evaluator.best = plain if plain.dissimilarity - best.dissimilarity < least else best


def _shared(problem: FoldProblem, x: Array) -> Controls:
    """Return the arcs of all grasps for the shared variables x (2 (n - 1),): position along the fold and height of
    each inner point, in units of the fold's distance."""
    way, height = x.reshape(-1, 2).T
    early = np.arange(len(way)) < len(way) / 2
    way = np.where(early, np.clip(way, BACK, OVERLAP), np.clip(way, 1 - OVERLAP, BEYOND))
    height = np.clip(height, LOWEST, HIGHEST)
    height = height * min(1.0, _capped(problem.frames, float(height.max())) / height.max())
    inner = np.column_stack([way, np.zeros(len(way)), height])
    return {grasp_id: frame.denormalise(inner) for grasp_id, frame in problem.frames.items()}


def _polish(
    problem: FoldProblem,
    evaluator: Evaluator,
    x0: Array,
    controls: Callable[[Array], Controls],
    reserve: int = 0,
) -> None:
    """Search from x0 by secant Levenberg-Marquardt, within the rest of the budget.

    The arcs that x0 describes are simulated, unless this was done before. They may differ from the best arcs so
    far, because the variables cannot represent every set of arcs (for example, a warm start whose arcs differ
    between the grasps or move sideways).
    """
    known = _seen(evaluator, controls(x0))
    budget = evaluator.left - reserve - (known is None)
    if budget < LEAST_POLISH * len(x0):
        return
    distance = max(f.distance for f in problem.frames.values())
    options = SecantOptions(delta=POLISH_DELTA / distance, max_evaluations=budget)
    _secant(evaluator, x0, controls, options, known or evaluator.one(controls(x0)))


def _seen(evaluator: Evaluator, controls: Controls) -> Candidate | None:
    """Return the candidate that was already simulated with these arcs, up to rounding, or None."""

    def same(other: Candidate) -> bool:
        return all(np.allclose(q, other.controls[s], rtol=0.0, atol=ROUNDING) for s, q in controls.items())

    return next((c for c in evaluator.seen if same(c)), None)


def _search_paper(problem: FoldProblem, evaluator: Evaluator) -> None:
    """Search by the paper's method: all coordinates of all inner control points, starting from h = 1/3, for both
    interpretations of its delta."""
    assert evaluator.first is not None
    first = evaluator.first
    grasp_ids = list(first.controls)

    def controls(x: Array) -> Controls:
        inner = x.reshape(len(grasp_ids), -1, 3)
        out: Controls = {}
        for grasp_id, points in zip(grasp_ids, inner, strict=True):
            frame = problem.frames[grasp_id]
            z = np.clip(points[:, 2], 0.0, MAX_HEIGHT / 0.75)
            out[grasp_id] = np.vstack([frame.start, np.column_stack([points[:, :2], z]), frame.end])
        return out

    x0 = np.concatenate([first.controls[s][1:-1].ravel() for s in grasp_ids])
    for i, delta in enumerate(PAPER_DELTAS):
        share = evaluator.left // (len(PAPER_DELTAS) - i)
        _secant(evaluator, x0, controls, SecantOptions(delta=delta, max_evaluations=share), first)


def _secant(
    evaluator: Evaluator,
    x0: Array,
    controls: Callable[[Array], Controls],
    options: SecantOptions,
    known: Candidate,
) -> None:
    def many(points: Sequence[Array]) -> list[Array]:
        return [np.array([c.cost]) for c in evaluator.many([controls(x) for x in points])]

    secant_levenberg_marquardt(many, x0, np.array([known.cost]), options)


METHODS: dict[str, tuple[Callable[[FoldProblem, Evaluator], object], int]] = {
    "default": (_search_default, 25),
    "paper": (_search_paper, 120),
    "two_parameter": (_search_two_parameter, 25),
    "initial": (_search_initial, 1),
}
"""For each method: its search, and its default budget (number of simulations)."""
