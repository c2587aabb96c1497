"""The scorer against exact folds, independent rasters and each kind of failure."""

from __future__ import annotations

import json
import math

import cv2
import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial import Delaunay
from scipy.spatial.transform import Rotation

from foldcell.robots.errors import InternalError
from foldcell.skills.cloth.mesh import mesh_from_contour
from foldcell.skills.cloth.solver import ClothSimulation
from foldcell.skills.fold_figures.fold_figures import PIXEL, rasterise
from foldcell.skills.fold_figures.folded_mesh import fold_mesh
from foldcell.skills.fold_plan.folding import fold_xy, target_vertices
from foldcell.skills.fold_plan.plan import ways_to_fold
from foldcell.skills.garments.garment import Anchor, Garment, PlanGrasp, PlanStep, PlanVariant, PoseRange
from foldcell.skills.scoring.alignment import FinalGarment
from foldcell.skills.scoring.score import diagonal, named_edge_pairs, score, score_plan
from foldcell.skills.scoring.verdict import Figure, IdealHeights, Score
from foldcell.skills.vocabulary import FoldLine, Material

LENGTH, WIDTH, THICKNESS = 0.60, 0.40, 0.002
CORNERS = {  # the towel lies with its length across the table
    "near_right": np.array([-WIDTH / 2, -LENGTH / 2]),
    "far_right": np.array([WIDTH / 2, -LENGTH / 2]),
    "far_left": np.array([WIDTH / 2, LENGTH / 2]),
    "near_left": np.array([-WIDTH / 2, LENGTH / 2]),
}
PAIRS = [(("near_left", "far_left"), ("near_right", "far_right"))]
HALF = FoldLine(np.array([0.0, 0.0]), np.array([1.0, 0.0]))  # y > 0 moves onto y < 0
QUARTER = FoldLine(np.array([0.0, 0.0]), np.array([0.0, 1.0]))  # then x < 0 onto x > 0
POSE = (0.62, 0.05, math.radians(20.0))


def towel(edge: float = 0.02, seed: int = 1) -> tuple[np.ndarray, np.ndarray]:
    """An unstructured mesh of the towel, centred on 0: vertices (n, 2), triangles (m, 3)."""
    rng = np.random.default_rng(seed)
    x, y = (np.linspace(-s / 2, s / 2, round(s / edge) + 1) for s in (WIDTH, LENGTH))
    grid = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
    inner = (np.abs(grid[:, 0]) < WIDTH / 2 - 1e-9) & (np.abs(grid[:, 1]) < LENGTH / 2 - 1e-9)
    grid[inner] += rng.uniform(-0.25, 0.25, (inner.sum(), 2)) * edge
    return grid, Delaunay(grid).simplices.astype(np.int32)


def turned(xy: np.ndarray, x: float, y: float, angle: float) -> np.ndarray:
    c, s = math.cos(angle), math.sin(angle)
    return xy @ np.array([[c, s], [-s, c]]) + [x, y]


def turned_line(line: FoldLine, x: float, y: float, angle: float) -> FoldLine:
    return FoldLine(turned(line.point, x, y, angle), turned(line.direction, 0.0, 0.0, angle))


def garment(
    flat: np.ndarray,
    triangles: np.ndarray,
    final: np.ndarray,
    lines: tuple[FoldLine, ...] = (HALF,),
    pose: tuple[float, float, float] = POSE,
) -> FinalGarment:
    """The towel at the end of a run. final: (n, 3) vertices in the towel's frame. The result is laid at `pose`."""
    placed = np.column_stack([turned(final[:, :2], *pose), final[:, 2]])
    keypoints = {name: turned(p, *pose) for name, p in CORNERS.items()}
    return FinalGarment(
        placed,
        triangles,
        turned(flat, *pose),
        tuple(turned_line(line, *pose) for line in lines),
        THICKNESS,
        named_edge_pairs(PAIRS, keypoints),
        keypoints,
        IdealHeights(2 ** len(lines) * THICKNESS, 0.050),
    )


