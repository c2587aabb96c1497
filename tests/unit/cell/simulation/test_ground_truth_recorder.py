"""The scorer uses the plan of the garment file that is folded."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import yaml

from foldcell.cell.config.garments.garment_file import load_garment, shipped_garment_path
from foldcell.cell.simulation.garment.cloth_body import BodyTraits
from foldcell.cell.simulation.scoring.ground_truth_recorder import GroundTruthRecorder
from foldcell.cell.simulation.truth import GarmentTruth
from foldcell.cell.view.recorder import Recorder
from foldcell.skills.cloth.mesh import mesh_from_contour
from foldcell.skills.fold_plan.folding import target_vertices
from foldcell.skills.fold_plan.plan import plan_folds


@pytest.mark.parametrize("name", ["mine", "small_towel"])
def test_a_user_garment_is_scored_by_its_own_plan(tmp_path: Path, name: str) -> None:
    """The plan has only one fold. Scored by the shipped plan, the towel would be off by half its size."""
    data = yaml.safe_load(shipped_garment_path("small_towel").read_text())
    data |= {"plan": data["plan"][:1], "edge_pairs": [[["far_left", "near_left"], ["far_right", "near_right"]]]}
    path = tmp_path / f"{name}.yaml"
    path.write_text(yaml.safe_dump(data, sort_keys=False))
    garment = load_garment(path)
    state = garment.flat_state(0.6, 0.0)
    mesh, (step,) = mesh_from_contour(state.contour, 0.03), plan_folds(state, garment).unwrap()
    folded = target_vertices(mesh, step.lines, garment.material)
    laid = GarmentTruth(
        garment.name, folded, mesh.rest, state.keypoints, (0.6, 0.0, 0.0), garment.material, 1,
        mesh, BodyTraits(), "mujoco"
    )  # fmt: skip
    truth: Any = SimpleNamespace(watch=lambda tell: None, now=lambda: SimpleNamespace(garment=laid))
    request: Any = SimpleNamespace(garment=str(path), settings=SimpleNamespace(surface="bare_table"))
    score = GroundTruthRecorder(truth, Recorder.silent(), request).score()
    assert score is not None and score.passed and score.layers == 2
    assert np.isclose(score.figures["drift_m"].value, 0.0, atol=1e-3)
