"""The moved edge of a towel of 0.40 x 0.60 m folded over its middle. Heights are drawn in closed form, with the
depth noise of a camera."""

from dataclasses import replace

import numpy as np
import pytest

from foldcell.robots.errors import FailureKind
from foldcell.skills.perception.inspection.diagnosis import EDGE_CORNER, EDGE_SAG
from foldcell.skills.perception.inspection.moved_edge import MovedEdge, moved_edge
from foldcell.skills.perception.rectification.table_view import TableView
from foldcell.skills.plane import rotation
from foldcell.skills.vocabulary import FoldLine, FoldStep, Grasp, GraspId, PredictedShape
from tests.builders.shipped_settings import inspect
from tests.inspections import grid_triangles, on_table
from tests.scenes import TABLE, Scene, camera, empty, place, render

VIEW = TableView(camera(), TABLE)
XY = on_table(VIEW)
X, Y = XY[..., 0], XY[..., 1]
LAYER, NOISE = 0.0025, 0.0015
# The line is along x at y = 0. The part at y > 0 moves onto y < 0.
LINE = FoldLine(np.array([0.6, 0.0]), np.array([1.0, 0.0]))
SPAN = (0.4, 0.8)
GRASP_IDS = (GraspId.LEFT, GraspId.RIGHT)
GRASPS = {s: Grasp(np.array([x, 0.29]), 0.0, 1, 0.003) for s, x in zip(GRASP_IDS, SPAN, strict=True)}
TARGETS = {s: np.array([x, -0.29, 0.006]) for s, x in zip(GRASP_IDS, SPAN, strict=True)}
STEP = FoldStep("half", 0, LINE, (), GRASPS, TARGETS)


ALONG = np.clip((X - SPAN[0]) / (SPAN[1] - SPAN[0]), 0, 1)
"""Place of each pixel along the edge, 0..1."""
ON = (SPAN[0] < X) & (SPAN[1] > X) & (np.abs(Y) < 0.3)


def noisy(*maps, seed=0):
    """Height maps with the depth noise of a camera."""
    rng = np.random.default_rng(seed)
    return [(h + NOISE * rng.standard_normal(h.shape)).astype(np.float32) for h in maps]


def heights(lag, seed=0, creases=0.004, loop=0.0, flank=None):
    """Height maps (before, after): one layer, then two layers up to the moved edge.

    lag: distance of the edge behind its place [m], a function of 0..1 along the edge. loop: height of an earlier
    fold's crease along the end 0 [m], which the moved layer presses down. flank: share of the edge over which the
    height of the loop falls to 1/e; None: the loop has a steep end.
    """
    lower = LAYER + creases * (1 + np.sin(60 * X) * np.cos(45 * Y)) / 2
    raised = loop * (np.clip(1.5 - ALONG / 0.13, 0, 1) if flank is None else np.exp(-ALONG / flank))
    over = np.where((Y < 0) & (-0.3 + lag(ALONG) < Y), np.maximum(raised, LAYER), raised)
    return noisy((lower + raised) * ON, (lower + over) * (ON & (Y < 0)), seed=seed)


def pressed_flat(lag, seed=0, layer=LAYER):
    """Height maps (before, after): the moved layer presses the wrinkles below it to the stack's mean height."""
    wrinkled = layer * (1.0 + 0.5 * (1 + np.sin(18 * X) * np.cos(20 * Y)))
    moved = ON & (Y < 0) & (-0.3 + lag(ALONG) < Y)
    return noisy(wrinkled * ON, np.where(moved, 2.5 * layer, wrinkled * (ON & (Y < 0))), seed=seed)


def look(lag, seed=0, loop=0.0, flank=None, creases=0.004):
    before, after = heights(lag, seed, creases, loop, flank)
    return looked_at(after, before)