def folded(flat: np.ndarray, lines: tuple[FoldLine, ...] = (HALF,)) -> np.ndarray:
    """The exact fold of every vertex: an isometry with stacked layers."""
    xy, layer = flat.copy(), np.zeros(len(flat))
    for k, line in enumerate(lines):
        moves = line.signed_distance(xy) > 0.0
        xy[moves] = line.reflect(xy[moves])
        layer[moves] = 2 ** (k + 1) - 1 - layer[moves]
    return np.column_stack([xy, layer * THICKNESS])


def moved_part(flat: np.ndarray) -> np.ndarray:
    return HALF.signed_distance(flat) > 0.0


# --- folds that must pass ------------------------------------------------------------------------------


@pytest.mark.parametrize("lines", [(HALF,), (HALF, QUARTER)])
def test_the_exact_isometry_scores_perfectly(lines: tuple[FoldLine, ...]) -> None:
    flat, triangles = towel()
    cut = fold_mesh(flat, triangles, lines, flat)
    rest = cut.attributes
    result = score(garment(rest, cut.triangles, folded(rest, lines), lines))
    assert result.passed and result.layers == 2 ** len(lines)
    assert result.iou == 1.0
    assert max(result.figures[f].value for f in ("correspondence_m", "edges_m", "drift_m", "drift_rad")) < 1e-9
    assert result.figures["height_m"].value == pytest.approx((2 ** len(lines) - 1) * THICKNESS, abs=1e-12)


@pytest.mark.parametrize("lines", [(HALF,), (HALF, QUARTER)])
@pytest.mark.parametrize("edge", [0.03, 0.02, 0.012])
def test_a_coarse_mesh_that_cannot_crease_on_the_line_passes(lines: tuple[FoldLine, ...], edge: float) -> None:
    flat, triangles = towel(edge)
    result = score(garment(flat, triangles, folded(flat, lines), lines))
    assert result.passed, result.to_json()
    assert result.iou > 0.93 and result.figures["edges_m"].value < 1e-9


def test_creases_bulge_without_failing_the_height() -> None:
    flat, triangles = towel()
    final = folded(flat)
    final[:, 2] += 0.05 * (np.abs(flat[:, 1]) < 0.03)
    result = score(garment(flat, triangles, final))
    assert result.passed, result.to_json()


@pytest.mark.parametrize("lines", [(HALF,), (HALF, QUARTER)], ids=["half", "quarter"])
def test_the_ideal_shape_still_passes_when_it_has_settled_for_a_second(lines: tuple[FoldLine, ...]) -> None:
    """Cloth placed exactly on the target opens its creases. A fold must not fail because of this."""
    outline = np.array([*CORNERS.values()])
    mesh = mesh_from_contour(outline, 0.020)
    material = Material(0.4, 0.03, 0.012, 0.0025, 0.41, 0.35, 0.6)
    ideal = target_vertices(mesh, lines, material)
    simulation = ClothSimulation(mesh, material, ideal + np.array([0.0, 0.0, 0.5 * material.thickness]))
    simulation.advance(frames=60)
    pairs = named_edge_pairs(PAIRS, CORNERS)
    final = FinalGarment(simulation.positions, mesh.triangles, mesh.rest, lines, material.thickness, pairs)
    result = score(final)
    assert result.passed, result.to_json()
    assert result.iou > 0.92 and result.figures["correspondence_m"].value < 0.010
    assert result.figures["height_m"].value > len(lines) * material.thickness, (
        "the cloth has settled and is not perfectly flat"
    )


@pytest.mark.parametrize(("name", "limit"), [("height_m", 0.023), ("crease_height_m", 0.030)])
@pytest.mark.parametrize("above", [-1e-4, 1e-4])
def test_heights_are_judged_against_those_of_the_ideal_fold(name: str, limit: float, above: float) -> None:
    figures = {n: Figure(0.0, math.inf) for n in ("height_m", "crease_height_m")}
    measured = Score({**figures, name: Figure(limit + above, math.inf)}, 2, 2 * THICKNESS)
    judged = measured.with_ideal(IdealHeights(0.020, 0.020))
    assert judged.failed == ((name,) if above > 0 else ()) and judged.flat is judged.passed is (above < 0)


# --- folds that must fail ------------------------------------------------------------------------------


