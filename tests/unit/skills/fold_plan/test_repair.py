"""The repair of a half-made fold, on sheets whose place is known exactly."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from foldcell.robots.errors import FailureKind
from foldcell.robots.ports import Array, frozen
from foldcell.skills.cloth.mesh import ClothMesh, mesh_from_contour
from foldcell.skills.cloth.pinch import PadGeometry, find_pinched
from foldcell.skills.fold_plan.plan import RELEASE_CLEARANCE, translate_plan
from foldcell.skills.fold_plan.repair import MISPLACED, RepairGoal, locate_grasp, plan_repair
from foldcell.skills.vocabulary import FoldLine, FoldStep, Grasp, GraspId, tool_rotation

THICKNESS = 0.002
SIZE = 0.3


def sheet(edge: float = 0.02) -> tuple[ClothMesh, Array]:
    """A square with its middle at (0.6, 0), flat on the table."""
    corners = np.array([[0.45, -0.15], [0.75, -0.15], [0.75, 0.15], [0.45, 0.15]])
    mesh = mesh_from_contour(corners, edge)
    return mesh, mesh.lay_flat(THICKNESS)


def step() -> FoldStep:
    """The far half is folded onto the near half by both hands; their held lines are parallel to y."""
    line = FoldLine(np.array([0.6, 0.0]), np.array([0.0, -1.0]))
    assert line.signed_distance(np.array([0.7, 0.0])) > 0.0
    grasps = {
        grasp_id: Grasp(np.array([0.738, y]), np.pi / 2, 1, THICKNESS)
        for grasp_id, y in ((GraspId.LEFT, 0.12), (GraspId.RIGHT, -0.12))
    }
    targets = {i: np.append(line.reflect(g.point), THICKNESS + 0.005) for i, g in grasps.items()}
    return FoldStep("half", 0, line, (), grasps, targets)


def folded_at(x: float, flat: Array, rows: Array | None = None) -> Array:
    """The sheet with what lies beyond `x` mirrored onto it, in the rows (n,) or everywhere."""
    moves = (flat[:, 0] > x) & (np.ones(len(flat), bool) if rows is None else rows)
    now = flat.copy()
    now[moves, 0] = 2.0 * x - flat[moves, 0]
    now[moves, 2] += THICKNESS
    return now


@pytest.mark.parametrize("angle", [0.0, 0.4, -1.1])
def test_a_grasp_is_found_where_a_motion_of_the_sheet_has_carried_it(angle: float) -> None:
    _, flat = sheet()
    grasp = step().grasps[GraspId.LEFT]
    c, s = np.cos(angle), np.sin(angle)
    R, shift = np.array([[c, -s], [s, c]]), np.array([0.02, -0.05])
    now = np.column_stack([flat[:, :2] @ R.T + shift, flat[:, 2] + 0.01])
    place, heading, length = locate_grasp(flat, now, grasp)
    assert place == pytest.approx(np.append(R @ grasp.point + shift, 0.5 * THICKNESS + 0.01), abs=1e-9)
    assert heading - grasp.heading == pytest.approx(angle, abs=1e-9) and length == pytest.approx(1.0)


def test_a_fold_that_ended_early_is_undone_by_both_hands_from_the_mirrored_edge() -> None:
    mesh, flat = sheet()
    undo = plan_repair(RepairGoal.UNDO, mesh, flat, folded_at(0.68, flat), step(), THICKNESS).unwrap()
    for grasp_id, planned in step().grasps.items():
        grasp, target = undo.step.grasps[grasp_id], undo.step.targets[grasp_id]
        assert grasp.point == pytest.approx([2 * 0.68 - 0.738, planned.point[1]], abs=1e-3)
        assert grasp.height == pytest.approx(2 * THICKNESS, abs=1e-4), "on top of the layer that stayed"
        assert grasp.layers == 1 and target[:2] == pytest.approx(planned.point)
        assert undo.headings[grasp_id] == pytest.approx((np.pi / 2, np.pi / 2), abs=1e-3)
        assert undo.step.line.signed_distance(np.array([0.5, 0.0])) > 0.0, "the way back is the other way round"


def test_a_hand_whose_cloth_lies_in_its_place_takes_no_part() -> None:
    mesh, flat = sheet()
    now = folded_at(0.66, flat, flat[:, 1] > 0.02)
    undo = plan_repair(RepairGoal.UNDO, mesh, flat, now, step(), THICKNESS).unwrap()
    assert set(undo.step.grasps) == {GraspId.LEFT} == set(undo.step.targets) == set(undo.headings)


def test_the_way_back_moves_with_a_displaced_garment() -> None:
    mesh, flat = sheet()
    offset = np.array([0.03, -0.02])
    moved = np.append(offset, 0.0)
    (displaced,) = translate_plan((step(),), offset)
    undo = plan_repair(
        RepairGoal.UNDO, mesh, flat + moved, folded_at(0.68, flat) + moved, displaced, THICKNESS
    ).unwrap()
    here = plan_repair(RepairGoal.UNDO, mesh, flat, folded_at(0.68, flat), step(), THICKNESS).unwrap()
    for grasp_id, grasp in undo.step.grasps.items():
        assert grasp.point == pytest.approx(here.step.grasps[grasp_id].point + offset)
        assert undo.step.targets[grasp_id] == pytest.approx(here.step.targets[grasp_id] + moved)


def test_cloth_under_other_cloth_or_rumpled_or_unmoved_is_not_grasped() -> None:
    mesh, flat = sheet()
    unmoved = plan_repair(
        RepairGoal.UNDO,
        mesh,
        flat,
        flat + np.array([0.5 * MISPLACED[RepairGoal.UNDO], 0.0, 0.0]),
        step(),
        THICKNESS,
    )
    assert unmoved.failure is not None and unmoved.failure.kind is FailureKind.HALF_FOLDED
    assert "where it should" in unmoved.failure.what
    covered = folded_at(0.68, flat)
    covered[flat[:, 0] < 0.68, 2] += 2 * THICKNESS  # the layer that stayed lies on top
    under = plan_repair(RepairGoal.UNDO, mesh, flat, covered, step(), THICKNESS)
    assert under.failure is not None and "under other cloth" in under.failure.what
    rumpled = folded_at(0.68, flat)
    moved = flat[:, 0] > 0.68
    rumpled[moved, 1] *= 0.3
    shrunk = plan_repair(RepairGoal.UNDO, mesh, flat, rumpled, step(), THICKNESS)
    assert shrunk.failure is not None and "rumpled" in shrunk.failure.what


def test_cloth_that_is_lofty_where_it_is_grasped_does_not_cover_itself() -> None:
    """Beside the crease of an earlier fold, the grasped cloth rises on one side of the grasp."""
    mesh, flat = sheet()
    lofty = folded_at(0.68, flat)
    grasp = step().grasps[GraspId.LEFT]
    near = (flat[:, 0] > 0.68) & (np.linalg.norm(flat[:, :2] - grasp.point, axis=1) < 0.05)
    lofty[near, 2] += 0.25 * np.abs(flat[near, 1] - grasp.point[1])
    undo = plan_repair(RepairGoal.UNDO, mesh, flat, lofty, step(), THICKNESS).unwrap()
    assert set(undo.step.grasps) == set(step().grasps)
    heights = [undo.step.grasps[grasp_id].height for grasp_id in GraspId]
    assert heights == pytest.approx([2 * THICKNESS] * 2), "the tips press it down to the layer below"


def test_the_layers_of_an_earlier_fold_are_grasped_together() -> None:
    """Two layers that moved together: the tips begin under the lower one."""
    mesh, flat = sheet()
    two = replace(step(), grasps={i: replace(g, layers=2, height=2 * THICKNESS) for i, g in step().grasps.items()})
    now = folded_at(0.68, flat)
    undo = plan_repair(RepairGoal.UNDO, mesh, frozen(flat), now, two, THICKNESS).unwrap()
    grasp = undo.step.grasps[GraspId.LEFT]
    assert grasp.layers == 2 and grasp.height == pytest.approx(3 * THICKNESS), "on the layer that stayed"


def test_a_simulated_hand_leaves_cloth_of_the_stack_that_stands_up_between_the_grasped_layers() -> None:
    """Beside the crease of an earlier fold, no height of the tips separates the two. A hand presses them flat."""
    mesh, flat = sheet(0.01)
    now = folded_at(0.68, flat)
    now[(flat[:, 0] < 0.68) & (flat[:, 1] > 0.125), 2] += 5.0 * THICKNESS
    plan = plan_repair(RepairGoal.UNDO, mesh, flat, now, step(), THICKNESS).unwrap()
    grasp, own = plan.step.grasps[GraspId.LEFT], plan.patches[GraspId.LEFT]
    turned = tool_rotation(np.array([grasp.heading]), np.zeros(1), np.zeros(1))[0]
    for raised in (0.0, 0.5, 0.9):
        at = np.append(grasp.point, (1.0 + raised) * THICKNESS)
        any_cloth = find_pinched(mesh, now, at, turned, PadGeometry(), THICKNESS)
        assert not own.contains(any_cloth.vertex, any_cloth.bary).all()
        found = find_pinched(mesh, now, at, turned, PadGeometry(), THICKNESS, own)
        assert found.layers == 1 and len(found.vertex) == PadGeometry().samples
        assert own.contains(found.vertex, found.bary).all()


@pytest.mark.parametrize("goal", list(RepairGoal))
@pytest.mark.parametrize("moved", [0.032, 0.036, 0.046])
def test_the_upper_layer_is_taken_alone_also_shortly_after_the_fold_began(moved: float, goal: RepairGoal) -> None:
    """The layer below it lay close to the grasp, too. Held with it, it would be dragged along."""
    mesh, flat = sheet()
    plan = plan_repair(goal, mesh, flat, folded_at(0.738 - 0.5 * moved, flat), step(), THICKNESS).unwrap()
    for grasp in plan.step.grasps.values():
        assert grasp.height == pytest.approx(2 * THICKNESS) and not grasp.whole_stack(THICKNESS)


@pytest.mark.parametrize("x", [0.64, 0.68])
def test_a_fold_that_ended_early_is_completed_from_the_mirrored_edge_to_its_target(x: float) -> None:
    mesh, flat = sheet()
    plan = plan_repair(RepairGoal.COMPLETE, mesh, flat, folded_at(x, flat), step(), THICKNESS).unwrap()
    for grasp_id, planned in step().grasps.items():
        grasp = plan.step.grasps[grasp_id]
        assert grasp.point == pytest.approx([2 * x - 0.738, planned.point[1]], abs=1e-3)
        assert grasp.height == pytest.approx(2 * THICKNESS, abs=1e-4) and grasp.layers == 1
        assert plan.step.targets[grasp_id] == pytest.approx(step().targets[grasp_id])
    assert plan.step.line.direction == pytest.approx(step().line.direction)


def test_only_the_corner_that_is_short_of_its_target_is_pulled_there() -> None:
    mesh, flat = sheet()
    now = folded_at(0.6, flat)
    short = (flat[:, 0] > 0.6) & (flat[:, 1] > 0.05)
    now[short, 0] += 2.0 * MISPLACED[RepairGoal.COMPLETE]
    plan = plan_repair(RepairGoal.COMPLETE, mesh, flat, now, step(), THICKNESS).unwrap()
    assert set(plan.step.grasps) == {GraspId.LEFT} == set(plan.headings)
    made = plan_repair(RepairGoal.COMPLETE, mesh, flat, folded_at(0.6, flat), step(), THICKNESS)
    assert made.failure is not None and "cannot be completed" in made.failure.what


def two_sheets(crease: FoldLine, upper_only: bool) -> tuple[ClothMesh, Array, Array, FoldStep]:
    """Two sheets that lie on each other, before and after a corner of the upper one, or of both, was turned back
    over a crease. Also returns the fold, whose hands take both."""
    lower, flat = sheet()
    mesh = replace(
        lower,
        rest=frozen(np.vstack([lower.rest, lower.rest])),
        triangles=frozen(np.vstack([lower.triangles, lower.triangles + len(flat)])),
    )
    before = np.vstack([flat, flat + np.array([0.0, 0.0, THICKNESS])])
    turned = (crease.signed_distance(before[:, :2]) > 0.0) & ((before[:, 2] > THICKNESS) | (not upper_only))
    now = before.copy()
    now[turned, :2] = crease.reflect(before[turned, :2])
    now[turned, 2] = 4 * THICKNESS - before[turned, 2]
    grasps = {i: replace(g, layers=2, height=2 * THICKNESS) for i, g in step().grasps.items()}
    return mesh, before, now, replace(step(), grasps=grasps)


def corner_crease(x: float) -> FoldLine:
    """A crease that cuts off the corner of the left grasp, from (x, 0.15) on."""
    return FoldLine(np.array([x, 0.15]), np.array([0.6, -0.8]))


@pytest.mark.parametrize("x", [0.66, 0.68, 0.69])
def test_a_flap_of_all_layers_is_repaired_with_all_layers(x: float) -> None:
    """Much of the cloth near the grasp has stayed beside a small flap, but not below it."""
    mesh, before, now, fold = two_sheets(corner_crease(x), upper_only=False)
    for goal in RepairGoal:
        planned = plan_repair(goal, mesh, before, now, fold, THICKNESS).unwrap().step.grasps[GraspId.LEFT]
        assert planned.layers == 2 and planned.height == pytest.approx(4 * THICKNESS)


def test_upper_layers_that_lie_turned_back_are_laid_back_and_not_carried_on() -> None:
    crease = corner_crease(0.69)
    mesh, before, now, fold = two_sheets(crease, upper_only=True)
    undo = plan_repair(RepairGoal.UNDO, mesh, before, now, fold, THICKNESS).unwrap()
    assert set(undo.step.grasps) == {GraspId.LEFT}, "the other corner lies in its place"
    grasp, target = undo.step.grasps[GraspId.LEFT], undo.step.targets[GraspId.LEFT]
    assert grasp.point == pytest.approx(crease.reflect(step().grasps[GraspId.LEFT].point), abs=0.003)
    assert grasp.layers == 1 and grasp.height == pytest.approx(3 * THICKNESS)
    assert target == pytest.approx([*step().grasps[GraspId.LEFT].point, THICKNESS + RELEASE_CLEARANCE])
    on = plan_repair(RepairGoal.COMPLETE, mesh, before, now, fold, THICKNESS)
    assert on.failure is not None and "only its upper layers have moved" in on.failure.what
