"""The camera's bracket: its view, and its motion with the head."""

from __future__ import annotations

import numpy as np

from foldcell.robots.baxter.robot import EYE, MOUNT, TARGET
from foldcell.robots.ports import Array


def pixel(point: Array, pan: float = 0.0) -> Array:
    p = np.linalg.inv(MOUNT.T_base_camera(pan)) @ np.append(point, 1.0)
    u, v, w = MOUNT.intrinsics.matrix @ p[:3]
    assert w > 0
    return np.array([u / w, v / w])


def test_the_camera_sees_its_target_with_far_at_the_top_and_left_at_the_left() -> None:
    target = np.array(TARGET)
    np.testing.assert_allclose(pixel(target), [MOUNT.intrinsics.cx, MOUNT.intrinsics.cy], atol=1e-9)
    assert (
        pixel(target + np.array([0.1, 0, 0]))[1] < MOUNT.intrinsics.cy
    )  # up in the picture is further from the robot
    assert (
        pixel(target + np.array([0, 0.1, 0]))[0] < MOUNT.intrinsics.cx
    )  # left in the picture is the robot's left


def test_the_camera_sees_the_table_where_garments_lie() -> None:
    for x in (0.22, 1.10):
        for y in (-0.55, 0.55):
            u, v = pixel(np.array([x, y, -0.10]))
            assert 0 <= u < MOUNT.intrinsics.width and 0 <= v < MOUNT.intrinsics.height


def test_the_head_panel_is_below_every_line_of_sight() -> None:
    panel = np.array([0.2155, 0.0, 0.765])  # the panel's upper front edge
    p = np.linalg.inv(MOUNT.T_base_camera()) @ np.append(panel, 1.0)
    assert p[2] > 0, "the panel is in front of the camera"
    assert MOUNT.intrinsics.fy * p[1] / p[2] + MOUNT.intrinsics.cy > MOUNT.intrinsics.height


def test_the_camera_turns_about_the_head_joint() -> None:
    turned = MOUNT.T_base_camera(0.5)
    expected = MOUNT.T_base_head(0.5) @ np.linalg.inv(MOUNT.T_base_head(0.0)) @ np.append(EYE, 1.0)
    np.testing.assert_allclose(turned[:3, 3], expected[:3], atol=1e-12)
    np.testing.assert_allclose(turned[:3, :3] @ turned[:3, :3].T, np.eye(3), atol=1e-12)
    assert np.linalg.det(turned[:3, :3]) > 0.999
