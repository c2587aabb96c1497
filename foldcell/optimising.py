"""The arcs of a garment's folds, optimised."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from foldcell.settings import Settings, cell_settings

if TYPE_CHECKING:
    from cell.campaigns.plan_optimisation import StepOptimisation
    from robots.errors import Failure
    from robots.ports import Array

__all__ = ["OptimisedFold", "optimise"]


@dataclass(frozen=True, eq=False)
class OptimisedFold:
    """The arcs of one fold, for the garment flat in the middle of where it may lie.

    step: its number in the plan, from 1. control_points: 'left' and 'right' (a fold with one hand has one) ->
    (k, 3) Bezier control points of the tool centre point [m], table frame (x forward, y left, z = 0 on the table),
    after the straight lift by lift_m [m]; read-only. duration_s: from grasp to release, without the lift.
    dissimilarity_initial_m, dissimilarity_m: mean distance of the predicted from the wanted shape [m], by the
    paper's first guess and by these arcs. simulations: of the cloth, of them failed_simulations came to no end.

    failure: why there are no arcs; control_points is empty and duration_s None then.
    """

    name: str
    step: int
    method: str
    control_points: Mapping[str, Array]
    duration_s: float | None
    lift_m: float
    dissimilarity_initial_m: float
    dissimilarity_m: float
    simulations: int
    failed_simulations: int
    failure: Failure | None


def optimise(
    garment: str | Path,
    step: int | None = None,
    *,
    method: str | None = None,
    budget: int | None = None,
    settings: Settings = None,
) -> tuple[OptimisedFold, ...]:
    """Optimise the folds of a garment's plan, in order; the first that fails is the last.

    garment: a shipped name or a garment file. step: only this fold, from 1; those before it are made by their
    initial arcs. method: 'initial' (one simulation), 'two_parameter', 'paper', 'default'. budget: simulations of
    one fold. method and budget are those of the settings where they are None.

    Raises ConfigurationError for an argument or a file that is wrong.
    """
    from cell.campaigns.plan_optimisation import optimise_plan
    from cell.config.garments.garment_file import load_garment
    from robots.errors import ConfigurationError

    if budget is not None and budget < 1:
        raise ConfigurationError(f"a budget of {budget} simulations", "a fold takes 1 or more")
    checked = cell_settings(settings)
    loaded = load_garment(garment, checked.surface)
    lift = checked.grasp.lift_height
    return tuple(_plain(fold, lift) for fold in optimise_plan(loaded, checked, step, method, budget))


def _plain(fold: StepOptimisation, lift: float) -> OptimisedFold:
    found, notes = fold.outcome.value, fold.outcome.notes
    return OptimisedFold(
        name=fold.step.name,
        step=fold.step.index + 1,
        method=str(notes["method"]),
        control_points={i.value: points for i, points in found.control_points.items()} if found else {},
        duration_s=found.duration if found else None,
        lift_m=lift,
        dissimilarity_initial_m=float(notes["dissimilarity_initial_m"]),
        dissimilarity_m=float(notes["dissimilarity_m"]),
        simulations=int(notes["simulations"]),
        failed_simulations=int(notes["failed_simulations"]),
        failure=fold.outcome.failure,
    )
