"""Baxter's model: joint order, limits, tool frames, parked pose."""

from __future__ import annotations

import coal
import numpy as np
import pinocchio as pin
import pytest

from foldcell.cell.hardware.robot_check import view_margins
from foldcell.robots.baxter.robot import GRIPPER, MOUNT, load_model
from foldcell.robots.errors import ConfigurationError
from foldcell.robots.model import JointLimits, arm_chain
from foldcell.robots.ports import Side, arm_slice


@pytest.fixture(scope="module")
def model():
    return load_model()


def test_joints_are_left_then_right_from_shoulder_to_wrist(model):
    order = ["s0", "s1", "e0", "e1", "w0", "w1", "w2"]
    assert list(model.joint_names) == [f"left_{j}" for j in order] + [f"right_{j}" for j in order]
    q = np.arange(14) / 10
    full = model.configuration(q)
    for name, value in zip(model.joint_names, q, strict=True):
        assert full[model.pin_model.joints[model.pin_model.getJointId(name)].idx_q] == value


def test_protective_limits_are_the_published_ones(model):
    lower = [-1.7017, -2.147, -3.0542, -0.05, -3.059, -1.5708, -3.059]
    upper = [1.7017, 1.047, 3.0542, 2.618, 3.059, 2.094, 3.059]
    for side in Side:
        assert model.protective.lower[arm_slice(side, 14)] == pytest.approx(lower, abs=1e-3)
        assert model.protective.upper[arm_slice(side, 14)] == pytest.approx(upper, abs=1e-3)
        assert model.protective.velocity[arm_slice(side, 14)] == pytest.approx([1.5] * 4 + [4.0] * 3)


def test_named_limits_scale_the_velocity_only(model):
    half = model.limits("planning", 0.5)
    assert half.velocity == pytest.approx(0.5 * model.protective.velocity)
    assert half.acceleration is model.planning.acceleration
    with pytest.raises(KeyError):
        model.limits("reckless")


def test_invalid_limits_are_refused():
    good = np.ones(14)
    with pytest.raises(ConfigurationError, match="joint 0: the upper"):
        JointLimits(good, good, good, good, good)
    with pytest.raises(ConfigurationError, match="joint 3: the upper"):
        JointLimits(-good, np.where(np.arange(14) == 3, np.nan, good), good, good, good)
    with pytest.raises(ConfigurationError, match="jerk"):
        JointLimits(-good, good, good, good, 0 * good)
    for wrong in (np.nan, np.inf):
        with pytest.raises(ConfigurationError, match=f"joint 3: the velocity limit is {wrong}"):
            JointLimits(-good, good, np.where(np.arange(14) == 3, wrong, good), good, good)


@pytest.mark.parametrize("side", list(Side))
def test_pads_close_along_the_tools_y_and_meet_at_its_origin(model, side):
    """The convention of foldcell.robots.ports agrees with the finger joints and tips of the URDF."""
    pm = model.pin_model
    data = pm.createData()

    def tips(opening):
        q = model.configuration(np.linspace(-0.3, 0.9, 14))
        (left, _), (right, _) = GRIPPER.finger_joints[side]
        q[pm.joints[pm.getJointId(left)].idx_q] = opening
        q[pm.joints[pm.getJointId(right)].idx_q] = -opening
        pin.framesForwardKinematics(pm, data, q)
        tool = data.oMf[pm.getFrameId(model.tool_frame[side])]
        letter = side[0]
        return [
            tool.actInv(data.oMf[pm.getFrameId(f"{letter}_gripper_{f}_finger_tip")]).translation
            for f in ("l", "r")
        ]

    narrow, wide = tips(0.0), tips(0.02)
    for a, b, sign in zip(narrow, wide, (1.0, -1.0), strict=True):
        assert b - a == pytest.approx([0.0, sign * 0.02, 0.0], abs=1e-12)
        assert np.delete(a, 1) == pytest.approx([0.0, 0.0], abs=1e-9)
    assert narrow[0] + narrow[1] == pytest.approx([0, 0, 0], abs=1e-9)


def test_tool_z_points_out_of_the_hand(model):
    pm, data = model.pin_model, model.pin_model.createData()
    pin.framesForwardKinematics(pm, data, model.configuration(np.full(14, 0.4)))
    for side in Side:
        tool = data.oMf[pm.getFrameId(model.tool_frame[side])]
        wrist = data.oMi[pm.getJointId(f"{side}_w2")]
        assert tool.actInv(wrist.translation) == pytest.approx([0.0, 0.0, -0.27125], abs=1e-4)


def test_joints_that_form_no_chain_are_refused(model):
    joints = tuple(model.joint_names[:7])
    with pytest.raises(ValueError, match="follows"):
        arm_chain(model.pin_model, joints[::-1], "left_gripper")
    with pytest.raises(ValueError, match="not fixed"):
        arm_chain(model.pin_model, joints, "right_gripper")


def test_the_collision_geometry_is_convex_and_filtered_by_the_srdf(model):
    shapes = model.collision_model.geometryObjects
    assert not any(isinstance(s.geometry, coal.BVHModelBase) for s in shapes)
    names = {
        frozenset((shapes[p.first].name, shapes[p.second].name)) for p in model.collision_model.collisionPairs
    }
    assert len(names) == 519
    assert frozenset(("left_upper_shoulder_0", "left_lower_shoulder_0")) not in names
    assert frozenset(("left_wrist_0", "right_wrist_0")) in names


def test_the_arms_are_mirror_images_when_parked(model):
    left, right = (model.tool_pose(side, model.q_park) for side in Side)
    assert left[:3, 3] * [1, -1, 1] == pytest.approx(right[:3, 3], abs=1e-6)


def test_parked_arms_are_out_of_the_cameras_view(model):
    """Every arm link is completely outside one side plane of the view pyramid, by at least 10 mm."""
    margins = view_margins(model, MOUNT, model.q_park)
    assert len(margins) == 34 and min(margins.values()) > 0.010
