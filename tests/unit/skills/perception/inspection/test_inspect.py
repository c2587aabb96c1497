import functools
from dataclasses import replace

import numpy as np
import pytest

from foldcell.robots.errors import FailureKind
from foldcell.skills.perception.inspection.diagnosis import beyond_limits, diagnose
from foldcell.skills.perception.inspection.figures import left_behind
from foldcell.skills.perception.inspection.moved_edge import MovedEdge
from foldcell.skills.perception.inspection.predicted_view import draw_shape
from foldcell.skills.perception.inspection.target_view import FoldTarget
from foldcell.skills.perception.rectification.table_view import TableView
from foldcell.skills.vocabulary import FoldLine, FoldStep, Grasp, GraspId, PredictedShape
from tests.builders.shipped_settings import INSPECTION, inspect
from tests.inspections import grid_triangles, on_table
from tests.scenes import TABLE, Scene, camera, empty, place, render

# A towel of 0.40 x 0.60 m folded over its middle, left half onto right half. The crease is the left edge.
HALF = place([[0.2, 0.15], [-0.2, 0.15], [-0.2, -0.15], [0.2, -0.15]], 0.6, 0.0, 0.05)
HEIGHT = 0.004


def mesh(quad, z, n=16):
    u, w = np.meshgrid(np.linspace(0, 1, n), np.linspace(0, 1, n), indexing="ij")
    p = quad[1] + np.multiply.outer(u, quad[0] - quad[1]) + np.multiply.outer(w, quad[2] - quad[1])
    vertices = np.dstack([p, np.full((n, n), z)]).reshape(-1, 3)
    return PredictedShape(vertices, grid_triangles((n, n)), vertices[:, :2].copy())


PREDICTED = mesh(HALF, HEIGHT)
STEP = FoldStep(
    "half",
    0,
    FoldLine(HALF[0], (HALF[1] - HALF[0]) / np.linalg.norm(HALF[1] - HALF[0])),
    (),
    {},
    {GraspId.LEFT: np.r_[HALF[3], 0.006], GraspId.RIGHT: np.r_[HALF[2], 0.006]},
)
SAGGED = np.array(
    [*HALF[:3]]
    + [
        HALF[2] + u * (HALF[3] - HALF[2]) + 0.045 * np.sin(np.pi * u) * np.array([0.0, 1.0])
        for u in np.linspace(0.1, 0.9, 9)
    ]
    + [HALF[3]]
)
SHORT = np.array(
    [HALF[0], HALF[1], HALF[2], HALF[2] + 0.55 * (HALF[3] - HALF[2]), HALF[3] + 0.35 * (HALF[0] - HALF[3])]
)
HANGING = HALF[3] + np.array([[0.0, 0.02], [-0.02, -0.06], [-0.08, -0.05], [-0.08, 0.02]])


BACK = FoldLine(HALF[0], (HALF[0] - HALF[1]) / np.linalg.norm(HALF[0] - HALF[1]))
GRASPS = {i: Grasp(HALF[k] + (0.0, 0.3), 0.0, 1, 0.003) for k, i in enumerate((GraspId.LEFT, GraspId.RIGHT))}
GRASPED = replace(STEP, line=BACK, grasps=GRASPS)
"""The fold with its grasps, over the line in the opposite direction."""


@functools.cache
def bare():
    return empty(Scene(seed=4))


def look(polygons, bumps=(), thickness=HEIGHT, step=STEP):
    scene = Scene(seed=4, polygons=list(polygons), bumps=list(bumps), thickness=thickness, wobble=0.001)
    return inspect(render(scene), camera(), TABLE, bare(), PREDICTED, step)


def layered(apart, up=0.0):
    """The prediction with a second layer `apart` [m] below it, both `up` [m] higher."""
    vertices, count = PREDICTED.vertices + np.array([0.0, 0.0, up]), len(PREDICTED.vertices)
    return PredictedShape(
        np.vstack([vertices - np.array([0.0, 0.0, apart]), vertices]),
        np.vstack([PREDICTED.triangles, PREDICTED.triangles + count]).astype(np.int32),
        np.vstack([PREDICTED.material, PREDICTED.material]),
    )


@pytest.mark.parametrize(
    ("polygons", "named"),
    [
        ([HALF], ""),
        ([SAGGED], "the outline is"),
        ([SHORT], "a target lacks"),
        ([HALF + np.array([0.04, 0.0])], "as a whole"),
    ],
)
def test_only_figures_beyond_their_limit_are_reported(polygons, named):
    seen = look(polygons).unwrap()
    beyond = beyond_limits(seen, INSPECTION)
    assert bool(beyond) == (seen.diagnosis is not None)
    assert named in ", ".join(beyond)


def test_a_fold_as_predicted_is_accepted():
    seen = look([HALF]).unwrap()
    assert seen.accepted and seen.confidence > 0.8
    assert seen.iou > 0.97 and seen.drift_m < 0.002 and abs(seen.extra_height_m) < 0.002


