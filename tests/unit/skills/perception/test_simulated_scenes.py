"""A few scenes of the perception benchmark: garments through the simulated camera, with ground truth."""

import cv2
import numpy as np
import pytest

from benchmarks.perception.fabrics import LEAST_DIFFERENCE
from benchmarks.perception.pieces import Laying, draw_piece
from benchmarks.perception.scenes import TABLE, draw_scene, open_studio
from foldcell.cell.config.garments.garment_file import list_garments, load_garment
from foldcell.cell.simulation.camera.render_server import Shot
from foldcell.cell.simulation.garment.fabric import garment_uv
from foldcell.robots.baxter.robot import MOUNT
from tests.builders.shipped_settings import perceive


@pytest.mark.parametrize(("name", "seed"), [("long_sleeve_shirt_large", 900001), ("jeans", 900002)])
def test_key_points_of_garments_with_limbs_are_found(name, seed):
    scene = draw_scene(name, seed)
    garments = [load_garment(g) for g in list_garments()]
    seen = perceive(scene.frame, scene.calibration, TABLE, scene.reference, garments).unwrap()
    assert seen.garment == name and seen.state.category == scene.category
    errors = [np.linalg.norm(seen.state.keypoints[n] - p) for n, p in scene.keypoints.items()]
    assert max(errors) < 0.015 and np.median(errors) < 0.006
    assert scene.facts["colour_difference"] >= LEAST_DIFFERENCE and scene.camera_error < 0.01


def test_the_camera_shows_every_triangle_of_a_garment_in_two_layers():
    """The silhouette agrees with the pinhole projection of the mesh."""
    piece = draw_piece(load_garment("long_sleeve_shirt_small"), np.random.default_rng(5))
    uv = garment_uv(piece.mesh.rest, piece.mesh.layer)
    with open_studio(uv, piece.mesh.triangles, 5) as studio:
        above = piece.vertices + np.array([0.0, 0.0, TABLE.height])
        bare, seen = (studio.picture(Shot({}, x, studio.T_base_camera)) for x in (None, above))
        T = np.linalg.inv(studio.T_table_camera)
    c = piece.vertices @ T[:3, :3].T + T[:3, 3]
    k = MOUNT.intrinsics
    pixels = np.round((c[:, :2] / c[:, 2:] * (k.fx, k.fy) + (k.cx, k.cy)) * 16).astype(np.int32)
    drawn = np.zeros(seen.depth.shape, np.uint8)
    for triangle in piece.mesh.triangles:
        cv2.fillConvexPoly(drawn, pixels[triangle], 1, shift=4)
    shown = (bare.depth - seen.depth) > 1e-4
    inner = cv2.erode(drawn, np.ones((5, 5), np.uint8)) > 0
    outer = cv2.dilate(drawn, np.ones((5, 5), np.uint8)) > 0
    assert shown[inner].all() and not shown[~outer].any()


def test_the_key_points_of_a_piece_are_points_of_its_fabric():
    """A garment without wrinkles or swinging limbs has its key points near the template, except for its individual
    errors."""
    garment = load_garment("medium_towel")
    piece = draw_piece(garment, np.random.default_rng(2), Laying(0.0, 0.0, 0.0, 0.0, 0.0))
    assert set(piece.keypoints) == set(garment.keypoints)
    for point in piece.keypoints.values():
        assert np.linalg.norm(piece.vertices[:, :2] - point[:2], axis=1).min() < 0.014
    near_right, far_right, far_left = (piece.keypoints[n][:2] for n in ("near_right", "far_right", "far_left"))
    assert np.linalg.norm(far_right - near_right) == pytest.approx(0.40, abs=0.02)
    assert np.linalg.norm(far_left - far_right) == pytest.approx(0.60, abs=0.02)
