"""The arcs that repair a fold: their ends, their shape, and the turn of the hand."""

from __future__ import annotations

import numpy as np
import pytest

from foldcell.cell.config.garments.garment_file import load_garment
from foldcell.skills.cloth.predict import predict_fold
from foldcell.skills.fold_plan.crease_mesh import predictor_mesh
from foldcell.skills.fold_plan.plan import plan_folds
from foldcell.skills.fold_plan.repair import RepairGoal, RepairPlan, plan_repair
from foldcell.skills.state_estimate.hypothesis import Interruption
from foldcell.skills.state_estimate.interrupted_fold import simulate_interruptions
from foldcell.skills.trajectory.arcs.bezier import arc_controls
from foldcell.skills.trajectory.arcs.frame import frames_of
from foldcell.skills.trajectory.arcs.paths import fold_paths, lifted
from foldcell.skills.trajectory.arcs.repair_arcs import repair_arcs, turned_paths
from foldcell.skills.trajectory.search.acceptance import acceptance_limit
from foldcell.skills.trajectory.search.objective import dissimilarity
from foldcell.skills.vocabulary import FoldLine, FoldStep, GarmentState, Grasp, GraspId

THICKNESS = 0.002
GRASP = GraspId.LEFT


def way_back(
    start: tuple[float, float], end: tuple[float, float], goal: RepairGoal = RepairGoal.UNDO
) -> RepairPlan:
    grasp = Grasp(np.array(start), 0.3, 1, 2 * THICKNESS)
    line = FoldLine(np.array([0.6, 0.0]), np.array([0.0, 1.0]))
    step = FoldStep("undo half", 0, line, (), {GRASP: grasp}, {GRASP: np.array([*end, 0.005])})
    return RepairPlan(goal, step, {GRASP: (0.3, 0.3)}, {}, THICKNESS)


def test_the_arcs_begin_in_the_grasped_layer_and_end_where_the_cloth_lay() -> None:
    fold = {GRASP: arc_controls(np.array([0.74, 0.1, 0.0]), np.array([0.46, 0.1, 0.007]))}
    for arcs in repair_arcs(fold, way_back((0.6, 0.08), (0.74, 0.1)), THICKNESS):
        assert arcs[GRASP][0] == pytest.approx([0.6, 0.08, 1.5 * THICKNESS]), "the middle of the upper layer"
        assert arcs[GRASP][-1] == pytest.approx([0.74, 0.1, 0.005])
        assert arcs[GRASP][1:-1, 2].min() > 0.03


def test_the_way_back_from_the_target_is_the_arc_of_the_fold_reversed() -> None:
    start, end = np.array([0.74, 0.1, 0.005]), np.array([0.46, 0.1, 1.5 * THICKNESS])
    inner = np.array([[0.70, 0.1, 0.08], [0.52, 0.1, 0.12]])  # not symmetric
    fold = np.vstack([start, inner, end])
    reverse, _ = repair_arcs({GRASP: fold}, way_back((0.46, 0.1), (0.74, 0.1)), THICKNESS)
    assert reverse[GRASP] == pytest.approx(fold[::-1])


def test_the_hand_turns_smoothly_from_the_heading_of_the_grasp_to_that_of_the_release() -> None:
    controls = {GRASP: arc_controls(np.array([0.5, 0.0, 0.0]), np.array([0.7, 0.0, 0.0]))}
    paths = fold_paths(controls, {GRASP: 0.2}, 2.0)
    heading = turned_paths(paths, {GRASP: (0.2, 1.0)})[GRASP].heading
    assert heading[[0, -1]] == pytest.approx([0.2, 1.0]) and (np.diff(heading) >= 0.0).all()
    assert np.interp(0.5, np.linspace(0, 1, len(heading)), heading) == pytest.approx(0.6, abs=0.01)
    assert abs(np.diff(heading)[[0, -1]]).max() < 0.1 * np.diff(heading).max(), "at rest at both ends"


