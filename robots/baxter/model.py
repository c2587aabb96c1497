"""Baxter: kinematics, collision geometry and limits, from the URDF of the example-robot-data wheel.

The URDF's frames `left_gripper` and `right_gripper` are the tool frames, without an additional rotation: origin
between the fingertips, z out of the hand, y along the fingers' prismatic joints.
"""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path

import coal
import numpy as np
import pinocchio as pin

from robots.baxter.gripper import GRIPPER
from robots.errors import ConfigurationError
from robots.example_data import package_root
from robots.model import JointLimits, RobotModel, arm_chain
from robots.ports import Array, Side, frozen

__all__ = [
    "ARM_JOINTS",
    "JOINT_NAMES",
    "baxter_srdf_path",
    "baxter_urdf_path",
    "load_model",
]

ARM_JOINTS = ("s0", "s1", "e0", "e1", "w0", "w1", "w2")
JOINT_NAMES = tuple(f"{side}_{joint}" for side in Side for joint in ARM_JOINTS)
OPENING = 0.0208
"""Opening of the grippers in collision checks: half of the largest [m]."""

FLOOR = -0.924
"""Height of the floor in the base frame [m]."""

URDF_VELOCITY = np.array([1.5, 1.5, 1.5, 1.5, 4.0, 4.0, 4.0] * 2)
POSITION_MARGIN = 0.02
"""Distance between the position limits of planned motions and the hard stops [rad]."""

PARK_LEFT = np.array([0.31, -0.75, -0.98, 1.73, 0.85, 1.60, 0.72])
MIRROR = np.array([-1.0, 1.0, -1.0, 1.0, -1.0, 1.0, -1.0])
"""Factors that convert the joint angles of the left arm to those of the mirrored right arm. Rotations about z and
about the link axes change sign."""

Q_PARK = np.concatenate([PARK_LEFT, PARK_LEFT * MIRROR])
"""Parked arms (14,) [rad]. The hands are beside the near corners of the table, 0.2 m above it, at least 20 mm
outside the camera's view (tested), and about 1.1 s from the start and end of a towel's folds."""


def baxter_urdf_path() -> Path:
    """Return the path of the wheel's URDF. It refers to its meshes by `package://` URIs."""
    return package_root() / "example-robot-data/robots/baxter_description/urdf/baxter.urdf"


def baxter_srdf_path() -> Path:
    return baxter_urdf_path().parents[1] / "srdf/baxter_manipulation.srdf"


@lru_cache(maxsize=1)
def load_model() -> RobotModel:
    """Return the model of Baxter with both electric grippers. The wheel's files are read once per process (about
    0.1 s). Raises ConfigurationError if they are missing."""
    if not baxter_urdf_path().is_file():
        raise ConfigurationError(
            f"no file {baxter_urdf_path()}", "pip install --force-reinstall example-robot-data"
        )
    model = pin.buildModelFromUrdf(str(baxter_urdf_path()))
    index = np.array([model.joints[model.getJointId(name)].idx_q for name in JOINT_NAMES])
    q_rest = pin.neutral(model)
    for side in Side:
        for joint, position in GRIPPER.finger_positions(side, OPENING).items():
            q_rest[model.joints[model.getJointId(joint)].idx_q] = position
    return RobotModel(
        name="baxter",
        pin_model=model,
        collision_model=_collision_model(model),
        joint_names=JOINT_NAMES,
        joint_index=frozen(index),
        q_rest=frozen(q_rest),
        tool_frame={side: f"{side}_gripper" for side in Side},
        chains={
            side: arm_chain(model, tuple(f"{side}_{joint}" for joint in ARM_JOINTS), f"{side}_gripper")
            for side in Side
        },
        planning=_limits(model, index, POSITION_MARGIN, velocity=0.8, acceleration=3.0, jerk=30.0),
        commissioning=_limits(model, index, POSITION_MARGIN, velocity=0.5, acceleration=1.0, jerk=5.0, wrist=1.0),
        protective=_limits(model, index, 0.0, velocity=1.0, acceleration=6.0, jerk=120.0),
        q_park=frozen(Q_PARK),
        head_pan=0.0,
        floor=FLOOR,
        fingertips={side: _fingertips(side) for side in Side},
    )


def _limits(
    model: pin.Model,
    index: Array,
    margin: float,
    *,
    velocity: float,
    acceleration: float,
    jerk: float,
    wrist: float = 2.0,
) -> JointLimits:
    """Return limits of the 14 joints. velocity: fraction of the URDF's limit. acceleration [rad/s2], jerk
    [rad/s3]: for shoulder and elbow. wrist: factor for the acceleration and jerk of the wrist joints. margin:
    reduction of the position range at both ends [rad]."""
    share = np.array([1.0, 1.0, 1.0, 1.0, wrist, wrist, wrist] * 2)
    return JointLimits(
        lower=frozen(model.lowerPositionLimit[index] + margin),
        upper=frozen(model.upperPositionLimit[index] - margin),
        velocity=frozen(velocity * URDF_VELOCITY),
        acceleration=frozen(acceleration * share),
        jerk=frozen(jerk * share),
    )


def _fingertips(side: Side) -> tuple[str, ...]:
    letter = side[0]
    return tuple(
        f"{letter}_gripper_{finger}_finger{part}" for finger in ("l", "r") for part in ("_0", "_1", "_tip_0")
    )


def _collision_model(model: pin.Model) -> pin.GeometryModel:
    """Return the collision geometry with all pairs that the SRDF does not exclude. Meshes (torso, pedestal) become
    convex hulls."""
    geometry = pin.buildGeomFromUrdf(
        model, str(baxter_urdf_path()), pin.GeometryType.COLLISION, package_dirs=[str(package_root())]
    )
    for shape in geometry.geometryObjects:
        if isinstance(shape.geometry, coal.BVHModelBase):
            shape.geometry.buildConvexHull(True, "Qt")
            shape.geometry = shape.geometry.convex
    geometry.addAllCollisionPairs()
    pin.removeCollisionPairs(model, geometry, str(baxter_srdf_path()))
    return geometry
