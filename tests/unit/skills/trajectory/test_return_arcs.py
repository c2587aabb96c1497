"""The arcs that carry cloth back: their ends, their shape, and the turn of the hand."""

from __future__ import annotations

import numpy as np
import pytest

from cell.config.garments.garment_file import load_garment
from skills.cloth.predict import predict_fold
from skills.perception.state_estimate.hypothesis import Interruption
from skills.perception.state_estimate.interrupted_fold import simulate_interruptions
from skills.planning.crease_mesh import predictor_mesh
from skills.planning.plan import plan_folds
from skills.planning.undo import plan_undo
from skills.trajectory.bezier import initial_controls
from skills.trajectory.frame import frames_of
from skills.trajectory.objective import dissimilarity
from skills.trajectory.paths import fold_paths, lifted
from skills.trajectory.return_arcs import return_arcs, turned_paths
from skills.vocabulary import FoldLine, FoldStep, GarmentState, Grasp, GraspId

THICKNESS = 0.002
GRASP = GraspId.LEFT


def way_back(start: tuple[float, float], end: tuple[float, float]) -> FoldStep:
    grasp = Grasp(np.array(start), 0.3, 1, 2 * THICKNESS)
    line = FoldLine(np.array([0.6, 0.0]), np.array([0.0, 1.0]))
    return FoldStep("undo half", 0, line, (), {GRASP: grasp}, {GRASP: np.array([*end, 0.005])})


def test_the_arcs_begin_in_the_grasped_layer_and_end_where_the_cloth_lay() -> None:
    fold = {GRASP: initial_controls(np.array([0.74, 0.1, 0.0]), np.array([0.46, 0.1, 0.007]))}
    for arcs in return_arcs(fold, way_back((0.6, 0.08), (0.74, 0.1)), THICKNESS):
        assert arcs[GRASP][0] == pytest.approx([0.6, 0.08, 1.5 * THICKNESS]), "the middle of the upper layer"
        assert arcs[GRASP][-1] == pytest.approx([0.74, 0.1, 0.005])
        assert arcs[GRASP][1:-1, 2].min() > 0.03


def test_the_way_back_from_the_target_is_the_arc_of_the_fold_reversed() -> None:
    start, end = np.array([0.74, 0.1, 0.005]), np.array([0.46, 0.1, 1.5 * THICKNESS])
    inner = np.array([[0.70, 0.1, 0.08], [0.52, 0.1, 0.12]])  # not symmetric
    fold = np.vstack([start, inner, end])
    reverse, _ = return_arcs({GRASP: fold}, way_back((0.46, 0.1), (0.74, 0.1)), THICKNESS)
    assert reverse[GRASP] == pytest.approx(fold[::-1])


def test_the_hand_turns_smoothly_from_the_heading_of_the_grasp_to_that_of_the_release() -> None:
    controls = {GRASP: initial_controls(np.array([0.5, 0.0, 0.0]), np.array([0.7, 0.0, 0.0]))}
    paths = fold_paths(controls, {GRASP: 0.2}, 2.0)
    heading = turned_paths(paths, {GRASP: (0.2, 1.0)})[GRASP].heading
    assert heading[[0, -1]] == pytest.approx([0.2, 1.0]) and (np.diff(heading) >= 0.0).all()
    assert np.interp(0.5, np.linspace(0, 1, len(heading)), heading) == pytest.approx(0.6, abs=0.01)
    assert abs(np.diff(heading)[[0, -1]]).max() < 0.1 * np.diff(heading).max(), "at rest at both ends"


@pytest.mark.parametrize("end", [0.6, 0.85])
def test_a_simulated_fold_that_ends_early_is_undone_by_the_upper_layer_alone(end: float) -> None:
    """The whole way: the hands open on the way, the cloth settles, and is carried back from where it lies then."""
    garment = load_garment("small_towel")
    keypoints = {
        name: p + np.array([0.6, 0.0]) for name, p in zip(garment.keypoints, garment.template, strict=True)
    }
    state = GarmentState(garment.category, np.array(list(keypoints.values())), keypoints, 1.0)
    step = plan_folds(state, garment).unwrap()[0]
    mesh, material = predictor_mesh(state, garment), garment.material
    flat = mesh.lay_flat(material.thickness)
    ends = frames_of(step, material.thickness)
    controls = {grasp_id: initial_controls(f.start, f.end) for grasp_id, f in ends.items()}
    headings = {grasp_id: grasp.heading for grasp_id, grasp in step.grasps.items()}
    fold = {i: lifted(p, 0.03) for i, p in fold_paths(controls, headings, 3.0).items()}
    (now,) = simulate_interruptions(mesh, flat, material, fold, [Interruption(end=end)])

    undo = plan_undo(mesh, flat, now, step, material.thickness).unwrap()
    for arcs in return_arcs(controls, undo.step, material.thickness):
        starts = {grasp_id: grasp.heading for grasp_id, grasp in undo.step.grasps.items()}
        back = turned_paths(fold_paths(arcs, starts, 3.0), undo.headings)
        after = predict_fold(mesh, now, material, {i: lifted(p, 0.03) for i, p in back.items()})
        assert {pinch.layers for pinch in after.pinches.values()} == {1}, "the layer below stays"
        moved = dissimilarity(flat, now, mesh.triangles, mesh.area)
        assert dissimilarity(flat, after.vertices, mesh.triangles, mesh.area) < 0.05 * moved
