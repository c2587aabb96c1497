"""A towel 0.40 x 0.60 m folded over its middle; heights drawn in closed form, with the depth noise of a camera."""

from dataclasses import replace

import numpy as np
import pytest

from robots.errors import FailureKind
from robots.ports import Side
from skills.perception.inspect import inspect
from skills.perception.inspection import InspectionSettings
from skills.perception.moved_edge import MovedEdge, moved_edge
from skills.perception.view import TableView
from skills.vocabulary import FoldLine, FoldStep, Grasp, PredictedShape
from tests.scenes import TABLE, Scene, camera, empty, place, render

VIEW = TableView(camera(), TABLE)
LAYER, NOISE = 0.0025, 0.0015
# The line runs along x at y = 0; what lies left of it, y > 0, moves onto y < 0.
LINE = FoldLine(np.array([0.6, 0.0]), np.array([1.0, 0.0]))
SPAN = (0.4, 0.8)
SIDES = (Side.LEFT, Side.RIGHT)
GRASPS = {s: Grasp(s, np.array([x, 0.29]), 0.0, 1, 0.003) for s, x in zip(SIDES, SPAN, strict=True)}
TARGETS = {s: np.array([x, -0.29, 0.006]) for s, x in zip(SIDES, SPAN, strict=True)}
STEP = FoldStep("half", 0, LINE, (), GRASPS, TARGETS)


def folded_mesh():
    x, y = np.meshgrid(np.linspace(*SPAN, 17), np.linspace(-0.3, 0.3, 25), indexing="ij")
    material = np.stack([x.ravel(), y.ravel()], axis=1)
    up = material[:, 1] > 0
    vertices = np.column_stack([material[:, 0], -np.abs(material[:, 1]), np.where(up, 1.5, 0.5) * LAYER])
    i = np.arange(x.size).reshape(x.shape)
    a, b, c, d = (k.ravel() for k in (i[:-1, :-1], i[1:, :-1], i[1:, 1:], i[:-1, 1:]))
    triangles = np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)]).astype(np.int32)
    return PredictedShape(vertices, triangles, material)


def heights(lag, seed=0, creases=0.004, loop=0.0):
    """(before, after): one layer, then two where the moved edge, `lag` (function of 0..1 along it) [m] behind.

    loop: height of an earlier fold's crease along the end 0 [m], which the moved layer presses down as it lies.
    """
    rng = np.random.default_rng(seed)
    rows, columns = np.indices(VIEW.shape)
    xy = VIEW.to_table(np.stack([columns, rows], axis=-1))
    x, y = xy[..., 0], xy[..., 1]
    on = (x > SPAN[0]) & (x < SPAN[1])
    lower = LAYER + creases * (1 + np.sin(60 * x) * np.cos(45 * y)) / 2
    before = np.where(on & (np.abs(y) < 0.3), lower, 0.0)
    t = np.clip((x - SPAN[0]) / (SPAN[1] - SPAN[0]), 0, 1)
    raised = loop * np.clip(1.5 - t / 0.13, 0, 1)
    before = np.where(before > 0, before + raised, before)
    moved = on & (y < 0) & (y > -0.3 + lag(t))
    after = np.where(on & (y < 0) & (y > -0.3), lower + raised, 0.0) + np.where(raised > 0, 0.0, LAYER) * moved
    return [(h + NOISE * rng.standard_normal(h.shape)).astype(np.float32) for h in (before, after)]


def look(lag, seed=0, loop=0.0):
    before, after = heights(lag, seed, loop=loop)
    return moved_edge(after, before, folded_mesh(), STEP, VIEW, np.eye(2), np.zeros(2))


@pytest.mark.parametrize("depth", [0.0, 0.02, 0.04, 0.06])
def test_a_sag_is_measured_on_creased_cloth(depth):
    """Creases of 4 mm and noise of 1.5 mm a pixel, a layer of 2.5 mm. Where the edge runs
    aslant it spans 20 mm within one strip: half of that is the tolerance."""
    seen = look(lambda t: depth * np.sin(np.pi * t))
    middle_of_strips = depth * np.sin(np.pi * (np.arange(9) + 0.5) / 9)
    assert seen.rise == pytest.approx(LAYER, abs=0.0004)
    assert np.abs(seen.lag - middle_of_strips).max() < 0.010
    assert seen.corner < 0.005