def drifted(flat: np.ndarray, by: float) -> np.ndarray:
    return folded(flat) + np.array([0.0, by, 0.0])


def piled(flat: np.ndarray, height: float, width: float = 0.08) -> np.ndarray:
    """The moved half meets the table before its target and stands up in a wave of the same length."""
    final, moves = folded(flat), moved_part(flat)
    crest = LENGTH / 4
    along = np.linspace(0.0, LENGTH, 6001)
    phase = np.clip((along - crest) / width, -0.5, 0.5)
    wave = height / 2 * (1 + np.cos(2 * np.pi * phase))
    arc = np.concatenate([[0.0], np.cumsum(np.hypot(np.diff(along), np.diff(wave)))])
    reached = np.interp(flat[moves, 1], arc, along)
    final[moves, 1] = -reached
    final[moves, 2] += np.interp(reached, along, wave)
    return final


def sagged(flat: np.ndarray, by: float) -> np.ndarray:
    """The moved edge sagged: its middle lies `by` behind the corners [m]."""
    final, moves = folded(flat), moved_part(flat)
    across = 1.0 - (flat[moves, 0] / (WIDTH / 2)) ** 2
    final[moves, 1] += by * across * (flat[moves, 1] / (LENGTH / 2)) ** 2
    return final


def dropped(flat: np.ndarray, reach: float) -> np.ndarray:
    """One corner was lost and lies turned back along a diagonal, at the distance `reach` from the corner [m]."""
    final, moves = folded(flat), moved_part(flat)
    corner = np.array([-WIDTH / 2, -LENGTH / 2])  # the target of near_left
    bisector = np.array([1.0, 1.0]) / math.sqrt(2.0)
    depth = reach / math.sqrt(2.0) - (final[:, :2] - corner) @ bisector
    turned_back = moves & (depth > 0.0)
    final[turned_back, :2] += 2.0 * depth[turned_back, None] * bisector
    final[turned_back, 2] += THICKNESS
    return final


def left_behind(flat: np.ndarray, radius: float = 0.25) -> np.ndarray:
    """One corner stayed where it was, and the cloth beside it is stretched."""
    final = folded(flat)
    near = np.exp(-(((flat - CORNERS["near_left"]) / radius) ** 2).sum(axis=1))[:, None]
    final[:, :2] = (1 - near) * final[:, :2] + near * flat
    return final


@pytest.mark.parametrize(
    ("final", "figure"),
    [
        (lambda f: drifted(f, 0.060), "drift_m"),
        (lambda f: piled(f, 0.030), "height_m"),
        (lambda f: sagged(f, 0.040), "edges_m"),
        (lambda f: dropped(f, 0.060), "edges_m"),
        (left_behind, "edges_m"),
        (lambda f: np.column_stack([f, np.zeros(len(f))]), "iou"),
    ],
    ids=["drift 60 mm", "pile 30 mm", "sag 40 mm", "dropped corner", "corner left behind", "never folded"],
)
@pytest.mark.parametrize("edge", [0.025, 0.012])
def test_each_failure_fails_the_figure_that_names_it(final: object, figure: str, edge: float) -> None:
    flat, triangles = towel(edge)
    result = score(garment(flat, triangles, final(flat)))  # type: ignore[operator]
    assert not result.passed
    assert figure in result.failed, result.to_json()


@pytest.mark.parametrize(
    "final",
    [
        lambda f: drifted(f, 0.030),
        lambda f: piled(f, 0.010),
        lambda f: sagged(f, 0.020),
        lambda f: dropped(f, 0.015),
    ],
    ids=["drift 30 mm", "pile 10 mm", "sag 20 mm", "corner turned over 15 mm"],
)
def test_a_slight_flaw_still_passes(final: object) -> None:
    flat, triangles = towel()
    result = score(garment(flat, triangles, final(flat)))  # type: ignore[operator]
    assert result.passed, result.to_json()


def test_a_mirrored_fold_fails() -> None:
    flat, triangles = towel()
    final = folded(flat)
    final[:, 0] *= -1.0
    assert "correspondence_m" in score(garment(flat, triangles, final)).failed


