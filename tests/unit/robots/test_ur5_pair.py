"""The pair of UR5 arms: its model, its parked pose, and its body in PyBullet."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from pathlib import Path

import numpy as np
import pybullet as pb
import pytest

from foldcell.cell.hardware.robot_check import view_margins
from foldcell.cell.view.entries.robot import RobotFigure
from foldcell.robots.ports import Side
from foldcell.robots.registry import find_robot
from foldcell.robots.ur5_pair.robot import DESCRIPTION, ROBOT
from foldcell.robots.urdf.bullet_body import BulletBody
from foldcell.robots.urdf.converted import moving_urdf, seen_urdf, viewer_urdf

MODEL = ROBOT.load_model()
MIRROR = np.diag([1.0, -1.0, 1.0])


def test_the_registry_knows_it_with_six_joints_an_arm() -> None:
    assert find_robot("ur5_pair") is ROBOT
    assert len(MODEL.joint_names) == 12 and MODEL.chains[Side.LEFT].rotation.shape == (7, 3, 3)


def test_the_parked_arms_are_mirror_images_with_the_hands_down() -> None:
    left, right = (MODEL.tool_pose(side, MODEL.q_park) for side in Side)
    assert left[:3, 3] == pytest.approx(MIRROR @ right[:3, 3], abs=1e-6)
    assert left[2, 2] < -0.99 and right[2, 2] < -0.99


def test_the_parked_arms_are_out_of_the_cameras_view() -> None:
    margins = view_margins(MODEL, ROBOT.camera, MODEL.q_park)
    assert len(margins) == 18 and min(margins.values()) > 0.04


def test_tool_poses_of_the_body_agree_with_the_model(client: int) -> None:
    body, rng = BulletBody(client, moving_urdf(DESCRIPTION), DESCRIPTION), np.random.default_rng(2)
    for _ in range(5):
        q = rng.uniform(MODEL.planning.lower, MODEL.planning.upper)
        body.place(q, 0.0, dict.fromkeys(Side, 0.02))
        for side in Side:
            position, rotation = body.tool_pose(side)
            T = MODEL.tool_pose(side, q)
            np.testing.assert_allclose(position, T[:3, 3], atol=1e-5)
            np.testing.assert_allclose(rotation, T[:3, :3], atol=1e-5)


def test_the_parked_body_stands_still_without_contact(client: int) -> None:
    body, opening = BulletBody(client, moving_urdf(DESCRIPTION), DESCRIPTION), dict.fromkeys(Side, 0.0)
    body.place(MODEL.q_park, 0.0, opening)
    for _ in range(120):
        body.drive(MODEL.q_park, np.zeros(12), 0.0, opening)
        pb.stepSimulation(physicsClientId=client)
    q, qd, _, pan = body.read()
    assert not pb.getContactPoints(body._body, body._body, physicsClientId=client) and pan == 0.0
    assert np.abs(q - MODEL.q_park).max() < 0.005 and np.abs(qd).max() < 0.01


def test_the_files_work_without_the_installation_that_wrote_them() -> None:
    for urdf in (moving_urdf(DESCRIPTION), seen_urdf(DESCRIPTION), viewer_urdf(DESCRIPTION)):
        meshes = [Path(m.attrib["filename"]) for m in ET.parse(urdf).iter("mesh")]
        assert len(meshes) == 14 and all(m.is_file() and m.parent == urdf.parent for m in meshes)


def test_the_view_shows_its_links_and_moves_its_joints() -> None:
    figure, t = RobotFigure(ROBOT.visual()), np.array([0.0, 0.1])
    assert len(figure.scene()) == 2
    assert len(figure.joints(t, np.tile(MODEL.q_park, (2, 1)), np.zeros(2))) == 12
    assert len(figure.fingers(Side.LEFT, t, np.array([0.0, 0.02]))) == 2