@pytest.mark.parametrize("depth", [0.0, 0.02, 0.04, 0.06])
def test_a_sag_is_measured_on_creased_cloth(depth):
    """Creases are 4 mm high, the noise is 1.5 mm per pixel, and a layer is 2.5 mm thick. Where the edge is oblique
    it spans 20 mm within one strip. Half of this is the tolerance."""
    seen = look(lambda t: depth * np.sin(np.pi * t))
    middle_of_strips = depth * np.sin(np.pi * middles(seen))
    assert seen.rise == pytest.approx(LAYER, abs=0.0004)
    assert np.abs(seen.lag - middle_of_strips).max() < 0.010
    assert seen.corner < 0.005


@pytest.mark.parametrize("end", [0, 1])
def test_a_lost_corner_is_measured_at_either_end(end):
    seen = look(lambda t: 0.08 * (t if end else 1 - t) ** 1.5)
    assert 0.035 < seen.corner < 0.08 and seen.sag < 0.0


def test_an_edge_at_its_place_raises_no_alarm():
    for seed in range(5):
        seen = look(lambda t: 0.0 * t, seed)
        assert abs(seen.sag) < 0.006 and seen.corner < 0.006


@pytest.mark.parametrize("loop", [0.014, 0.018, 0.025])
def test_a_pressed_down_loop_of_an_earlier_crease_is_no_lost_corner(loop):
    """The height does not rise where the loop was, as if no layer lay there."""
    seen = look(lambda t: 0.0 * t, loop=loop)
    assert seen.corner < 0.006 and abs(seen.sag) < 0.010
    assert seen.rise > 0.7 * LAYER
    assert not np.isfinite(seen.lag[0]) and np.isfinite(seen.lag[2:]).all()


@pytest.mark.parametrize("flank", [0.06, 0.10, 0.14])
def test_the_flank_of_a_pressed_down_loop_is_no_lost_corner(flank):
    """The surface rises on the flank by less than a layer, because the layer presses the flank down."""
    for seed in range(3):
        seen = look(lambda t: 0.0 * t, seed, 0.012, flank, creases=0.001)
        assert seen.corner < EDGE_CORNER and abs(seen.sag) < EDGE_SAG
        lost = look(lambda t: 0.06 * (t > 0.75), seed, 0.012, flank, creases=0.001)
        assert lost.corner > EDGE_CORNER


@pytest.mark.parametrize("seed", range(4))
def test_wrinkles_that_the_moved_layer_presses_flat_are_no_lag(seed):
    """On a wrinkle that is pressed flat, the surface rises by less than half a layer."""
    for lag, found in ((lambda t: 0.0 * t, False), (lambda t: 0.05 * (t > 0.75), True)):
        before, after = pressed_flat(lag, seed)
        seen = looked_at(after, before)
        assert (seen.corner > EDGE_CORNER) is found
        assert found or np.abs(seen.lag).max() < 0.010


@pytest.mark.parametrize("behind", [0.0, 0.05])
def test_a_corner_on_the_loop_of_an_earlier_crease_is_seen_where_the_new_crease_lies_on_it(behind):
    """The new layers' crease doubles the height of the loop. Where they are missing, the loop has sunk."""
    raised = 0.016 * np.clip(1.2 - ALONG / 0.13, 0, 1)
    moved = ON & (Y < 0) & (-0.3 + behind * (ALONG < 0.3) < Y)
    covered = LAYER + np.where(raised > 0, 2.0 * raised, LAYER)
    after = np.where(moved, covered, (LAYER + 0.6 * raised) * (ON & (Y < 0)))
    before, after = noisy((LAYER + raised) * ON, after, seed=2)
    seen = looked_at(after, before)
    assert np.isfinite(seen.lag[0])
    assert (seen.corner > EDGE_CORNER) is (behind > 0.0)


def test_an_end_on_a_crease_lags_by_no_more_than_its_last_strip():
    lag = np.array([0.002, 0.03, 0.05, *[0.0] * 6])
    assert MovedEdge(lag, LAYER).corner == pytest.approx(0.03)
    assert MovedEdge(lag, LAYER, (True, False)).corner == pytest.approx(0.002)


