"""Learning from a fold that was made: what it did against what was predicted, and what that says of the fabric.

What lies there is compared with what the simulation predicted. Where the two outlines agree nothing is to be
learned and nothing is computed. Where they do not, the fold is simulated again as it was executed on more and on
less slippery tables, and the friction moves towards the one that explains what is seen (calibration/identify.py):
by as much as was learned, within half and one and a half times what the garment file says. The next fold is looked
up, judged and optimised with it.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from calibration.identify import MaterialEstimate, Noise, identify_material, outline_residual, predict_candidates
from cell.executive.effects.planning import simulated_paths
from cell.hardware.workcell import Workcell
from cell.states.stages import Attempt, Plan
from robots.ports import Array
from skills.garments.garment import Garment
from skills.perception.inspection.inspect import Inspection
from skills.perception.rectification.table_view import TableView

__all__ = ["adapt"]

FACTORS = (0.5, 0.7, 1.0, 1.4)
"""Candidates of the friction, in units of what is believed."""


def adapt(
    cell: Workcell, index: int, plan: Plan, made: Attempt, seen: Inspection
) -> tuple[Garment, dict[str, object]]:
    """The garment with its material as this fold showed it to be, and figures for the record."""
    contour, view, noise = seen.contour, seen.view, Noise()
    garment, predicted = plan.garment, made.predicted
    if not cell.settings.optimiser.learn_friction or index + 1 >= len(plan.steps):  # no fold follows
        return garment, {}
    residual = outline_residual(contour, _as_seen(view, predicted.vertices), predicted.triangles)
    if residual < noise.sigma:
        return garment, {"outline_residual_m": residual}
    paths = simulated_paths(cell, made.motion)

    def learn() -> MaterialEstimate:
        candidates = predict_candidates(
            plan.mesh, plan.vertices, garment.material, paths, FACTORS, seen_as=lambda x: _as_seen(view, x)
        )
        return identify_material([contour], candidates, garment.material, noise)

    estimate = cell.compute(len(FACTORS) * cell.settings.computing.simulation_s, learn)
    material = estimate.update_of(garment.material, plan.nominal.material)
    before, after = garment.material.friction_static, material.friction_static
    cell.recorder.adapted(cell.ports.clock.now(), after, estimate.friction.learned)
    record: dict[str, object] = {
        "outline_residual_m": residual,
        "friction_before": before,
        "friction_estimate": estimate.friction.value,
        "friction_learned": estimate.friction.learned,
        "friction": after,
        "misfit_m": estimate.misfit,
    }
    return replace(garment, material=material), record


def _as_seen(view: TableView, vertices: Array) -> Array:
    """(n, 3) vertices where the camera sees them on the table: what stands high appears further out."""
    return np.column_stack([view.shadow_on_table(vertices), np.zeros(len(vertices))])
