from dataclasses import replace

import numpy as np
import pytest

from foldcell.robots.errors import FailureKind
from foldcell.robots.ports import CameraFrame
from foldcell.skills.perception.classify import Match
from foldcell.skills.perception.drawing import draw_on_camera, draw_overlay
from foldcell.skills.perception.outline import polygon_area
from tests.builders.shipped_settings import PERCEPTION, perceive
from tests.builders.silhouettes import Silhouette
from tests.scenes import TABLE, TOWEL, TOWEL_NAMES, Scene, camera, empty, place, render

TRIANGLE = Silhouette("pennant", "pennant", ("a", "b", "c"), np.array([[0.3, 0.0], [-0.2, 0.25], [-0.2, -0.25]]))


def failure(outcome):
    assert outcome.failure is not None
    return outcome.failure.kind


def test_key_points_of_towels_are_found_to_a_few_millimetres(towel_picture, calibration, towels):
    errors = []
    for seed in range(6):
        _, truth, picture, bare = towel_picture(seed)
        seen = perceive(picture, calibration, TABLE, bare, towels, "medium_towel").unwrap()
        errors += [np.linalg.norm(seen.state.keypoints[n] - p) for n, p in zip(TOWEL_NAMES, truth, strict=True)]
        assert seen.state.category == "towel" and seen.state.confidence > 0.8
        assert polygon_area(seen.state.contour) > 0
        assert seen.state.ambiguous == ("rotated_180", "mirrored")
    assert np.median(errors) < 0.003 and max(errors) < 0.008


def test_auto_recognises_the_towel_by_its_size(towel_picture, calibration, towels):
    _, _, picture, bare = towel_picture(0)
    assert perceive(picture, calibration, TABLE, bare, towels).unwrap().garment == "medium_towel"


def test_the_same_picture_gives_the_same_state(towel_picture, calibration, towels):
    _, _, picture, bare = towel_picture(1)
    a, b = (perceive(picture, calibration, TABLE, bare, towels).unwrap().state for _ in range(2))
    assert np.array_equal(a.contour, b.contour) and a.confidence == b.confidence
    assert all(np.array_equal(a.keypoints[n], b.keypoints[n]) for n in TOWEL_NAMES)


def test_a_garment_whose_key_points_are_uncertain_is_refused(towel_picture, calibration, towels):
    _, _, picture, bare = towel_picture(1)
    sure = perceive(picture, calibration, TABLE, bare, towels).unwrap().state.confidence
    strict = replace(PERCEPTION, least_confidence=sure + 1e-6)
    refused = perceive(picture, calibration, TABLE, bare, towels, settings=strict)
    assert failure(refused) is FailureKind.LOW_CONFIDENCE
    assert refused.failure.values["keypoint"] in TOWEL_NAMES
    assert refused.failure.values["confidence"] == sure


def test_an_empty_table_is_no_garment(bare_table, calibration, towels):
    picture = render(Scene(seed=0), sequence=5)
    assert failure(perceive(picture, calibration, TABLE, bare_table, towels)) is FailureKind.NO_GARMENT


CIRCLE = np.linspace(0, 2 * np.pi, 40, endpoint=False)
PLATE = 0.2 * np.stack([np.cos(CIRCLE), np.sin(CIRCLE)], axis=1) + (0.6, 0.0)
"""A flexible contour also follows a disc, but the polygon of its key points does not."""
HAND = np.array([[0.21, 0.45], [0.21, 0.53], [0.42, 0.50], [0.42, 0.46]])
LYING = place(TOWEL, 0.6, 0.0, 0.0)


@pytest.mark.parametrize(
    ("polygons", "bumps", "kind", "hint"),
    [
        ([place(TOWEL, 0.6, 0.40, 0.0)], [], FailureKind.OUT_OF_VIEW, "nearer"),
        ([place(TOWEL * 0.6, 0.6, 0.25, 0.1), place(TOWEL * 0.5, 0.6, -0.2, 0.0)], [], FailureKind.UNKNOWN_GARMENT,
         "single"),
        ([LYING, HAND], [], FailureKind.VIEW_OBSTRUCTED, "hands"),
        ([LYING], [(0.6, 0.05, 0.09, 0.07)], FailureKind.NOT_FLAT, "flat"),
        ([PLATE], [], FailureKind.UNKNOWN_GARMENT, "flat"),
    ],
    ids=["out of view", "two garments", "hand", "pile", "plate"],
)  # fmt: skip
def test_what_is_no_single_flat_garment_in_view_is_refused_with_a_hint(
    calibration, towels, polygons, bumps, kind, hint
):
    scene = Scene(seed=3, polygons=polygons, bumps=bumps)
    outcome = perceive(render(scene), calibration, TABLE, empty(scene), towels)
    assert failure(outcome) is kind and hint in outcome.failure.hint