@pytest.mark.parametrize("end", [0, 1])
def test_a_lost_corner_is_found_beside_a_loop(end):
    seen = look(lambda t: 0.08 * (t if end else 1 - t) ** 1.5, loop=0.018)
    assert 0.030 < seen.corner < 0.08


@pytest.mark.parametrize("behind", range(15, 24))
def test_rounding_does_not_change_the_verdict_on_a_corner(behind):
    """Strips have positions in steps of 2 mm, and medians of two strips in steps of 1 mm. 19 mm are within the
    limit and 20 mm beyond it, for any origin."""
    places = np.arange(-0.024, 0.120, 0.002)
    beyond = set()
    for i in range(behind // 2 + 1, len(places)):
        middle = [places[i - behind // 2], places[i - (behind + 1) // 2]]
        edge = MovedEdge(np.array([places[i]] * 2 + [np.nan] * 3 + middle * 2), LAYER)
        assert edge.corner == pytest.approx(1e-3 * behind, abs=1e-9)
        beyond.add(edge.corner > EDGE_CORNER)
    assert beyond == {behind > 19}


def folded(reach=0.3, width=0.4, layer=LAYER, slope=0.0):
    """The prediction of a fold. reach: length of the moved part beyond the line, in its middle [m]. width: of the
    towel [m]. slope: by which the moved part gets shorter from its middle to both ends."""
    x, y = np.meshgrid(
        np.linspace(*np.round((0.6 - width / 2, 0.6 + width / 2), 6), 17),
        np.linspace(-0.3, reach, 41),
        indexing="ij",
    )
    y = np.where(y > 0, y * (1.0 - slope * np.abs(x - 0.6) / reach), y)
    material = np.stack([x.ravel(), y.ravel()], axis=1)
    up = material[:, 1] > 0
    vertices = np.column_stack([material[:, 0], -np.abs(material[:, 1]), np.where(up, 1.5, 0.5) * layer])
    return PredictedShape(vertices, grid_triangles(x.shape), material)


def turned(degrees, x=0.0, y=0.0):
    """Rotation and translation (R, t) of a motion about the middle of the towel."""
    R = rotation(np.deg2rad(degrees))
    return R, np.array([0.6 + x, y]) - R @ np.array([0.6, 0.0])


STILL = turned(0.0)


def towel(lag=0.0, reach=0.3, width=0.4, layer=LAYER, crease=0.0, motion=STILL, before=STILL):
    """Height maps (after, before) of a smooth towel that each motion has laid.

    crease: height of the crease, which is 40 mm wide [m]. lag: of the moved edge [m], constant or a function of
    0..1 along the edge.
    """

    def lying(R, t):
        xy = (XY - t) @ R
        along = (xy[..., 0] - 0.6) / width + 0.5
        return np.clip(along, 0, 1), (along > 0) & (along < 1), xy[..., 1]

    t, on, y = lying(*motion)
    far = reach - (lag(t) if callable(lag) else lag)
    after = layer * (on & (y < 0) & (y > -0.3)) + layer * (on & (y < 0) & (y > -far))
    after = after + crease * (on & (y < 0) & (y > -0.04))
    _, on, y = lying(*before)
    return noisy(after, layer * (on & (y > -0.3) & (y < reach)))


def middles(seen):
    """Middles of the strips, as shares of the edge's length."""
    return (np.arange(len(seen.lag)) + 0.5) / len(seen.lag)


def looked_at(after, before, step=STEP, motion=STILL, **shape):
    return moved_edge(after, before, folded(**shape), step, VIEW, *motion)


@pytest.mark.parametrize("lag", [-0.016, 0.0, 0.03, 0.06])
def test_an_edge_too_far_out_or_in_is_measured(lag):
    """The resolution of reported positions is 2 mm."""
    seen = looked_at(*towel(lag))
    assert np.abs(seen.lag - lag).max() < 0.0045
    assert abs(seen.sag) < 0.004 and abs(seen.corner) < 0.005


def test_an_edge_beyond_the_search_range_is_reported_at_its_limit():
    seen = looked_at(*towel(lambda t: 0.2 * (t > 0.78)))
    near, far = seen.lag[middles(seen) < 0.74], seen.lag[middles(seen) > 0.82]
    assert np.abs(near).max() < 0.0045 and far == pytest.approx(0.12, abs=0.0025)
    assert seen.corner > 0.1


@pytest.mark.parametrize("motion", [turned(0.0, 0.02, -0.015), turned(5.0), turned(-4.0, -0.01, 0.02)])
def test_a_displaced_fold_is_inspected_where_it_lies(motion):
    """The picture from before the fold shows the cloth at its earlier place."""
    seen = looked_at(*towel(lambda t: 0.04 * t, motion=motion), motion=motion)
    assert np.abs(seen.lag - 0.04 * middles(seen)).max() < 0.006
    assert seen.rise == pytest.approx(LAYER, abs=0.0004)


@pytest.mark.parametrize("degrees", [90.0, 180.0, 225.0])
def test_the_moved_edge_is_found_for_any_fold_direction(degrees):
    """Line, prediction and cloth are turned together. The result is the same towards the camera and away from
    it."""
    R, t = turned(degrees)
    after, before = towel(lambda u: 0.04 * u, motion=(R, t), before=(R, t))
    flat = folded()
    vertices = np.column_stack([flat.vertices[:, :2] @ R.T + t, flat.vertices[:, 2]])
    shape = PredictedShape(vertices, flat.triangles, flat.material @ R.T + t)
    step = replace(STEP, line=FoldLine(R @ LINE.point + t, R @ LINE.direction))
    seen = moved_edge(after, before, shape, step, VIEW, np.eye(2), np.zeros(2))
    assert np.abs(seen.lag - 0.04 * middles(seen)).max() < 0.006


@pytest.mark.parametrize("crease", [0.0, 0.012, 0.025])
@pytest.mark.parametrize("lag", [0.0, 0.03])
def test_the_crease_of_the_fold_does_not_count_as_layers(crease, lag):
    """The moved part is 11 cm long, of which 4 cm are the bulge of its crease."""
    seen = looked_at(*towel(lag, reach=0.11, crease=crease), reach=0.11)
    assert np.abs(seen.lag - lag).max() < 0.006 and seen.rise == pytest.approx(LAYER, abs=0.0005)


@pytest.mark.parametrize("up", [0.006, 0.015, 0.04])
def test_a_wrinkle_in_front_of_the_edge_is_not_the_edge(up):
    """The fold made a wrinkle that is 10 mm wide and much higher than a layer."""
    after, before = towel(0.06)
    after[(after > 0.0) & (Y > -0.29) & (Y < -0.28)] += up
    assert np.abs(looked_at(after, before).lag - 0.06).max() < 0.006


@pytest.mark.parametrize("layer", [0.0020, 0.0060, 0.0120])
def test_an_edge_of_thick_cloth_is_found(layer):
    """A place as high as the rest of a thick stack is not a loop of a crease."""
    seen = looked_at(*towel(0.03, layer=layer), layer=layer)
    assert np.abs(seen.lag - 0.03).max() < 0.006 and seen.rise == pytest.approx(layer, abs=0.0005)


def test_a_layer_thinner_than_a_millimetre_is_not_seen():
    assert looked_at(*towel(layer=0.0007), layer=0.0007) is None
    assert looked_at(*towel(layer=0.0014), layer=0.0014) is not None


@pytest.mark.parametrize("behind", [0.0, 0.03])
def test_an_oblique_edge_is_measured_across_itself(behind):
    """A cuff that is folded onto a body is a wedge: its edge runs at up to 45 degrees to the fold line."""
    slope, width = 1.0, 0.2
    lag = behind * np.hypot(1.0, slope)
    seen = looked_at(
        *towel(lambda t: lag + slope * width * np.abs(t - 0.5), width=width), width=width, slope=slope
    )
    flanks = np.r_[seen.lag[1:4], seen.lag[-4:-1]]
    assert np.abs(flanks - behind).max() < 0.006


def test_the_strips_of_a_short_edge_are_noisier_than_their_layers_demand():
    wide = looked_at(*towel(width=0.4, layer=0.004), width=0.4, layer=0.004)
    assert wide.noise == pytest.approx(1.0, abs=0.05)
    long, short = (looked_at(*towel(width=width), width=width) for width in (0.4, 0.14))
    assert short.noise == pytest.approx(long.noise * ((0.4 - 0.02) / (0.14 - 0.02)) ** 0.5, rel=0.1)


def test_a_short_edge_is_not_judged():
    """The edge has less than 8 cm between its rims of 1 cm, or it belongs to a flap of a few vertices."""
    assert looked_at(*towel(width=0.09), width=0.09) is None
    assert looked_at(*towel(width=0.11), width=0.11) is not None
    flat = folded()
    few = PredictedShape(
        flat.vertices, flat.triangles, np.where(flat.material > 0.29, 0.29, flat.material) - (0, 0.29)
    )
    assert moved_edge(*towel(), few, STEP, VIEW, np.eye(2), np.zeros(2)) is None


T = (np.arange(9) + 0.5) / 9


@pytest.mark.parametrize("sag", [-0.03, 0.0, 0.012, 0.05])
@pytest.mark.parametrize("unseen", [(), (0,), (8,), (0, 4, 8), (1, 2, 5, 6)])
def test_a_sag_is_the_half_sine_over_the_line_between_the_ends(sag, unseen):
    """This holds for any lag of the ends and for up to four unseen strips."""
    lag = 0.02 - 0.03 * T + sag * np.sin(np.pi * T)
    lag[list(unseen)] = np.nan
    assert MovedEdge(lag, LAYER).sag == pytest.approx(sag, abs=1e-9)


def test_fewer_than_five_strips_give_no_sag():
    lag = np.zeros(9)
    lag[[0, 2, 4, 6, 8]] = np.nan
    edge = MovedEdge(lag, LAYER)
    assert np.isnan(edge.sag) and not edge.wholly_seen


def test_the_error_of_a_sag_is_the_scatter_of_repeated_measurements():
    rng = np.random.default_rng(3)
    edges = [MovedEdge(0.02 * np.sin(np.pi * T) + rng.normal(0.0, 0.004, 9), LAYER) for _ in range(400)]
    scatter = float(np.std([edge.sag for edge in edges]))
    assert float(np.mean([edge.sag_error for edge in edges])) == pytest.approx(scatter, rel=0.15)
    assert MovedEdge(0.02 * np.sin(np.pi * T), LAYER).sag_error == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize("strip", range(1, 8))
@pytest.mark.parametrize("wrong", [-0.024, 0.1])
def test_one_outlying_strip_is_no_sag(strip, wrong):
    """Least squares would report a fifth of the outlier as a sag."""
    lag = 0.02 * np.sin(np.pi * T)
    lag[strip] = wrong
    assert MovedEdge(lag, LAYER).sag == pytest.approx(0.02, abs=0.009)


def test_the_corner_figure_is_that_of_the_worse_seen_end():
    """If the first strip of an end is not seen, the second one counts, but the edge is not wholly seen. An end
    without three seen strips is not used. A single misplaced strip neither hides a corner nor is one."""
    nan = np.nan
    for lag, corner, whole in (
        ([0.05, 0.04, 0, 0, 0, 0, 0, 0.02, 0.03], 0.04, True),
        ([0.02, 0.03, 0, 0, 0, 0, 0, 0.05, 0.04], 0.04, True),
        ([nan, 0.04, 0.03, 0, 0, 0, 0, 0, 0], 0.03, False),
        ([nan, nan, 0.03, 0, 0, 0, 0, 0, 0], 0.03, False),
        ([nan, nan, nan, 0, 0, 0, 0, 0.02, 0.03], 0.02, False),
        ([0.02, 0.03, 0, 0, 0, 0, nan, nan, nan], 0.02, False),
        ([0.05, 0.0, 0, 0, 0, 0, 0, 0, 0], 0.0, True),
        ([nan, 0, 0, 0, 0, 0, 0, 0, 0], 0.0, False),
        ([0.016, 0.048, 0.036, 0, 0, 0, 0, 0, 0], 0.036, True),
        ([0, 0.12, 0, 0, 0, 0, 0, 0, 0], 0.0, True),
    ):  # fmt: skip
        edge = MovedEdge(np.array(lag, dtype=float), LAYER)
        assert edge.corner == pytest.approx(corner) and edge.wholly_seen is whole
    assert np.isnan(MovedEdge(np.array([nan] * 3 + [0.0] * 3 + [nan] * 3), LAYER).corner)


def test_an_edge_without_a_rise_in_height_has_no_figures():
    """The earlier picture already shows the fold, so its edge cannot be located."""
    _, after = heights(lambda t: 0.04 * np.sin(np.pi * t))
    assert looked_at(*noisy(after, seed=1), after) is None


@pytest.mark.parametrize("short", [0.0, 0.05])
def test_a_fold_that_is_predicted_to_fall_short_of_its_line_has_no_moved_edge(short):
    """A fold whose moved part does not reach the line is judged by its outline."""
    flat = folded()
    vertices = flat.vertices.copy()
    vertices[:, 1] = np.where(flat.material[:, 1] > 0, np.maximum(flat.material[:, 1], short), flat.material[:, 1])
    never = replace(flat, vertices=vertices)
    before, after = heights(lambda t: 0.0 * t)
    assert moved_edge(after, before, never, STEP, VIEW, np.eye(2), np.zeros(2)) is None


def test_an_inspection_reports_a_sag_that_the_silhouette_does_not_show():
    """The pictures show two layers. The middle of the upper layer's edge lies some centimetres behind."""
    whole = place([[0.2, 0.3], [-0.2, 0.3], [-0.2, -0.3], [0.2, -0.3]], 0.6, 0.0, 0.0)
    half = whole * (1.0, 0.5) - (0.0, 0.15)
    lacking = [(x, -0.3 + r, 0.03, -0.5) for x in (0.52, 0.56, 0.60, 0.64, 0.68) for r in (0.0, 0.015)]
    flat = Scene(seed=4, polygons=[whole], thickness=LAYER, wobble=0.0)
    before, bare = render(flat), empty(flat)
    good = replace(flat, polygons=[half], thickness=2 * LAYER)
    bad = replace(good, bumps=[(x, y, s, k * LAYER) for x, y, s, k in lacking])
    found = [
        inspect(render(scene, sequence=1), camera(), TABLE, bare, folded(), STEP, previous=before).unwrap()
        for scene in (good, bad)
    ]
    assert found[0].accepted and found[1].iou_aligned > 0.97
    assert found[1].diagnosis is FailureKind.SAG and found[1].edge.sag > 0.015


def test_a_corner_that_is_turned_in_over_a_short_length_is_found():
    """The last 60 mm of an edge of 0.4 m are up to 60 mm behind."""
    seen = looked_at(*towel(lambda t: 0.06 * np.exp(-(((1.0 - t) * 0.4 / 0.06) ** 2)), layer=0.005))
    assert seen.corner > 0.035 and abs(seen.lag[: len(seen.lag) // 2]).max() < 0.006
