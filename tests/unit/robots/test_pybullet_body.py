"""Baxter's body in PyBullet: poses, stiffness and self-collision."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from pathlib import Path

import numpy as np
import pinocchio as pin
import pybullet as pb

from foldcell.robots.baxter.robot import DESCRIPTION, GRIPPER, load_model
from foldcell.robots.ports import Array, Side
from foldcell.robots.urdf.bullet_body import BulletBody
from foldcell.robots.urdf.converted import moving_urdf, seen_urdf

OPEN = dict.fromkeys(Side, GRIPPER.max_opening)
STRETCHED = np.array([0.6, 0.0, 0.0, 0.05, 0.0, 0.0, 0.0, -0.6, 0.0, 0.0, 0.05, 0.0, 0.0, 0.0])


def pinocchio_pose(q: Array, side: Side) -> pin.SE3:
    model = load_model()
    full = model.q_rest.copy()
    full[model.joint_index] = q
    data = model.pin_model.createData()
    pin.framesForwardKinematics(model.pin_model, data, full)
    return data.oMf[model.pin_model.getFrameId(model.tool_frame[side])]


def test_tool_poses_agree_with_pinocchio(client: int) -> None:
    body = BulletBody(client, moving_urdf(DESCRIPTION), DESCRIPTION)
    limits = load_model().planning
    rng = np.random.default_rng(2)
    for _ in range(5):
        q = rng.uniform(limits.lower, limits.upper)
        body.place(q, 0.0, OPEN)
        for side in Side:
            position, rotation = body.tool_pose(side)
            expected = pinocchio_pose(q, side)
            np.testing.assert_allclose(position, expected.translation, atol=1e-5)
            np.testing.assert_allclose(rotation, expected.rotation, atol=1e-5)


def test_stretched_arms_do_not_sag(client: int) -> None:
    body = BulletBody(client, moving_urdf(DESCRIPTION), DESCRIPTION)
    body.place(STRETCHED, 0.0, OPEN)
    for _ in range(240):
        body.drive(STRETCHED, np.zeros(14), 0.0, OPEN)
        pb.stepSimulation(physicsClientId=client)
    q, _, effort, _ = body.read()
    assert np.abs(q - STRETCHED).max() < 0.007
    assert np.abs(effort[[1, 8]]).min() > 30.0  # joint S1 carries the arm's weight


def test_neighbouring_links_do_not_collide(client: int) -> None:
    body = BulletBody(client, moving_urdf(DESCRIPTION), DESCRIPTION)
    body.place(load_model().q_park, 0.0, OPEN)
    for _ in range(60):
        body.drive(load_model().q_park, np.zeros(14), 0.0, OPEN)
        pb.stepSimulation(physicsClientId=client)
    assert not pb.getContactPoints(body._body, body._body, physicsClientId=client)
    assert np.abs(body.read()[1]).max() < 0.01


def test_arms_do_not_pass_through_each_other(client: int) -> None:
    body = BulletBody(client, moving_urdf(DESCRIPTION), DESCRIPTION)
    start = STRETCHED.copy()
    body.place(start, 0.0, OPEN)
    goal = start.copy()
    goal[[0, 7]] = [-1.2, 1.2]  # both upper arms reach across the body
    touched = False
    for k in range(480):
        share = min(1.0, k / 360)
        body.drive(start + share * (goal - start), np.zeros(14), 0.0, OPEN)
        pb.stepSimulation(physicsClientId=client)
        touched = touched or bool(pb.getContactPoints(body._body, body._body, physicsClientId=client))
    left, _ = body.tool_pose(Side.LEFT)
    right, _ = body.tool_pose(Side.RIGHT)
    assert touched
    assert left[1] > right[1] - 0.05  # the arms are still on their own sides


def test_robot_files_use_no_package_paths_and_only_the_needed_meshes() -> None:
    moving, seen = moving_urdf(DESCRIPTION).read_text(), seen_urdf(DESCRIPTION).read_text()
    assert "package://" not in moving + seen
    assert "<visual" not in moving and "<collision" in moving
    assert "<collision" not in seen and "<visual" in seen


def test_robot_files_work_without_the_installation_that_wrote_them() -> None:
    """A cache that points into another clone's environment breaks when that clone is deleted."""
    for urdf in (moving_urdf(DESCRIPTION), seen_urdf(DESCRIPTION)):
        meshes = [Path(m.attrib["filename"]) for m in ET.parse(urdf).iter("mesh")]
        assert meshes and all(m.is_file() and m.parent == urdf.parent for m in meshes)