def test_a_repair_from_where_the_cloth_was_taken_is_the_arc_of_the_fold() -> None:
    start, end = np.array([0.74, 0.1, 1.5 * THICKNESS]), np.array([0.46, 0.1, 0.005])
    fold = np.vstack([start, [0.70, 0.1, 0.08], [0.52, 0.1, 0.12], end])  # not symmetric
    like_the_fold, _ = repair_arcs(
        {GRASP: fold}, way_back((0.74, 0.1), (0.46, 0.1), RepairGoal.COMPLETE), THICKNESS
    )
    assert like_the_fold[GRASP] == pytest.approx(fold)


@pytest.mark.parametrize("goal", list(RepairGoal))
@pytest.mark.parametrize("end", [0.6, 0.85])
def test_a_simulated_fold_that_ends_early_is_repaired_by_the_upper_layer_alone(
    end: float, goal: RepairGoal
) -> None:
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
    controls = {grasp_id: arc_controls(f.start, f.end) for grasp_id, f in ends.items()}
    headings = {grasp_id: grasp.heading for grasp_id, grasp in step.grasps.items()}
    fold = {i: lifted(p, 0.03) for i, p in fold_paths(controls, headings, 3.0).items()}
    (now,) = simulate_interruptions(mesh, flat, material, fold, [Interruption(end=end)])

    aim = flat if goal is RepairGoal.UNDO else predict_fold(mesh, flat, material, fold).vertices
    repair = plan_repair(goal, mesh, flat, now, step, material.thickness).unwrap()
    left = []
    for arcs in repair_arcs(controls, repair, material.thickness):
        starts = {grasp_id: grasp.heading for grasp_id, grasp in repair.step.grasps.items()}
        paths = turned_paths(fold_paths(arcs, starts, 3.0), repair.headings)
        after = predict_fold(
            mesh, now, material, {i: lifted(p, 0.03) for i, p in paths.items()}, patches=repair.patches
        )
        assert {pinch.layers for pinch in after.pinches.values()} == {1}, "the layer below stays"
        left.append(dissimilarity(aim, after.vertices, mesh.triangles, mesh.area))
    amiss = dissimilarity(aim, now, mesh.triangles, mesh.area)
    assert min(left) < max(0.05 * amiss, 0.002)


def test_a_second_fold_whose_layers_are_lofty_is_undone_by_the_upper_two() -> None:
    """The predicted quarter of a small towel stands up at its edges. Simulated tips in the middle of the third
    layer would take a layer below, too, and drag the towel along."""
    garment = load_garment("small_towel")
    keypoints = {
        name: p + np.array([0.6, 0.0]) for name, p in zip(garment.keypoints, garment.template, strict=True)
    }
    state = GarmentState(garment.category, np.array(list(keypoints.values())), keypoints, 1.0)
    mesh, material = predictor_mesh(state, garment), garment.material
    shapes, controls = [mesh.lay_flat(material.thickness)], {}
    for step in (steps := plan_folds(state, garment).unwrap()):
        ends = frames_of(step, material.thickness)
        controls = {grasp_id: arc_controls(f.start, f.end) for grasp_id, f in ends.items()}
        headings = {grasp_id: grasp.heading for grasp_id, grasp in step.grasps.items()}
        fold = {i: lifted(p, 0.03) for i, p in fold_paths(controls, headings, 3.0).items()}
        shapes.append(predict_fold(mesh, shapes[-1], material, fold).vertices)
    _, before, now = shapes
    repair = plan_repair(RepairGoal.UNDO, mesh, before, now, steps[1], material.thickness).unwrap()
    left = []
    for arcs in repair_arcs(controls, repair, material.thickness):
        starts = {grasp_id: grasp.heading for grasp_id, grasp in repair.step.grasps.items()}
        paths = turned_paths(fold_paths(arcs, starts, 3.0), repair.headings)
        after = predict_fold(
            mesh, now, material, {i: lifted(p, 0.03) for i, p in paths.items()}, patches=repair.patches
        )
        left.append(dissimilarity(before, after.vertices, mesh.triangles, mesh.area))
    assert min(left) < 0.1 * acceptance_limit(mesh.rest)
