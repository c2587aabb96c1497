import cv2
import numpy as np
import pytest

from benchmarks.perception.paper_method import segment_watershed
from foldcell.cell.hardware.photograph import photographed
from foldcell.skills.perception.outline import smooth_closed
from foldcell.skills.perception.rectification.heights import height_above
from foldcell.skills.perception.rectification.table_view import TableView
from foldcell.skills.perception.registration.boundary import refine_boundary
from foldcell.skills.perception.segmentation.colour_model import log_colour
from foldcell.skills.perception.segmentation.grabcut import segment_grabcut
from foldcell.skills.perception.segmentation.reference import segment_plain, segment_reference
from foldcell.skills.perception.segmentation.table_model import light_change
from tests.scenes import TABLE, TOWEL, Scene, camera, empty, place, render

VIEW = TableView(camera(), TABLE)


def true_mask(scene, polygon):
    """The mask of the polygon in the view, with the parallax of the slab."""
    raised = np.column_stack([polygon, np.full(len(polygon), scene.thickness)])
    mask = np.zeros(VIEW.shape, np.uint8)
    pixels = VIEW.to_pixel(VIEW.shadow_on_table(raised))
    cv2.fillPoly(mask, [np.round(pixels * 16).astype(np.int32)], 1, shift=4)
    return mask > 0


def iou(a, b):
    return np.count_nonzero(a & b) / np.count_nonzero(a | b)


def pair(picture, bare):
    seen, table = VIEW.rectify(picture), VIEW.rectify(bare)
    return seen, table, height_above(seen, table)


def compared(scene):
    """The segmentation of a scene by comparison with its empty table."""
    seen, table, height = pair(render(scene), empty(scene))
    return segment_reference(seen.rgb, table.rgb, seen.valid, height)


@pytest.mark.parametrize("seed", [0, 5, 26])
def test_the_reference_finds_a_towel_of_any_fabric(towel_picture, seed):
    scene, truth, picture, bare = towel_picture(seed)
    seen, table, height = pair(picture, bare)
    found = segment_reference(seen.rgb, table.rgb, seen.valid, height)
    assert iou(found.mask, true_mask(scene, truth)) > 0.97
    assert found.confidence > 0.8


def test_a_deep_wide_shadow_does_not_move_the_boundary():
    """The lamp is low at the side and the shadow's rim is 10 mm wide, but the contour stays within 3 mm."""
    towel = place(TOWEL, 0.6, 0.0, 0.1)
    scene = Scene(seed=2, polygons=[towel], thickness=0.003, light=(1.6, 0.9), shadow=0.6, wobble=0.0)
    found = compared(scene)
    points = VIEW.to_table(found.contour, scene.thickness).astype(np.float32)
    outside = [-cv2.pointPolygonTest(towel.astype(np.float32), (float(x), float(y)), True) for x, y in points]
    assert np.quantile(outside, 0.95) < 0.003


def test_depth_separates_dark_grey_cloth_from_a_shadow():
    towel = place(TOWEL * 0.8, 0.6, 0.0, 0.2)
    scene = Scene(seed=6, polygons=[towel], fabric=(0.27, 0.27, 0.27), table_colour=(0.5, 0.5, 0.5))
    found = compared(scene)
    assert iou(found.mask, true_mask(scene, towel)) > 0.93


@pytest.mark.parametrize("fabric", [(0.15, 0.25, 0.55), (0.75, 0.72, 0.68)], ids=["dark", "light"])
@pytest.mark.parametrize("size", [(1.5, 1.4), (1.7, 1.5), (1.85, 1.75)], ids=["51 %", "61 %", "78 %"])
def test_a_garment_that_covers_most_of_the_view_is_not_taken_for_a_change_of_light(size, fabric):
    """The light changes too: the whole picture is brighter by a tenth."""
    towel = place(TOWEL * size, 0.63, 0.0, 0.0)
    scene = Scene(seed=3, polygons=[towel], fabric=fabric, gain=1.1)
    found = compared(scene)
    assert iou(found.mask, true_mask(scene, towel)) > 0.97
    assert found.confidence > 0.9


def test_a_small_garment_is_separated_from_a_change_of_light_without_depth(towel_picture):
    _, _, picture, bare = towel_picture(0)
    seen, table, height = pair(picture, bare)
    image, reference = log_colour(seen.rgb), log_colour(table.rgb)
    by_colour = light_change(image, reference, seen.valid)
    assert np.array_equal(light_change(image, reference, seen.valid, height), by_colour)
    assert np.array_equal(light_change(image, reference, seen.valid, height + 0.02), by_colour), (
        "implausible heights are ignored"
    )


def test_a_wide_shadow_is_no_garment(bare_table):
    """The shadow is 40 x 30 cm, has half the brightness, and is flat."""
    table = VIEW.rectify(bare_table)
    shade = np.ones(VIEW.shape, np.float32)
    shade[100:250, 200:400] = 0.55
    shaded = (table.rgb * cv2.GaussianBlur(shade, (0, 0), 6)[..., None]).astype(np.uint8)
    noise = np.random.default_rng(0).normal(0, 0.002, VIEW.shape).astype(np.float32)
    found = segment_reference(shaded, table.rgb, table.valid, noise)
    assert not found.found and found.confidence == 0.0


