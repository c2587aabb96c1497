"""Learns the fabric's friction from a fold: compares the observed with the predicted outline.

If the two outlines agree, there is nothing to learn and nothing is computed. If they differ, the executed fold is
simulated again with several friction coefficients, and the friction estimate moves towards the coefficient that
explains the observed outline (calibration/identify.py). The estimate stays between 0.5 and 1.5 times the value in
the garment file. The next fold uses it for the library look-up, the optimisation and the prediction.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from foldcell.calibration.identify import (
    SIGMA,
    FrictionEstimate,
    identify_friction,
    outline_residual,
    predict_candidates,
)
from foldcell.cell.hardware.workcell import Workcell
from foldcell.cell.planning.fold_planning import simulated_paths
from foldcell.cell.states.stages import Attempt, Plan
from foldcell.robots.ports import Array
from foldcell.skills.garments.garment import Garment
from foldcell.skills.perception.inspection.result import Inspection
from foldcell.skills.perception.rectification.table_view import TableView

FACTORS = (0.5, 0.7, 1.0, 1.4)
"""Friction coefficients to simulate, as multiples of the present estimate."""


def adapt(
    cell: Workcell, index: int, plan: Plan, attempt: Attempt, inspection: Inspection
) -> tuple[Garment, dict[str, object]]:
    """Return the garment with the friction learned from this fold, and figures for the journal. If learning is
    disabled or no fold remains, the garment is unchanged."""
    contour, view = inspection.contour, inspection.view
    garment, predicted = plan.garment, attempt.predicted
    if not cell.settings.optimiser.learn_friction or index + 1 >= len(plan.steps):  # no fold remains
        return garment, {}
    residual = outline_residual(contour, _on_table(view, predicted.vertices), predicted.triangles)
    if residual < SIGMA:
        return garment, {"outline_residual_m": residual}
    paths = simulated_paths(cell.settings, attempt.motion)

    def learn() -> FrictionEstimate:
        candidates = predict_candidates(
            plan.mesh, plan.vertices, garment.material, paths, FACTORS, seen_as=lambda x: _on_table(view, x),
            pads=cell.settings.gripper.pads,
        )  # fmt: skip
        return identify_friction(contour, candidates, garment.material)

    estimate = cell.compute(len(FACTORS) * cell.settings.computing.simulation_s, learn)
    material = estimate.update_of(garment.material, plan.nominal.material)
    before, after = garment.material.friction_static, material.friction_static
    cell.recorder.adapted(cell.ports.clock.now(), after, estimate.learned)
    record: dict[str, object] = {
        "outline_residual_m": residual,
        "friction_before": before,
        "friction_estimate": estimate.friction,
        "friction_learned": estimate.learned,
        "friction": after,
        "misfit_m": estimate.misfit,
    }
    return replace(garment, material=material), record


def _on_table(view: TableView, vertices: Array) -> Array:
    """Project vertices (n, 3) onto the table along the camera's rays. Returns (n, 3), table frame [m]."""
    return np.column_stack([view.shadow_on_table(vertices), np.zeros(len(vertices))])