def test_wrong_category_wrong_size_and_unknown_garments_are_refused(calibration, towels):
    scene = Scene(seed=3, polygons=[place(TOWEL * 0.7, 0.6, 0.0, 0.1)])
    picture, bare = render(scene), empty(scene)
    known = [*towels, TRIANGLE]
    wrong = perceive(picture, calibration, TABLE, bare, known, "pennant")
    assert failure(wrong) is FailureKind.CATEGORY_MISMATCH
    small = perceive(picture, calibration, TABLE, bare, known, "large_towel")
    assert failure(small) is FailureKind.CATEGORY_MISMATCH and small.failure.values["scale"] < 0.7
    assert perceive(picture, calibration, TABLE, bare, known, "small_towel").ok
    assert failure(perceive(picture, calibration, TABLE, bare, [TRIANGLE])) is FailureKind.UNKNOWN_GARMENT
    with pytest.raises(ValueError, match="none of"):
        perceive(picture, calibration, TABLE, bare, towels, "sock")


@pytest.mark.parametrize("size", [0.7, 1.0, 1.18, 1.3])
def test_a_second_perception_accepts_exactly_what_the_first_one_recognised(calibration, towels, size):
    """There is one known towel, and cloth of its shape in other sizes. Both perceptions accept the cloth, or
    neither does."""
    scene = Scene(seed=3, polygons=[place(TOWEL * size, 0.62, 0.0, 0.1)])
    picture, bare = render(scene), empty(scene)
    first = perceive(picture, calibration, TABLE, bare, towels[:1])
    second = perceive(picture, calibration, TABLE, bare, towels[:1], "medium_towel")
    assert first.ok == second.ok == (abs(np.log(size)) < np.log(1.2))
    if not first.ok:
        assert failure(first) is FailureKind.UNKNOWN_GARMENT and failure(second) is FailureKind.CATEGORY_MISMATCH
        assert first.failure.values["scale"] == second.failure.values["scale"] == pytest.approx(size, abs=0.02)
        assert f"{first.failure.values['scale']:.2f} times" in first.failure.what


@pytest.mark.parametrize(("overlap", "taken"), [(0.955, True), (0.94, False)])
def test_the_second_best_match_is_taken_if_only_its_size_fits(calibration, towels, monkeypatch, overlap, taken):
    """An exception is a match with a much worse overlap, which a second perception would refuse."""
    known = [towels[0], Silhouette("napkin", "napkin", TOWEL_NAMES, TOWEL * 0.7)]
    matches = (Match(known[0], 0.98, 0.7), Match(known[1], overlap, 1.0))
    monkeypatch.setattr("foldcell.skills.perception.perceive.classify", lambda contour, garments: matches)
    scene = Scene(seed=3, polygons=[place(TOWEL * 0.7, 0.6, 0.0, 0.1)])
    picture, bare = render(scene), empty(scene)
    first = perceive(picture, calibration, TABLE, bare, known)
    second = perceive(picture, calibration, TABLE, bare, known, "napkin")
    assert first.ok == second.ok == taken
    assert not taken or first.unwrap().garment == "napkin"


def test_a_small_towel_whose_size_is_known_is_no_print(calibration, towels, monkeypatch):
    """It is found last, as a proposal, in a picture without the empty table's."""
    monkeypatch.setattr("foldcell.skills.perception.perceive.segmentations", lambda views, method: ())
    monkeypatch.setattr("foldcell.skills.perception.usable_region.LEAST_RECTANGLE", 0.2)
    scene = Scene(seed=3, polygons=[place(TOWEL * 0.7, 0.6, 0.0, 0.1)])
    assert perceive(render(scene), calibration, TABLE, None, towels).unwrap().garment == "small_towel"