def test_nothing_is_found_on_an_empty_table(bare_table):
    picture = render(Scene(seed=0, gain=1.1), sequence=7)
    seen, table, height = pair(picture, bare_table)
    assert not segment_reference(seen.rgb, table.rgb, seen.valid, height).found


def test_the_rim_of_the_view_replaces_a_missing_reference(towel_picture):
    scene, truth, picture, _ = towel_picture(0)
    seen = VIEW.rectify(picture)
    assert iou(segment_plain(seen.rgb, seen.valid).mask, true_mask(scene, truth)) > 0.93


def test_the_papers_watershed_finds_a_contrasting_towel_in_the_middle():
    towel = place(TOWEL, 0.62, 0.0, 0.0)
    scene = Scene(seed=1, polygons=[towel], table_contrast=0.02, shadow=0.2)
    seen = VIEW.rectify(render(scene))
    assert iou(segment_watershed(seen.rgb, seen.valid).mask, true_mask(scene, towel)) > 0.95


def test_the_contour_has_sub_pixel_accuracy():
    """The contour of a disc with exact pixel coverage has the right radius to a tenth of a pixel."""
    y, x = np.mgrid[0:200, 0:200]
    distance = np.hypot(x - 100.3, y - 99.6) - 60.4
    cover = np.clip(0.5 - distance, 0, 1)[..., None]
    rgb = (cover * np.array([40, 60, 160]) + (1 - cover) * np.array([180, 150, 110])).astype(np.uint8)
    table = np.broadcast_to(np.float32([180, 150, 110]) + 8, rgb.shape)
    contour, clear = refine_boundary(distance < 0.8, rgb, np.ascontiguousarray(table))
    radius = np.hypot(contour[:, 0] - 100.3, contour[:, 1] - 99.6)
    assert clear == 1.0
    assert abs(radius.mean() - 60.4) < 0.1 and radius.std() < 0.2


def test_smoothing_a_closed_sequence_keeps_its_mean_and_shifts_with_it():
    values = np.random.default_rng(3).random((50, 2))
    smooth = smooth_closed(values, 2.0)
    assert np.allclose(smooth.mean(axis=0), values.mean(axis=0))
    assert np.allclose(smooth_closed(np.roll(values, 7, axis=0), 2.0), np.roll(smooth, 7, axis=0))


@pytest.mark.parametrize(
    ("size", "fabric"),
    [((640, 480), (0.12, 0.12, 0.12)), ((1000, 700), (0.03, 0.03, 0.035)), ((800, 800), (0.55, 0.56, 0.58))],
    ids=["grey", "dark", "light"],
)
def test_grabcut_finds_cloth_on_boards_in_uneven_light(size, fabric):
    """A photograph by an unknown camera, without reference and depth, of boards with different brightness."""
    calibration, table = photographed((size[1], size[0]))
    towel = place(TOWEL * 0.8, 0.02, 0.03, 0.2)
    scene = Scene(
        seed=31, polygons=[towel], fabric=fabric, table_colour=(0.36, 0.22, 0.11), table_contrast=0.2, planks=0.1,
        gradient=(0.6, -0.5), thickness=0.0005,
    )  # fmt: skip
    view = TableView(calibration, table)
    seen = view.rectify(render(scene, calibration))
    found = segment_grabcut(seen.rgb, seen.valid)
    truth = np.zeros(view.shape, np.uint8)
    cv2.fillPoly(truth, [np.round(view.to_pixel(towel)).astype(np.int32)], 1)
    assert iou(found.mask, truth > 0) > 0.96


def test_grabcut_finds_nothing_on_bare_boards():
    seen = VIEW.rectify(render(Scene(seed=5, table_contrast=0.15)))
    assert not segment_grabcut(seen.rgb, seen.valid).found


def test_a_shadow_beside_dark_cloth_is_not_taken_for_it():
    """The dark region is a grey towel of 2.5 mm height and a flat shadow beside it."""
    towel = place(TOWEL * 0.8, 0.6, -0.1, 0.0)
    scene = Scene(seed=6, polygons=[towel], fabric=(0.2, 0.2, 0.2), table_colour=(0.5, 0.5, 0.5), shadow=0.2)
    seen, table, height = pair(render(scene), empty(scene))
    shade = np.ones(VIEW.shape, np.float32)
    low, high = np.round(VIEW.to_pixel(np.array([[0.72, 0.45], [0.48, 0.10]]))).astype(int)
    shade[low[1] : high[1], low[0] : high[0]] = 0.8
    rgb = (seen.rgb * cv2.GaussianBlur(shade, (0, 0), 4)[..., None]).astype(np.uint8)
    found = segment_reference(rgb, table.rgb, seen.valid, height)
    assert iou(found.mask, true_mask(scene, towel)) > 0.9
