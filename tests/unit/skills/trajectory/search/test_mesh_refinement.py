"""Points of a garment keep their place on a finer mesh."""

from __future__ import annotations

import numpy as np
import pytest

from foldcell.cell.config.garments.garment_file import load_garment
from foldcell.skills.cloth.mesh import mesh_from_contour
from foldcell.skills.fold_plan.plan import plan_folds
from foldcell.skills.trajectory.search.problem import FoldProblem
from foldcell.skills.trajectory.search.robust import carried, refined


@pytest.mark.parametrize("name", ["medium_towel", "pants"])
def test_a_finer_mesh_has_the_place_of_the_coarse_one(name: str) -> None:
    """A turn and a slope are transferred exactly, on each layer. The finer mesh covers the same area with more
    vertices."""
    garment = load_garment(name)
    state = garment.flat_state(*garment.poses.middle)
    step = plan_folds(state, garment).unwrap()[0]
    mesh = mesh_from_contour(state.contour, 0.05, garment.layers)

    def place(rest, layer):  # type: ignore[no-untyped-def]
        x, y = rest.T
        return np.column_stack([0.8 * x - 0.6 * y, 0.6 * x + 0.8 * y, 0.3 * x - 0.1 * y + 0.01 * layer])

    where = place(mesh.rest, mesh.layer)
    problem = FoldProblem(step, mesh, where, garment.material, None, 0.35)  # type: ignore[arg-type]
    finer = refined(problem, 0.85)
    assert 1.2 < len(finer.mesh.rest) / len(mesh.rest) < 1.7
    assert finer.mesh.area.sum() == pytest.approx(mesh.area.sum(), rel=1e-3)
    flat = place(finer.mesh.rest, 0 * finer.mesh.layer)
    assert np.allclose(finer.positions[:, :2], flat[:, :2], atol=1e-9)
    above = finer.positions[:, 2] - flat[:, 2]
    assert np.abs(above[finer.mesh.layer == 0]).max() < 1e-9
    assert above.min() > -1e-9 and above.max() < 0.01 + 1e-9, "welded vertices are between the layers"
    assert finer.step is step and finer.target.shape == finer.positions.shape
    assert np.allclose(carried(mesh, where, mesh.rest, mesh.layer), where, atol=1e-9)