def test_a_shrunk_fold_fails() -> None:
    flat, triangles = towel()
    final = folded(flat)
    final[:, :2] *= 0.85
    result = score(garment(flat, triangles, final))
    assert result.iou == pytest.approx(0.85**2, abs=0.01) and "iou" in result.failed


# --- invariances ---------------------------------------------------------------------------------------


@settings(max_examples=8)
@given(
    x=st.floats(-0.045, 0.045),
    y=st.floats(-0.02, 0.02),
    angle=st.floats(-math.radians(9.5), math.radians(9.5)),
)
def test_a_rigid_motion_changes_only_the_drift(x: float, y: float, angle: float) -> None:
    flat, triangles = towel()
    final = sagged(flat, 0.015)
    whole = garment(flat, triangles, final)
    still = score(whole)
    centre = np.average(whole.vertices[triangles, :2].mean(axis=1), axis=0, weights=_areas(flat, triangles))
    moved = whole.vertices.copy()
    moved[:, :2] = turned(moved[:, :2] - centre, 0.0, 0.0, angle) + centre + [x, y]
    result = score(FinalGarment(moved, triangles, whole.material, whole.lines, whole.thickness, whole.edge_pairs))
    for name in ("iou", "correspondence_m", "edges_m", "height_m"):
        assert result.figures[name].value == pytest.approx(still.figures[name].value, abs=1e-9), name
    assert result.figures["drift_m"].value <= still.figures["drift_m"].value + math.hypot(x, y) + 1e-9
    assert result.figures["drift_m"].value >= math.hypot(x, y) - still.figures["drift_m"].value - 0.001
    assert result.figures["drift_rad"].value == pytest.approx(
        abs(angle), abs=still.figures["drift_rad"].value + 1e-9
    )


@settings(max_examples=15)
@given(x=st.floats(-2.0, 2.0), y=st.floats(-2.0, 2.0), angle=st.floats(-math.pi, math.pi))
def test_the_score_does_not_depend_on_the_towels_pose(x: float, y: float, angle: float) -> None:
    flat, triangles = towel(0.03)
    final = sagged(flat, 0.02)
    a, b = score(garment(flat, triangles, final)), score(garment(flat, triangles, final, pose=(x, y, angle)))
    for name, figure in a.figures.items():
        tolerance = 0.006 if name == "iou" else 5e-4  # the raster lies differently over the shape
        assert b.figures[name].value == pytest.approx(figure.value, abs=tolerance), name


@pytest.mark.parametrize("final", [folded, lambda f: sagged(f, 0.03), lambda f: piled(f, 0.03)])
def test_refining_the_mesh_does_not_change_the_figures(final: object) -> None:
    coarse, fine = (score(garment(f, t, final(f))) for f, t in (towel(0.02), towel(0.01)))  # type: ignore[operator]
    for name, tolerance in (("iou", 0.02), ("correspondence_m", 0.001), ("edges_m", 0.001), ("height_m", 0.003)):
        assert coarse.figures[name].value == pytest.approx(fine.figures[name].value, abs=tolerance), name


def test_the_order_of_vertices_and_triangles_does_not_matter() -> None:
    flat, triangles = towel()
    whole = garment(flat, triangles, sagged(flat, 0.03))
    rng = np.random.default_rng(0)
    order = rng.permutation(len(flat))
    place = np.argsort(order)
    shuffled = rng.permutation(place[triangles][:, [2, 0, 1]].astype(np.int32))
    result = score(
        FinalGarment(
            whole.vertices[order],
            shuffled,
            whole.material[order],
            whole.lines,
            whole.thickness,
            whole.edge_pairs,
            whole.keypoints,
            whole.ideal,
        )
    )
    for name, figure in score(whole).figures.items():
        # A piece with four corners may be split along either diagonal, which moves its barycentres a little.
        assert result.figures[name].value == pytest.approx(figure.value, abs=2e-5), name


# --- parts of the scorer against independent implementations -------------------------------------------


