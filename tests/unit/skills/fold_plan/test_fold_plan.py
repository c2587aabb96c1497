"""Fold plans: grasps lie on the moving cloth and land where the fold moves them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st

from foldcell.cell.config.garments.garment_file import list_garments, load_garment
from foldcell.robots.errors import FailureKind
from foldcell.skills.cloth.pinch import PadGeometry
from foldcell.skills.fold_plan import folding
from foldcell.skills.fold_plan.folding import fold_points, fold_xy, silhouette
from foldcell.skills.fold_plan.plan import RELEASE_CLEARANCE, plan_folds, rigid_motion, translate_plan
from foldcell.skills.garments.garment import Garment
from foldcell.skills.vocabulary import GarmentState, GraspId

GARMENTS = {name: load_garment(name) for name in list_garments()}
PAD_HALF_WIDTH = 0.010
poses = st.tuples(st.floats(0.5, 0.7), st.floats(-0.1, 0.1), st.floats(-0.3, 0.3), st.floats(0.8, 1.2))


@pytest.mark.parametrize("name", GARMENTS)
@given(pose=poses)
@settings(max_examples=8)
def test_grasps_hold_cloth_and_land_where_the_fold_puts_them(name: str, pose: tuple[float, ...]) -> None:
    garment = GARMENTS[name]
    state = garment.flat_state(*pose)
    for step in plan_folds(state, garment).unwrap():
        now = shapely.Polygon(silhouette(step.earlier, state.contour))
        for i, grasp in step.grasps.items():
            held = grasp.point + PAD_HALF_WIDTH * np.outer([-1, 1], [np.cos(grasp.heading), np.sin(grasp.heading)])
            assert shapely.LineString(held).within(now)
            assert now.exterior.distance(shapely.Point(grasp.point)) < 0.031
            assert step.line.signed_distance(grasp.point) > 0.03
            past, apart = garment.plan[step.index].tension
            moved = step.targets[i][:2] - step.line.reflect(grasp.point)
            outwards = grasp.point - np.mean([g.point for g in step.grasps.values()], axis=0)
            assert np.isclose(moved @ -step.line.normal, past)
            expected = apart if len(step.grasps) == 2 else 0.0
            assert np.isclose((moved @ step.line.direction) * np.sign(outwards @ step.line.direction), expected)
            across = np.cos(grasp.heading) * step.line.normal[0] + np.sin(grasp.heading) * step.line.normal[1]
            turn = max(abs(g.turn) for v in garment.plan[step.index].variants for g in v.grasps)
            assert abs(across) <= np.sin(turn) + 1e-9, "the held line is parallel to the fold line"


@pytest.mark.parametrize("name", GARMENTS)
def test_every_variant_moves_its_key_points_onto_their_mirror_image(name: str) -> None:
    garment = GARMENTS[name]
    state = garment.flat_state(0.6, 0.0)
    for i, plan_step in enumerate(garment.plan):
        for variant in plan_step.variants:
            step = plan_folds(state, garment, {plan_step.name: variant.name}).unwrap()[i]
            for key in variant.moves:
                assert step.line.signed_distance(state.keypoints[key]) > 0


@pytest.mark.parametrize("name", GARMENTS)
def test_the_last_fold_brings_the_named_edges_together_with_the_stated_layers(name: str) -> None:
    garment = GARMENTS[name]
    state = garment.flat_state(0.6, 0.02, 0.1)
    lines = plan_folds(state, garment).unwrap()[-1].lines
    for (a, b), (c, d) in garment.edge_pairs:
        first, second = (np.linspace(state.keypoints[p], state.keypoints[q], 7) for p, q in ((a, b), (c, d)))
        assert np.allclose(fold_xy(lines, first), fold_xy(lines, second), atol=0.012)
    low, high = state.contour.min(axis=0), state.contour.max(axis=0)
    points = np.random.default_rng(3).uniform(low, high, (3000, 2))
    points = points[shapely.contains_xy(shapely.Polygon(state.contour), *points.T)]
    layers = [
        fold_points(lines, points, state.contour, np.full(len(points), sheet), garment.layers).layers.max()
        for sheet in range(garment.layers)
    ]
    assert max(layers) + 1 == garment.final_layers


def test_the_release_is_above_the_stack_at_the_target() -> None:
    garment = GARMENTS["medium_towel"]
    half, quarter = plan_folds(garment.flat_state(0.58, 0.0), garment).unwrap()
    t = garment.material.thickness
    assert [g.layers for g in half.grasps.values()] == [1, 1]
    assert [g.layers for g in quarter.grasps.values()] == [2, 2]
    assert all(z == pytest.approx(t + RELEASE_CLEARANCE) for _, _, z in half.targets.values())
    assert all(z == pytest.approx(2 * t + RELEASE_CLEARANCE) for _, _, z in quarter.targets.values())


def test_each_arm_takes_its_own_side_and_no_arm_gets_both_grasps() -> None:
    for name, garment in GARMENTS.items():
        for step in plan_folds(garment.flat_state(0.6, 0.0), garment).unwrap():
            assert set(step.grasps) <= {GraspId.LEFT, GraspId.RIGHT}
            assert len(step.grasps) == len(garment.plan[step.index].variants[0].grasps), name
    half, quarter = plan_folds(GARMENTS["large_towel"].flat_state(0.6, 0.0), GARMENTS["large_towel"]).unwrap()
    assert half.grasps[GraspId.LEFT].point[0] > half.grasps[GraspId.RIGHT].point[0] + 0.3, (
        "in line along x, the left arm takes the far grasp"
    )
    assert quarter.grasps[GraspId.LEFT].point[1] > quarter.grasps[GraspId.RIGHT].point[1] + 0.2, (
        "side by side, each arm takes its own side"
    )


def test_a_small_turn_of_the_garment_does_not_flip_the_heading() -> None:
    garment = GARMENTS["medium_towel"]
    for i in range(2):
        headings = [
            plan_folds(garment.flat_state(0.58, 0.0, a), garment).unwrap()[i].grasps[GraspId.LEFT].heading
            for a in np.linspace(-0.2, 0.2, 21)
        ]
        assert np.ptp(headings) == pytest.approx(0.4, abs=1e-9)


@given(
    st.tuples(st.floats(-0.1, 0.1), st.floats(-0.1, 0.1)),
    st.floats(-0.4, 0.4),
    st.tuples(st.floats(0.3, 0.8), st.floats(-0.2, 0.2)),
)
@settings(max_examples=25)
def test_a_moved_plan_equals_the_plan_of_the_moved_garment(
    offset: tuple[float, float], rotation: float, about: tuple[float, float]
) -> None:
    garment = GARMENTS["medium_towel"]
    state = garment.flat_state(0.58, 0.0)

    def move(xy: np.ndarray) -> np.ndarray:
        return rigid_motion(xy, np.array(offset), rotation, np.array(about))

    drifted = replace(
        state, contour=move(state.contour), keypoints={k: move(p) for k, p in state.keypoints.items()}
    )
    expected = plan_folds(drifted, garment).unwrap()
    steps = translate_plan(plan_folds(state, garment).unwrap(), np.array(offset), rotation, np.array(about))
    for a, b in zip(steps, expected, strict=True):
        assert np.allclose([*a.line.point, *a.line.direction], [*b.line.point, *b.line.direction], atol=1e-9)
        assert len(a.earlier) == len(b.earlier)
        for i in a.grasps:
            assert np.allclose(a.grasps[i].point, b.grasps[i].point, atol=1e-9)
            assert np.allclose(a.targets[i], b.targets[i], atol=1e-9)
            assert np.sin(a.grasps[i].heading - b.grasps[i].heading) == pytest.approx(0.0, abs=1e-9)


def test_a_garment_that_does_not_fit_its_plan_is_a_failure_with_a_reason() -> None:
    garment = GARMENTS["small_towel"]
    state = garment.flat_state(0.58, 0.0)
    other = plan_folds(replace(state, category="pants"), garment)
    assert other.failure is not None and other.failure.kind is FailureKind.CATEGORY_MISMATCH
    few = plan_folds(replace(state, keypoints={"near_left": np.zeros(2)}), garment)
    assert few.failure is not None and few.failure.kind is FailureKind.LOW_CONFIDENCE
    assert "far_left" in str(few.failure)
    flat = plan_folds(_collapsed(state, garment), garment)
    assert flat.failure is not None and flat.failure.kind is FailureKind.LOW_CONFIDENCE
    with pytest.raises(ValueError, match="left_onto_right"):
        plan_folds(state, garment, {"half": "inside_out"})


def _collapsed(state: GarmentState, garment: Garment) -> GarmentState:
    return replace(state, keypoints={name: np.array([0.5, 0.0]) for name in garment.keypoints})


@pytest.mark.long
@pytest.mark.parametrize("name", ["t_shirt", "long_sleeve_shirt_small"])
def test_a_shirt_can_be_folded_at_any_pose(name: str) -> None:
    """The fold lines pass through corners, and pieces touch in lines and points. Before, the geometry library
    failed at one of forty poses."""
    garment, rng = GARMENTS[name], np.random.default_rng(3)
    for _ in range(150):
        state = garment.flat_state(rng.uniform(0.55, 0.65), rng.uniform(-0.1, 0.1), rng.uniform(-0.2, 0.2))
        lines = plan_folds(state, garment).unwrap()[-1].lines
        whole = shapely.Polygon(state.contour).area
        pieces = folding._pieces(lines, shapely.Polygon(state.contour))
        assert sum(piece.area for piece in pieces.values()) == pytest.approx(whole, rel=1e-4)


def test_pads_that_open_far_beyond_the_folded_towel_find_no_second_layer_there() -> None:
    towel = GARMENTS["medium_towel"]
    state = towel.flat_state(0.6, 0.0)
    for pads, layers in ((None, 2), (PadGeometry(stroke=4.0), 1)):
        _, quarter = plan_folds(state, towel, pads=pads).unwrap()
        assert {grasp.layers for grasp in quarter.grasps.values()} == {layers}
