"""Model of a two-armed robot for the motion skills: kinematics, collision geometry, limits and named poses.

A robot package (robots/baxter) creates a `RobotModel`. The skills receive it and never import the package.
`RobotModel` contains only models. Its users own the working memory (`pinocchio.Data`).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
import pinocchio as pin

from robots.errors import ConfigurationError
from robots.ports import Array, Side, arm_slice, frozen

__all__ = ["ArmChain", "JointLimits", "RobotModel", "arm_chain"]


@dataclass(frozen=True, eq=False)
class JointLimits:
    """Limits of the 14 joints: lower, upper [rad], velocity [rad/s], acceleration [rad/s2], jerk [rad/s3].

    Raises ConfigurationError for an empty position range, and for other limits that are not positive and finite.
    """

    lower: Array
    upper: Array
    velocity: Array
    acceleration: Array
    jerk: Array

    def __post_init__(self) -> None:
        if not np.all(self.upper > self.lower):  # also true for NaN
            joint = int(np.flatnonzero(~(self.upper > self.lower))[0])
            raise ConfigurationError(
                f"joint {joint}: the upper position limit {self.upper[joint]} does not exceed the lower one "
                f"{self.lower[joint]}",
                "correct the robot's model or the settings of its limits",
                joint=joint,
            )
        for name in ("velocity", "acceleration", "jerk"):
            values = getattr(self, name)
            wrong = np.flatnonzero(~((values > 0.0) & np.isfinite(values)))
            if len(wrong):
                joint = int(wrong[0])
                raise ConfigurationError(
                    f"joint {joint}: the {name} limit is {values[joint]}; it has to be positive and finite",
                    "correct the robot's model or the settings of its limits",
                    joint=joint,
                )

    def scaled(self, factor: float) -> JointLimits:
        """The same position range, with velocity, acceleration and jerk multiplied by `factor`."""
        return JointLimits(
            self.lower, self.upper, self.velocity * factor, self.acceleration * factor, self.jerk * factor
        )


@dataclass(frozen=True, eq=False)
class ArmChain:
    """One arm as seven revolute joints, each about the z axis of its own frame.

    rotation (8, 3, 3), translation (8, 3): fixed placement before each joint. The first placement is relative to
    the base frame. The eighth leads from the last joint to the tool frame.
    """

    rotation: Array
    translation: Array


@dataclass(frozen=True, eq=False)
class RobotModel:
    """The description of a robot that the skills use. Vectors of 14 have the order left arm, right arm
    (robots.ports).

    pin_model: the whole robot, including other joints. collision_model: its geometry with the pairs to check.
    joint_index: (14,) index of each arm joint in a configuration of pin_model. q_rest: (nq,) assumed positions of
    the other joints. tool_frame: name of each arm's tool frame. planning: limits of planned motions;
    commissioning: the slow limits; protective: limits of the hardware in a protective stop. q_park: (14,) both
    arms out of the camera's view [rad]. head_pan: nominal angle of the head [rad]. floor: height of the floor in
    the base frame [m]. fingertips: collision objects of each arm that may touch the table in a grasp.
    """

    name: str
    pin_model: pin.Model
    collision_model: pin.GeometryModel
    joint_names: tuple[str, ...]
    joint_index: Array
    q_rest: Array
    tool_frame: Mapping[Side, str]
    chains: Mapping[Side, ArmChain]
    planning: JointLimits
    commissioning: JointLimits
    protective: JointLimits
    q_park: Array
    head_pan: float
    floor: float
    fingertips: Mapping[Side, tuple[str, ...]]

    def limits(self, accelerations: str = "planning", velocity_scale: float | None = None) -> JointLimits:
        """Return the limits 'planning' or 'commissioning'. velocity_scale: replaces their velocities by this
        fraction of the joints' own limits."""
        chosen = {"planning": self.planning, "commissioning": self.commissioning}[accelerations]
        if velocity_scale is None:
            return chosen
        return replace(chosen, velocity=frozen(self.protective.velocity * velocity_scale))

    def configuration(self, q: Array) -> Array:
        """Convert arm joints (14,) to a configuration (nq,) of `pin_model`."""
        full = self.q_rest.copy()
        full[self.joint_index.astype(np.intp)] = q
        return full

    def tool_pose(self, side: Side, q: Array) -> Array:
        """Compute T_base_tool (4, 4) at joint vector q (14,) with Pinocchio."""
        data = self.pin_model.createData()
        pin.framesForwardKinematics(self.pin_model, data, self.configuration(q))
        T: Array = data.oMf[self.pin_model.getFrameId(self.tool_frame[side])].homogeneous
        return T

    def park(self, side: Side) -> Array:
        """Return the parked arm's joints (7,) [rad]."""
        return self.q_park[arm_slice(side)]


def arm_chain(model: pin.Model, joints: tuple[str, ...], tool_frame: str) -> ArmChain:
    """Return the chain of seven joints that ends in `tool_frame`. Raises ValueError if there is no such chain."""
    ids = [model.getJointId(name) for name in joints]
    for before, joint in zip([0, *ids], ids, strict=False):
        if model.joints[joint].shortname() != "JointModelRZ" or model.parents[joint] != before:
            raise ValueError(
                f"{model.names[joint]} is not a revolute joint about z that follows {model.names[before]}"
            )
    frame = model.frames[model.getFrameId(tool_frame)]
    if frame.parentJoint != ids[-1]:
        raise ValueError(f"{tool_frame} is not fixed to {joints[-1]}")
    placements = [model.jointPlacements[i] for i in ids] + [frame.placement]
    return ArmChain(
        frozen(np.array([p.rotation for p in placements])), frozen(np.array([p.translation for p in placements]))
    )