def test_the_silhouette_agrees_with_opencv_and_shapely() -> None:
    """Intersection over union by the scorer's raster, by cv2.fillPoly and by exact polygons."""
    flat, triangles = towel(0.03)
    final, wanted = sagged(flat, 0.05), fold_mesh(flat, triangles, (HALF,), flat)
    whole = garment(flat, triangles, final, pose=(0.0, 0.0, 0.0))
    result = score(whole)
    offset, angle = _independent_alignment(final, wanted, triangles, flat)
    aligned = turned(final[:, :2], 0.0, 0.0, angle) + offset

    a, b = _union(aligned, triangles), _union(wanted.target, wanted.triangles)
    exact = a.intersection(b).area / a.union(b).area
    assert result.iou == pytest.approx(exact, abs=0.003)

    scale, shift = 4000, np.array([0.5, 0.5])
    masks = [np.zeros((4000, 4000), np.uint8) for _ in range(2)]
    for mask, xy, tris in ((masks[0], aligned, triangles), (masks[1], wanted.target, wanted.triangles)):
        for corners in np.rint((xy + shift) * scale).astype(np.int32)[tris]:
            cv2.fillPoly(mask, [corners], (1.0,))
    filled = (masks[0] & masks[1]).sum() / (masks[0] | masks[1]).sum()
    assert result.iou == pytest.approx(filled, abs=0.003)


def test_rasterising_a_plane_gives_its_heights_and_covers_each_pixel_once() -> None:
    flat, triangles = towel(0.02)
    xy = turned(flat, 0.4, 0.4, 0.3) / PIXEL
    top, count = rasterise(xy, 0.01 * xy[:, 0] - 0.02 * xy[:, 1] + 3.0, triangles, 900, 900)
    assert count.max() == 1
    assert count.sum() * PIXEL**2 == pytest.approx(LENGTH * WIDTH, rel=1e-3)
    rows, columns = np.nonzero(count)
    np.testing.assert_allclose(top[rows, columns], 0.01 * columns - 0.02 * rows + 3.0, atol=1e-9)


def test_pixels_on_shared_edges_belong_to_one_triangle() -> None:
    square = np.array([[0.0, 0.0], [8.0, 0.0], [8.0, 8.0], [0.0, 8.0]])
    for triangles in ([[0, 1, 2], [0, 2, 3]], [[2, 1, 0], [0, 2, 3]]):
        _, count = rasterise(square, np.zeros(4), np.array(triangles, np.int32), 12, 12)
        assert count.max() == 1 and count.sum() == 64


@settings(max_examples=25)
@given(
    offset=st.floats(-0.25, 0.25), angle=st.floats(-math.pi, math.pi), offset2=st.floats(-0.15, 0.15),
    angle2=st.floats(-math.pi, math.pi),
)  # fmt: skip
def test_a_cut_and_folded_mesh_is_an_isometry(offset: float, angle: float, offset2: float, angle2: float) -> None:
    """Areas are kept, every triangle is congruent to its rest shape, and no cloth is left on the last line's
    moving side."""
    lines = tuple(
        FoldLine(o * np.array([-math.sin(a), math.cos(a)]), np.array([math.cos(a), math.sin(a)]))
        for o, a in ((offset, angle), (offset2, angle2))
    )
    flat, triangles = towel(0.04)
    cut = fold_mesh(flat, triangles, lines, flat)
    assert cut.area.sum() == pytest.approx(LENGTH * WIDTH, rel=1e-9)
    for i, j in ((0, 1), (1, 2), (2, 0)):
        before = np.linalg.norm(cut.attributes[cut.triangles[:, i]] - cut.attributes[cut.triangles[:, j]], axis=1)
        after = np.linalg.norm(cut.target[cut.triangles[:, i]] - cut.target[cut.triangles[:, j]], axis=1)
        np.testing.assert_allclose(after, before, atol=1e-6)
    assert lines[-1].signed_distance(cut.target).max() < 1e-6


def test_the_scorers_target_equals_the_planners_target() -> None:
    flat, triangles = towel()
    cut = fold_mesh(flat, triangles, (HALF, QUARTER), flat)
    np.testing.assert_allclose(cut.target, fold_xy((HALF, QUARTER), cut.attributes), atol=1e-6)