@pytest.mark.parametrize("thickness", [HEIGHT, 3.0 * HEIGHT])
def test_the_height_of_the_stack_is_measured(thickness):
    assert look([HALF], thickness=thickness).unwrap().height_m == pytest.approx(thickness, abs=0.002)


def test_a_pile_at_the_crease_does_not_count_as_the_height_of_the_stack():
    along = HALF[1] - HALF[0]
    bumps = [(*(HALF[0] + u * along), 0.015, 0.030) for u in (0.3, 0.5, 0.7)]
    assert look([HALF], bumps).unwrap().height_m == pytest.approx(HEIGHT, abs=0.002)


@pytest.mark.parametrize(("shift", "turn"), [((0.036, 0.048), 0.0), ((0.0, 0.02), 8.0)])
def test_drift_is_measured_and_diagnosed(shift, turn):
    moved = place(HALF - (0.6, 0.0), 0.6 + shift[0], shift[1], np.deg2rad(turn))
    seen = look([moved]).unwrap()
    assert seen.diagnosis is FailureKind.DRIFT
    assert np.allclose(seen.drift, shift, atol=0.002)
    assert np.rad2deg(seen.drift_rad) == pytest.approx(turn, abs=0.3)
    assert seen.iou_aligned > 0.97 > seen.iou
    c, sn = np.cos(seen.drift_rad), np.sin(seen.drift_rad)
    again = (HALF - seen.drift_about) @ np.array([[c, sn], [-sn, c]]) + seen.drift_about + seen.drift
    np.testing.assert_allclose(again, moved, atol=0.003)


@pytest.mark.parametrize(
    ("polygons", "bumps", "thickness", "kind"),
    [
        ([HALF], [(0.6, -0.05, 0.02, 0.030)], HEIGHT, FailureKind.PILING),
        ([SAGGED], [], HEIGHT, FailureKind.SAG),
        ([SHORT], [], HEIGHT, FailureKind.DROPPED_CORNER),
        ([HALF, HANGING], [], HEIGHT, FailureKind.DROPPED_CORNER),
        ([HALF], [], HEIGHT / 3, FailureKind.DROPPED_CORNER),
    ],
    ids=["pile", "sag", "corner short of its target", "corner hanging out", "upper layer not there"],
)
def test_each_failure_of_the_paper_has_its_diagnosis(polygons, bumps, thickness, kind):
    seen = look(polygons, bumps, thickness).unwrap()
    assert seen.diagnosis is kind
    assert 0.0 < seen.confidence <= 1.0


def test_a_corner_left_behind_the_fold_line_is_reported_with_its_arm():
    """The left arm lost its corner, so the garment still reaches 12 cm beyond the line there."""
    flap = np.array([HALF[0], HALF[0] + (0.0, 0.12), 0.5 * (HALF[0] + HALF[1]) + (0.0, 0.03), HALF[1]])
    seen = look([HALF, flap], step=GRASPED).unwrap()
    assert seen.diagnosis is FailureKind.DROPPED_CORNER
    assert seen.left_behind["left"] > 0.08 > 0.03 > seen.left_behind["right"]


@pytest.mark.parametrize(("place", "behind"), [("left", 0.15), ("right", -0.15), ("middle", 0.0)])
def test_cloth_left_behind_is_reported_with_its_place(place, behind):
    """Cloth reaches 40 mm too far beyond the fold line, near one grasp or between both."""
    view = TableView(camera(), TABLE)
    x, y = np.moveaxis(on_table(view), -1, 0)
    planned = (np.abs(x - 0.5) < 0.1) & (np.abs(y) < 0.25)
    seen = planned | ((np.abs(x - 0.5) < 0.14) & (np.abs(y - behind) < 0.06))
    line = FoldLine(np.array([0.5, 0.0]), np.array([0.0, -1.0]))  # the line's normal points to larger x
    left = Grasp(np.array([0.7, 0.15]), 0.0, 1, 0.003)
    right = Grasp(np.array([0.7, -0.15]), 0.0, 1, 0.003)
    step = replace(STEP, line=line, grasps={GraspId.LEFT: left, GraspId.RIGHT: right})
    found = left_behind(view, seen, planned, step)
    expected = {name: 0.04 * (name == place) for name in ("left", "right", "middle")}
    assert found == pytest.approx(expected, abs=0.004)
    hidden = left_behind(view, seen & (np.abs(y - behind) > 0.07), planned, step)
    assert np.isnan(hidden[place]) and np.isfinite([v for name, v in hidden.items() if name != place]).all()
    one = left_behind(view, seen, planned, replace(step, grasps={GraspId.LEFT: left}))
    assert set(one) == {"left"} and left_behind(view, seen, planned, None) == {}


