"""Optimise the arcs of a garment's folds."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from foldcell.arguments import own_numeric_state, path, text, whole
from foldcell.cell.config.garments.garment_file import load_garment
from foldcell.cell.planning.plan_optimisation import StepOptimisation, optimise_plan
from foldcell.robots.errors import ConfigurationError, Failure
from foldcell.robots.ports import Array
from foldcell.settings import Settings, cell_settings
from foldcell.skills.trajectory.export import pose_rows


@dataclass(frozen=True, eq=False)
class OptimisedFold:
    """The arcs of one fold, for the flat garment in the middle of its pose range.

    step: number of the fold in the plan, from 1. control_points: 'left' and 'right' (only one of them for a fold
    with one hand) -> (k, 3) Bezier control points of the tool centre point [m], table frame (x forward, y left, z
    = 0 on the table), read-only. The arc follows a straight lift by lift_m [m]. tool_poses: the same keys ->
    (n, 8) poses over time from the grasp to the release: time [s], position [m], quaternion (scalar last) of the
    tool frame in the table frame; `foldcell.export` writes them into a file. duration_s: duration from grasp to
    release, without the lift [s]. dissimilarity_initial_m, dissimilarity_m: mean distance between the predicted
    and the ideal fold [m], with the paper's initial arcs and with these arcs. simulations: number of cloth
    simulations; failed_simulations: number of those that failed.

    failure: the reason why there are no arcs. In that case control_points and tool_poses are empty and duration_s
    is None.
    """

    garment: str
    name: str
    step: int
    method: str
    control_points: Mapping[str, Array]
    tool_poses: Mapping[str, Array]
    duration_s: float | None
    lift_m: float
    dissimilarity_initial_m: float
    dissimilarity_m: float
    simulations: int
    failed_simulations: int
    failure: Failure | None


@own_numeric_state
def optimise(
    garment: str | Path,
    step: int | None = None,
    *,
    method: str | None = None,
    budget: int | None = None,
    settings: Settings = None,
) -> tuple[OptimisedFold, ...]:
    """Optimise the folds of a garment's plan, in order. The first fold that fails is the last in the result.

    garment: a shipped name or a garment file. step: optimise only this fold, from 1; the folds before it use their
    initial arcs. method: 'initial' (one simulation), 'two_parameter', 'paper', 'default'. budget: number of
    simulations per fold. None for method or budget: the value of the settings.

    Raises ConfigurationError for an invalid argument or file.
    """
    step = None if step is None else whole(step, "step")
    budget = None if budget is None else whole(budget, "budget")
    method = None if method is None else text(method, "method")
    if budget is not None and budget < 1:
        raise ConfigurationError(f"a budget of {budget} simulations", "a fold takes 1 or more")
    checked = cell_settings(settings)
    loaded = load_garment(path(garment, "garment"), checked.surface)
    lift = checked.grasp.lift_height
    return tuple(_plain(loaded.name, fold, lift) for fold in optimise_plan(loaded, checked, step, method, budget))


def _plain(garment: str, fold: StepOptimisation, lift: float) -> OptimisedFold:
    found, notes = fold.outcome.value, fold.outcome.notes
    return OptimisedFold(
        garment=garment,
        name=fold.step.name,
        step=fold.step.index + 1,
        method=str(notes["method"]),
        control_points={i.value: points for i, points in found.control_points.items()} if found else {},
        tool_poses={i.value: pose_rows(path) for i, path in fold.paths.items()},
        duration_s=found.duration if found else None,
        lift_m=lift,
        dissimilarity_initial_m=float(notes["dissimilarity_initial_m"]),
        dissimilarity_m=float(notes["dissimilarity_m"]),
        simulations=int(notes["simulations"]),
        failed_simulations=int(notes["failed_simulations"]),
        failure=fold.outcome.failure,
    )
