import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from foldcell.robots.ports import CameraFrame
from foldcell.skills.perception.rectification.table_view import TableView
from foldcell.skills.vocabulary import Table
from tests.scenes import TABLE, camera

VIEW = TableView(camera(), TABLE)
coordinate = st.tuples(st.floats(0.25, 1.0), st.floats(-0.5, 0.5))


@given(coordinate)
def test_to_pixel_and_to_table_are_inverse(xy):
    assert np.allclose(VIEW.to_table(VIEW.to_pixel(xy)), xy, atol=1e-12)


@given(coordinate)
def test_the_homography_is_the_pinhole_projection_of_the_table(xy):
    c = camera()
    T = np.linalg.inv(c.T_table_camera)
    p = c.intrinsics.matrix @ (T @ [*xy, 0.0, 1.0])[:3]
    q = VIEW.homography @ [*VIEW.to_pixel(xy), 1.0]
    assert np.allclose(q[:2] / q[2], p[:2] / p[2], atol=1e-9)


@given(coordinate, st.floats(0.0, 0.2))
def test_a_raised_point_appears_where_its_line_of_sight_meets_the_table(xy, z):
    seen = VIEW.shadow_on_table(np.array([*xy, z]))
    assert np.allclose(VIEW.to_image(seen), VIEW.to_image([*xy, z]), atol=1e-6)
    assert np.allclose(VIEW.to_table(VIEW.to_pixel(seen), z), xy, atol=1e-9)
    assert np.allclose(VIEW.at_height(np.array(xy), z), VIEW.to_pixel(seen), atol=1e-9)


def test_far_is_up_and_left_is_left_in_the_view():
    column, row = VIEW.to_pixel(np.array([TABLE.x[1], TABLE.y[1]]))
    assert column == pytest.approx(-0.5) and row == pytest.approx(-0.5)
    assert VIEW.to_pixel([0.9, 0.0])[1] < VIEW.to_pixel([0.4, 0.0])[1]
    assert VIEW.to_pixel([0.6, 0.3])[0] < VIEW.to_pixel([0.6, -0.3])[0]


def plane(up):
    """A frame of a plane that lies `up` [m] above the table."""
    c = camera()
    k, T = c.intrinsics, c.T_table_camera
    u, v = np.meshgrid(np.arange(k.width), np.arange(k.height))
    slope = T[2, 0] * (u - k.cx) / k.fx + T[2, 1] * (v - k.cy) / k.fy + T[2, 2]
    depth = ((up - T[2, 3]) / slope).astype(np.float32)
    return CameraFrame(0.0, 0, np.zeros((k.height, k.width, 3), np.uint8), depth, k)


def test_the_depth_of_a_raised_plane_becomes_its_height():
    frame = plane(0.03)
    frame.depth[200:210, 300:310] = np.nan
    height = VIEW.rectify(frame).height
    inner = VIEW.valid & np.isfinite(height)
    assert np.abs(height[inner] - 0.03).max() < 1e-5
    assert 0 < np.count_nonzero(VIEW.valid & ~np.isfinite(height)) < 1000


@pytest.mark.parametrize(("up", "seen"), [(-0.03, True), (0.3, True), (-0.11, False), (-9.0, False)])
def test_depth_far_below_the_table_is_invalid(up, seen):
    """Such depths come from mirror images in a shiny table or from a driver's farthest range."""
    assert np.isfinite(VIEW.rectify(plane(up)).height[VIEW.valid]).all() == seen


def test_a_square_on_the_table_is_a_square_in_the_view():
    """The square is drawn at eight times the camera's resolution and averaged. In the view it has 100 x 100 pixels
    of 2 mm."""
    c = camera()
    corners = np.array([[0.7, 0.1], [0.5, 0.1], [0.5, -0.1], [0.7, -0.1]])
    fine = np.zeros((480 * 8, 640 * 8), np.uint8)
    place = (VIEW.to_image(corners) + 0.5) * 8 - 0.5
    cv2.fillPoly(fine, [np.round(place * 16).astype(np.int32)], 255, shift=4)
    rgb = np.repeat(cv2.resize(fine, (640, 480), interpolation=cv2.INTER_AREA)[..., None], 3, axis=2)
    depth = np.ones((480, 640), np.float32)
    seen = VIEW.rectify(CameraFrame(0.0, 0, rgb, depth, c.intrinsics)).rgb[..., 0] > 127
    rows, columns = np.nonzero(seen)
    assert abs(np.count_nonzero(seen) - 100 * 100) < 100
    assert np.allclose(VIEW.to_table([columns.mean(), rows.mean()]), [0.6, 0.0], atol=3e-4)


def test_a_table_without_extent_is_refused():
    with pytest.raises(ValueError, match="too small"):
        TableView(camera(), Table(0.0, (0.3, 0.301), (-0.1, 0.1)))
