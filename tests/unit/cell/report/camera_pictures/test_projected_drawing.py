"""Drawing over a camera picture: places by the pinhole equation, and colours of lines."""

from __future__ import annotations

import numpy as np
import pytest

from foldcell.cell.report.camera_pictures.projected_drawing import ProjectedDrawing
from tests.scenes import Scene, camera, render

RED = (255, 0, 0)


def test_points_are_projected_by_the_pinhole_equation() -> None:
    calibration = camera()
    drawing = ProjectedDrawing(render(Scene(), calibration), calibration)
    rng = np.random.default_rng(3)
    points = np.column_stack([rng.uniform(0.4, 0.8, 20), rng.uniform(-0.3, 0.3, 20), rng.uniform(0.0, 0.2, 20)])
    k, T = calibration.intrinsics, calibration.T_table_camera
    matrix = np.array([[k.fx, 0.0, k.cx], [0.0, k.fy, k.cy], [0.0, 0.0, 1.0]])
    for point, pixel in zip(points, drawing.pixels(points), strict=True):
        u, v, w = matrix @ T[:3, :3].T @ (point - T[:3, 3])
        scale = drawing.picture.shape[1] / k.width
        assert pixel == pytest.approx([scale * u / w, scale * v / w])


def test_points_behind_the_camera_are_left_out() -> None:
    calibration = camera()
    drawing = ProjectedDrawing(render(Scene(), calibration), calibration)
    before = drawing.picture.copy()
    behind = calibration.T_table_camera[:3, 3] - 0.5 * calibration.T_table_camera[:3, 2]
    assert np.isnan(drawing.pixels(behind)).all()
    drawing.line(np.stack([behind, behind + 0.01]), RED)
    drawing.dot(behind, RED)
    drawing.name("behind", behind)
    assert (drawing.picture == before).all()


def test_a_line_lies_where_its_points_are_and_dashes_cover_half_of_it() -> None:
    calibration = camera()
    frame = render(Scene(), calibration)
    ends = np.array([[0.5, -0.2], [0.5, 0.2]])
    places = np.column_stack([np.full(400, 0.5), np.linspace(-0.2, 0.2, 400)])
    covered = []
    for dashed in (False, True):
        drawing = ProjectedDrawing(frame, calibration)
        (drawing.dashes if dashed else drawing.line)(ends, RED)
        columns, rows = np.round(drawing.pixels(places)).astype(int).T
        covered.append((drawing.picture[rows, columns] == RED).all(axis=1).mean())
    assert covered[0] > 0.97 and 0.5 < covered[1] < 0.7, "with round ends, a little over half"