def a_towel(name: str) -> Garment:
    """A towel with a plan like that of the shipped towels: either half onto the other, then either end onto the
    other."""

    def at(**weights: float) -> Anchor:
        return Anchor(tuple(weights.items()))

    def variant(*moves: str) -> PlanVariant:
        return PlanVariant("+".join(moves), moves, tuple(PlanGrasp(at(**{m: 1.0}), (0.01, 0.01)) for m in moves))

    plan = (
        PlanStep(
            "half",
            (at(near_right=0.5, far_right=0.5), at(near_left=0.5, far_left=0.5)),
            (variant("far_right", "far_left"), variant("near_right", "near_left")),
        ),
        PlanStep(
            "quarter",
            (at(near_right=0.5, near_left=0.5), at(far_right=0.5, far_left=0.5)),
            (variant("near_left", "far_left"), variant("near_right", "far_right")),
        ),
    )
    return Garment(
        name, "", "towel", 1, tuple(CORNERS), np.array([*CORNERS.values()]),
        Material(0.4, 0.03, 0.02, THICKNESS, 0.5, 0.4, 0.6), plan,
        ((("near_right", "near_left"), ("far_right", "far_left")),), 0.3,
        PoseRange((0.5, 0.6), (0.0, 0.0), (0.0, 0.0)), (0.8, 1.2), 4, "bare",
    )  # fmt: skip


def test_every_variant_sequence_is_a_valid_target_and_the_preferred_one_is_first() -> None:
    flat, triangles = towel()
    flat = turned(flat, *POSE)
    keypoints = {name: turned(p, *POSE) for name, p in CORNERS.items()}
    ways = ways_to_fold(a_towel("t"), keypoints)
    assert len(ways) == 4
    for lines in ways:
        cut = fold_mesh(flat, triangles, lines, flat)
        final = np.column_stack([cut.target, np.zeros(len(cut.target))])
        result = score_plan(final, cut.triangles, cut.attributes, keypoints, a_towel("t"), THICKNESS)
        assert result.passed and result.iou > 0.999 and result.layers == 4
        far = np.column_stack([turned(cut.target, 0.25, -0.1, 0.2), final[:, 2]])
        moved = score_plan(far, cut.triangles, cut.attributes, keypoints, a_towel("t"), THICKNESS)
        assert moved.iou > 0.999 and moved.figures["correspondence_m"].value < 1e-6, (
            "somebody has moved the folded towel"
        )
        assert not moved.passed and moved.figures["drift_rad"].value == pytest.approx(0.2, abs=1e-6)
        crooked = {**keypoints, "far_left": keypoints["far_left"] + (0.004, -0.003)}
        near = score_plan(final, cut.triangles, cut.attributes, crooked, a_towel("t"), THICKNESS)
        assert near.figures["drift_m"].passed and near.figures["drift_rad"].passed, (
            "half a turn makes the target of other variants fit, but nobody has turned the towel"
        )
    assert ways[0][0].signed_distance(keypoints["far_left"]) > 0.0
    half_done = np.column_stack([fold_xy(ways[0][:1], flat), np.zeros(len(flat))])
    assert not score_plan(half_done, triangles, flat, keypoints, a_towel("t"), THICKNESS).passed


def test_each_crease_is_as_long_as_its_fold_is_wide() -> None:
    flat, triangles = towel()
    creases = fold_mesh(flat, triangles, (HALF, QUARTER), flat).creases
    lengths = np.linalg.norm(creases[:, 0] - creases[:, 1], axis=1)
    assert lengths.sum() == pytest.approx(WIDTH + LENGTH, rel=1e-6)
    on_half = np.abs(creases[..., 1]).max(axis=1) < 1e-6
    assert lengths[on_half].sum() == pytest.approx(WIDTH, rel=1e-6)
    assert creases[on_half, :, 0].min() > -1e-6, "the second fold has folded the first crease"


def test_the_diagonal_of_a_garment_is_that_of_its_rectangle_in_any_pose() -> None:
    flat, _ = towel()
    for angle in (0.0, 0.4, 2.0):
        assert diagonal(turned(flat, 0.3, 0.1, angle)) == pytest.approx(math.hypot(LENGTH, WIDTH))