@pytest.mark.parametrize("end", [0, 1])
def test_a_lost_corner_is_measured_at_either_end(end):
    seen = look(lambda t: 0.08 * (t if end else 1 - t) ** 1.5)
    assert 0.035 < seen.corner < 0.08 and seen.sag < 0.0


def test_an_edge_where_it_should_be_raises_no_alarm():
    for seed in range(5):
        seen = look(lambda t: 0.0 * t, seed)
        assert abs(seen.sag) < 0.006 and seen.corner < 0.006


@pytest.mark.parametrize("loop", [0.014, 0.018, 0.025])
def test_the_loop_of_an_earlier_crease_that_is_pressed_down_is_no_lost_corner(loop):
    """Nothing rises where the loop was, as if nothing had come to lie there."""
    seen = look(lambda t: 0.0 * t, loop=loop)
    assert seen.corner < 0.006 and abs(seen.sag) < 0.010
    assert seen.rise > 0.7 * LAYER
    assert not np.isfinite(seen.lag[0]) and np.isfinite(seen.lag[2:]).all()


@pytest.mark.parametrize("end", [0, 1])
def test_a_lost_corner_is_found_beside_a_loop(end):
    seen = look(lambda t: 0.08 * (t if end else 1 - t) ** 1.5, loop=0.018)
    assert 0.030 < seen.corner < 0.08


@pytest.mark.parametrize("behind", range(15, 24))
def test_no_rounding_decides_about_a_corner(behind):
    """Strips say where they are in steps of 2 mm, a median of two of them in steps of 1 mm: 19 mm are within the
    limit and 20 beyond it, wherever they are counted from."""
    places = np.arange(-0.024, 0.120, 0.002)
    beyond = set()
    for i in range(behind // 2 + 1, len(places)):
        middle = [places[i - behind // 2], places[i - (behind + 1) // 2]]
        edge = MovedEdge(np.array([places[i]] * 2 + [np.nan] * 3 + middle * 2), LAYER)
        assert edge.corner == pytest.approx(1e-3 * behind, abs=1e-9)
        beyond.add(edge.corner > InspectionSettings().edge_corner)
    assert beyond == {behind > 19}


def test_when_nothing_rose_nothing_is_said():
    """The picture before shows the fold already: there is no telling where its edge lies."""
    _, after = heights(lambda t: 0.04 * np.sin(np.pi * t))
    again = after + NOISE * np.random.default_rng(1).standard_normal(after.shape).astype(np.float32)
    assert moved_edge(again, after, folded_mesh(), STEP, VIEW, np.eye(2), np.zeros(2)) is None


@pytest.mark.parametrize("short", [0.0, 0.05])
def test_a_fold_that_is_predicted_to_fall_short_of_its_line_has_no_moved_edge(short):
    """A fold of which nothing comes over the line is judged by its outline."""
    flat = folded_mesh()
    vertices = flat.vertices.copy()
    vertices[:, 1] = np.where(flat.material[:, 1] > 0, np.maximum(flat.material[:, 1], short), flat.material[:, 1])
    never = replace(flat, vertices=vertices)
    before, after = heights(lambda t: 0.0 * t)
    assert moved_edge(after, before, never, STEP, VIEW, np.eye(2), np.zeros(2)) is None


def test_inspection_names_the_sag_that_no_silhouette_shows():
    """Pictures: two layers, the upper one's edge some centimetres behind in its middle."""
    whole = place([[0.2, 0.3], [-0.2, 0.3], [-0.2, -0.3], [0.2, -0.3]], 0.6, 0.0, 0.0)
    half = whole * (1.0, 0.5) - (0.0, 0.15)
    lacking = [(x, -0.3 + r, 0.03, -0.5) for x in (0.52, 0.56, 0.60, 0.64, 0.68) for r in (0.0, 0.015)]
    flat = Scene(seed=4, polygons=[whole], thickness=LAYER, wobble=0.0)
    before, bare = render(flat), empty(flat)
    good = replace(flat, polygons=[half], thickness=2 * LAYER)
    bad = replace(good, bumps=[(x, y, s, k * LAYER) for x, y, s, k in lacking])
    found = [
        inspect(render(scene, sequence=1), camera(), TABLE, bare, folded_mesh(), STEP, previous=before).unwrap()
        for scene in (good, bad)
    ]
    assert found[0].accepted and found[1].iou_aligned > 0.97
    assert found[1].diagnosis is FailureKind.SAG and found[1].edge.sag > 0.015
