"""What follows from a model with another number of joints: the chain, inverse kinematics, timing, set-points."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest

from foldcell.robots.baxter.robot import load_model
from foldcell.robots.example_data import package_root
from foldcell.robots.model import ArmChain, JointLimits, RobotModel, arm_chain
from foldcell.robots.ports import Side
from foldcell.robots.setpoint import clip_setpoint
from foldcell.skills.motion.kinematics import ik
from foldcell.skills.motion.validation.failures import validate_state

JOINTS = tuple(
    f"{name}_joint" for name in ("shoulder_pan", "shoulder_lift", "elbow", "wrist_1", "wrist_2", "wrist_3")
)
URDF = package_root() / "example-robot-data/robots/ur_description/urdf/ur5_gripper.urdf"


@pytest.fixture(scope="module")
def arm() -> pin.Model:
    """A UR5, whose joints turn about the y and z axes of their frames."""
    return pin.buildModelFromUrdf(str(URDF))


@pytest.fixture(scope="module")
def model(arm: pin.Model) -> RobotModel:
    """Two such arms at the same place, for the skills that read only chains and limits."""
    chain = arm_chain(arm, JOINTS, "tool0")
    both = np.full(12, 1.0)
    limits = JointLimits(-3.1 * both, 3.1 * both, 2.0 * both, 5.0 * both, 60.0 * both)
    names = tuple(f"{side}_{name}" for side in Side for name in JOINTS)
    return replace(
        load_model(), joint_names=names, chains=dict.fromkeys(Side, chain), planning=limits, protective=limits,
        q_park=np.tile([0.3, -1.5, 1.2, -1.0, -1.5, 0.2], 2),
    )  # fmt: skip


def test_a_chain_with_an_oblique_axis_agrees_with_pinocchio() -> None:
    model, axis = pin.Model(), np.array([0.48, -0.6, 0.64])
    first = model.addJoint(0, pin.JointModelRX(), pin.SE3.Random(), "first")
    second = model.addJoint(first, pin.JointModelRevoluteUnaligned(axis), pin.SE3.Random(), "second")
    model.addFrame(pin.Frame("tool", second, pin.SE3.Random(), pin.FrameType.OP_FRAME))
    chain: ArmChain = arm_chain(model, ("first", "second"), "tool")
    data, q = model.createData(), np.array([0.7, -1.1])
    pin.framesForwardKinematics(model, data, q)
    assert np.abs(ik.tool_pose(chain, q) - data.oMf[model.getFrameId("tool")].homogeneous).max() < 1e-12


def test_other_joints_are_no_chain() -> None:
    model = pin.Model()
    model.addJoint(0, pin.JointModelPZ(), pin.SE3.Identity(), "slides")
    model.addFrame(pin.Frame("tool", 1, pin.SE3.Identity(), pin.FrameType.OP_FRAME))
    with pytest.raises(ValueError, match="slides is not a revolute joint"):
        arm_chain(model, ("slides",), "tool")


def test_a_straight_path_of_the_tool_is_followed(model: RobotModel) -> None:
    chain, q0 = model.chains[Side.LEFT], model.park(Side.LEFT)
    T = ik.tool_pose(chain, q0)
    position = T[:3, 3] + np.linspace(0.0, 0.1, 21)[:, None] * np.array([0.0, 0.0, -1.0])
    solution = ik.follow_path(model, Side.LEFT, np.tile(T[:3, :3], (21, 1, 1)), position, q0)
    assert solution.shape == (21, 6)
    for q, p in zip(solution, position, strict=True):
        assert ik.tool_pose(chain, q)[:3, 3] == pytest.approx(p, abs=1e-8)


def test_states_and_set_points_are_checked_by_the_models_size(model: RobotModel) -> None:
    assert validate_state(model, model.q_park) is None
    failure = validate_state(model, np.zeros(14))
    assert failure is not None and "12 finite numbers" in failure.what
    sent = clip_setpoint(model.q_park + 1.0, np.zeros(12), model.q_park, model.q_park, model.protective, 0.0)
    assert sent.clipped and sent.q.shape == (12,)