def test_key_points_just_off_a_rounded_corner_count_as_the_nearest_cloth() -> None:
    flat, triangles = towel()
    whole = garment(flat, triangles, folded(flat))
    centre = whole.material.mean(axis=0)
    out = tuple(tuple(1.02 * (p - centre) + centre for p in pair) for pair in whole.edge_pairs)
    result = score(
        FinalGarment(whole.vertices, triangles, whole.material, whole.lines, THICKNESS, out)  # type: ignore[arg-type]
    )
    assert result.figures["edges_m"].value < 1e-6


def test_the_layers_of_a_two_layer_garment_are_counted_and_allowed() -> None:
    """A two-layer garment that is folded once may be four layers high."""
    flat, triangles = towel()
    both = np.vstack([flat, flat])
    tris = np.vstack([triangles, triangles + len(flat)]).astype(np.int32)
    moves = moved_part(flat)
    lower, upper = folded(flat), folded(flat)
    lower[:, 2], upper[:, 2] = np.where(moves, 3, 0) * 0.012, np.where(moves, 2, 1) * 0.012
    whole = garment(both, tris, np.vstack([lower, upper]))
    result = score(FinalGarment(whole.vertices, tris, whole.material, whole.lines, 0.012, whole.edge_pairs))
    assert result.layers == 4 and result.passed, result.to_json()


def test_the_score_as_json_has_all_figures_and_limits() -> None:
    flat, triangles = towel()
    result = score(garment(flat, triangles, drifted(flat, 0.060)))
    read = json.loads(json.dumps(result.to_json()))
    assert read["passed"] is False and result.failed == ("drift_m",)
    assert read["drift_m"] == pytest.approx(0.060, abs=1e-3)
    assert read["limits"]["correspondence_m"] == pytest.approx(0.025 * math.hypot(LENGTH, WIDTH))
    assert read["limits"]["height_m"] == pytest.approx(2 * THICKNESS + 0.010)
    assert set(read) >= {"passed", "iou", "correspondence_m", "edges_m", "height_m", "drift_m", "drift_rad"}


@pytest.mark.parametrize("bad", [np.nan, np.inf, 5.1, 1e4])
def test_scoring_positions_that_are_not_finite_or_too_far_apart_raises(bad: float) -> None:
    flat, triangles = towel(0.04)
    final = folded(flat)
    final[7, 2] = bad
    with pytest.raises(InternalError):
        score(garment(flat, triangles, final))


# --- helpers -------------------------------------------------------------------------------------------


def _areas(flat: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    a, b = flat[triangles[:, 1]] - flat[triangles[:, 0]], flat[triangles[:, 2]] - flat[triangles[:, 0]]
    return np.abs(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]) / 2.0


def _union(xy: np.ndarray, triangles: np.ndarray) -> shapely.Geometry:
    return shapely.union_all(shapely.polygons(xy[triangles]), grid_size=1e-7)


def _independent_alignment(
    final: np.ndarray, wanted: object, triangles: np.ndarray, flat: np.ndarray
) -> tuple[np.ndarray, float]:
    """The alignment by scipy's Kabsch method over a fine, uniform sample of the cloth, instead of cut
    triangles."""
    x, y = np.meshgrid(np.linspace(-WIDTH / 2, WIDTH / 2, 161)[:-1] + WIDTH / 320,
                       np.linspace(-LENGTH / 2, LENGTH / 2, 241)[:-1] + LENGTH / 480)  # fmt: skip
    points = np.column_stack([x.ravel(), y.ravel()])
    goal = points * [1.0, 1.0]
    goal[:, 1] = -np.abs(goal[:, 1])
    mesh = Delaunay(flat)
    simplex = mesh.find_simplex(points)
    T = mesh.transform[simplex]
    w = np.einsum("nij,nj->ni", T[:, :2], points - T[:, 2])
    w = np.column_stack([w, 1.0 - w.sum(axis=1)])
    now = np.einsum("ni,nij->nj", w, final[mesh.simplices[simplex], :2])
    a, b = now.mean(0), goal.mean(0)
    pad = lambda p: np.column_stack([p, np.zeros(len(p))])  # noqa: E731
    rotation, _ = Rotation.align_vectors(pad(goal - b), pad(now - a))
    angle = rotation.as_rotvec()[2]
    return b - turned(a, 0.0, 0.0, angle), float(angle)