def test_a_layer_left_where_it_lay_is_a_missed_layer():
    """Behind the fold line the garment reaches as far as before the fold, along the whole line."""
    back = HALF[0] - HALF[3]
    lower = np.array([HALF[0] + back * 0.9, HALF[1] + back * 0.9, HALF[1], HALF[0]])
    seen = look([HALF, lower], step=GRASPED).unwrap()
    assert min(seen.left_behind.values()) > 0.2
    assert seen.diagnosis is FailureKind.MISSED_LAYER


def test_creases_that_were_there_before_do_not_hide_a_missing_layer():
    """All cloth is 3 mm higher than the mesh, as the picture of the flat garment has shown."""
    scene = Scene(seed=4, polygons=[HALF], thickness=0.0045, wobble=0.001)
    picture = render(scene)
    two_layers = layered(0.0028)
    blind = inspect(picture, camera(), TABLE, bare(), two_layers, STEP).unwrap()
    knowing = inspect(picture, camera(), TABLE, bare(), two_layers, STEP, flat_top=0.0045).unwrap()
    assert blind.accepted and blind.missing_layer < 0.1
    assert knowing.missing_layer > 0.3


@pytest.mark.parametrize("end", [slice(0, 3), slice(6, 9)])
def test_heights_are_used_if_one_end_of_the_moved_edge_is_unseen(end):
    """The seen part of the edge lies correctly, but at the target of the unseen end a layer is missing."""
    seen, settings = look([HALF], thickness=HEIGHT / 3).unwrap(), INSPECTION
    lag = np.zeros(9)
    whole = replace(seen, edge=MovedEdge(lag, HEIGHT / 2))
    assert diagnose(whole, STEP, settings)[0] is None
    lag[end] = np.nan
    partly = replace(seen, edge=MovedEdge(lag, HEIGHT / 2))
    assert partly.edge.corner == 0.0 and partly.edge.sag == pytest.approx(0.0)
    assert diagnose(partly, STEP, settings)[0] is FailureKind.DROPPED_CORNER
    assert "a target lacks" in ", ".join(beyond_limits(partly, settings))


def test_an_inspection_compares_the_fold_with_its_target_too():
    scene = Scene(seed=4, polygons=[HALF], thickness=HEIGHT, wobble=0.001)
    picture, target = render(scene), FoldTarget(PREDICTED, HALF[:2])
    seen = inspect(picture, camera(), TABLE, bare(), PREDICTED, STEP, target=target).unwrap()
    assert seen.target is not None and seen.target.iou == pytest.approx(seen.iou_aligned, abs=0.01)
    assert look([HALF]).unwrap().target is None


def test_a_bad_edge_without_a_known_step_is_off_target():
    assert look([SHORT], step=None).unwrap().diagnosis is FailureKind.OFF_TARGET


def test_an_inspection_of_an_empty_table_is_a_failure():
    outcome = look([])
    assert outcome.failure is not None and outcome.failure.kind is FailureKind.NO_GARMENT


@pytest.mark.parametrize(("hidden", "kind"), [(0.1, None), (0.3, FailureKind.CAMERA_FAULT)])
def test_a_fold_is_not_judged_by_a_picture_with_a_hole_in_the_depth_of_the_garment(hidden, kind):
    """hidden: share of the garment whose depth is missing. Its outline is seen by its colour."""
    frame = render(Scene(seed=4, polygons=[HALF], thickness=HEIGHT, wobble=0.001))
    rows, columns = np.nonzero(np.abs(frame.rgb.astype(int) - bare().rgb).sum(axis=2) > 60)
    depth = frame.depth.copy()
    depth[rows.min() : rows.max(), columns.min() : int(np.quantile(columns, hidden))] = np.nan
    outcome = inspect(replace(frame, depth=depth), camera(), TABLE, bare(), PREDICTED, STEP)
    assert (outcome.failure.kind if outcome.failure else outcome.unwrap().diagnosis) is kind


@pytest.mark.parametrize("seed", [4, 6])
def test_a_good_fold_on_boards_is_accepted_without_a_reference_picture(seed):
    """The method `plain` takes a board of another colour for cloth. The method `grabcut` does not."""
    scene = Scene(seed=seed, polygons=[HALF], thickness=HEIGHT, wobble=0.001, planks=0.3)
    seen = inspect(render(scene), camera(), TABLE, None, PREDICTED, STEP)
    assert seen.unwrap().accepted and seen.unwrap().iou > 0.97


def test_a_bad_fold_on_boards_is_diagnosed_without_a_reference_picture():
    scene = Scene(seed=4, polygons=[SAGGED], thickness=HEIGHT, wobble=0.001, planks=0.3)
    assert inspect(render(scene), camera(), TABLE, None, PREDICTED, STEP).unwrap().diagnosis is FailureKind.SAG


def test_the_upper_layer_hides_the_lower_one():
    view = TableView(camera(), TABLE)
    image = draw_shape(view, layered(0.02, 0.02))
    column, row = np.round(view.to_pixel(np.array([0.6, 0.0]))).astype(int)
    assert image[row, column] == pytest.approx(0.024, abs=1e-6)