def broken(frame, how):
    if how == "black":
        return replace(frame, rgb=np.zeros_like(frame.rgb))
    if how == "overexposed":
        return replace(frame, rgb=np.minimum(frame.rgb.astype(int) * 3, 255).astype(np.uint8))
    if how == "no depth":
        return replace(frame, depth=np.full_like(frame.depth, np.nan))
    if how == "another lens":
        return replace(frame, intrinsics=replace(frame.intrinsics, cy=frame.intrinsics.cy - 60.0))
    return CameraFrame(frame.stamp, frame.sequence, frame.rgb[::2, ::2], frame.depth[::2, ::2], frame.intrinsics)


@pytest.mark.parametrize("how", ["black", "overexposed", "no depth", "another lens", "half the resolution"])
def test_camera_faults_are_reported(towel_picture, calibration, towels, how):
    _, _, picture, bare = towel_picture(0)
    outcome = perceive(broken(picture, how), calibration, TABLE, bare, towels)
    assert failure(outcome) is FailureKind.CAMERA_FAULT
    assert outcome.failure.hint
    outcome = perceive(picture, calibration, TABLE, broken(bare, how), towels)
    assert failure(outcome) is FailureKind.CAMERA_FAULT


@pytest.mark.parametrize("method", ["reference", "plain", "grabcut"])
@pytest.mark.parametrize("target", [(-2.0, 0.1, 0.9), (0.6, 0.01, 3.0)], ids=["away", "up"])
def test_a_camera_that_does_not_see_the_table_gives_no_reference(towel_picture, towels, method, target):
    _, _, frame, reference = towel_picture(0)
    elsewhere = camera(target=target)
    for bare in (reference, None):
        seen = perceive(frame, elsewhere, TABLE, bare, towels, settings=replace(PERCEPTION, method=method))
        assert seen.failure is not None and seen.failure.kind is FailureKind.CAMERA_FAULT
        assert "does not look at the table" in seen.failure.what and seen.failure.hint


@pytest.mark.parametrize("far", [2.5, 10.0, 65.535])
def test_a_mirror_image_in_the_empty_table_gives_the_garment_no_height(towel_picture, calibration, towels, far):
    """A mirror image in a shiny table is measured as far below the table."""
    _, truth, frame, reference = towel_picture(3)
    depth = reference.depth.copy()
    depth[200:260, 280:360] = far
    depth[np.isnan(depth)] = far
    seen = perceive(frame, calibration, TABLE, replace(reference, depth=depth), towels).unwrap()
    known = perceive(frame, calibration, TABLE, reference, towels).unwrap()
    assert seen.top == pytest.approx(known.top, abs=2e-4)
    assert all(np.linalg.norm(seen.state.keypoints[n] - p) < 0.01 for n, p in zip(TOWEL_NAMES, truth, strict=True))


def test_a_frozen_camera_is_distinguished_from_a_still_scene(towel_picture, calibration, towels):
    scene, _, picture, bare = towel_picture(0)
    stale = replace(picture, stamp=picture.stamp + 1.0, sequence=picture.sequence + 1)
    outcome = perceive(stale, calibration, TABLE, bare, towels, previous=picture)
    assert failure(outcome) is FailureKind.CAMERA_FAULT
    still = render(scene, sequence=1)
    assert perceive(still, calibration, TABLE, bare, towels, previous=picture).ok


def test_a_shifted_calibration_shifts_the_key_points(towel_picture, towels):
    """Positions depend on the calibration: with a camera calibrated 10 mm further left, all points are 10 mm
    further left."""
    _, _, picture, bare = towel_picture(2)
    believed = camera()
    believed.T_table_camera[1, 3] += 0.010
    a = perceive(picture, camera(), TABLE, bare, towels).unwrap().state.keypoints
    b = perceive(picture, believed, TABLE, bare, towels).unwrap().state.keypoints
    for name in TOWEL_NAMES:
        assert np.allclose(b[name] - a[name], [0.0, 0.010], atol=1.5e-3)


def test_an_overlay_does_not_change_the_picture(towel_picture, calibration, towels):
    _, _, picture, bare = towel_picture(0)
    seen = perceive(picture, calibration, TABLE, bare, towels).unwrap()
    before = picture.rgb.copy()
    drawn = draw_on_camera(seen, picture.rgb)
    assert np.array_equal(picture.rgb, before)
    assert drawn.shape == picture.rgb.shape
    corner = np.round(seen.view.to_image(seen.state.keypoints["far_left"])).astype(int)
    assert drawn[corner[1], corner[0], 0] > 200 > drawn[corner[1], corner[0], 1]
    assert np.array_equal(draw_overlay(picture.rgb), picture.rgb)
