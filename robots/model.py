"""Model of a two-armed robot for the motion skills: kinematics, collision geometry, limits and named poses.

A robot package (robots/baxter) creates a `RobotModel`. The skills receive it and never import the package.
`RobotModel` contains only models. Its users own the working memory (`pinocchio.Data`).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
import pinocchio as pin

from foldcell.robots.errors import ConfigurationError
from foldcell.robots.ports import Array, Side, arm_slice, frozen


@dataclass(frozen=True, eq=False)
class JointLimits:
    """Limits (joints,) of both arms: lower, upper [rad], velocity [rad/s], acceleration [rad/s2], jerk [rad/s3].

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


@dataclass(frozen=True, eq=False)
class ArmChain:
    """One arm as a chain of revolute joints, each about the z axis of its own frame.

    rotation (arm + 1, 3, 3), translation (arm + 1, 3): fixed placement before each joint. The first placement is
    relative to the base frame. The last one leads from the last joint to the tool frame.
    """

    rotation: Array
    translation: Array


@dataclass(frozen=True, eq=False)
class RobotModel:
    """The description of a robot that the skills use. Joint vectors have the order left arm, right arm
    (foldcell.robots.ports).

    pin_model: the whole robot, including other joints. collision_model: its geometry with the pairs to check.
    joint_index: (joints,) index of each arm joint in a configuration of pin_model. q_rest: (nq,) assumed positions
    of the other joints. tool_frame: name of each arm's tool frame. planning: limits of planned motions;
    commissioning: the slow limits; protective: limits of the hardware in a protective stop. q_park: (joints,) both
    arms out of the camera's view [rad]. head_pan: nominal angle of the head [rad]. floor: height of the floor in
    the base frame [m]. fingertips: collision objects of each arm that may touch the table in a grasp.
    contact_effort: change of a joint's effort in a descent that counts as a contact [Nm]; it has to exceed the
    change that the arm's own weight causes within a second.
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
    contact_effort: float = 9.0

    def limits(self, accelerations: str = "planning", velocity_scale: float | None = None) -> JointLimits:
        """Return the limits 'planning' or 'commissioning'. velocity_scale: replaces their velocities by this
        fraction of the joints' own limits."""
        chosen = {"planning": self.planning, "commissioning": self.commissioning}[accelerations]
        if velocity_scale is None:
            return chosen
        return replace(chosen, velocity=frozen(self.protective.velocity * velocity_scale))

    def configuration(self, q: Array) -> Array:
        """Convert arm joints (joints,) to a configuration (nq,) of `pin_model`."""
        full = self.q_rest.copy()
        full[self.joint_index.astype(np.intp)] = q
        return full

    def tool_pose(self, side: Side, q: Array) -> Array:
        """Compute T_base_tool (4, 4) at joint vector q (joints,) with Pinocchio."""
        data = self.pin_model.createData()
        pin.framesForwardKinematics(self.pin_model, data, self.configuration(q))
        T: Array = data.oMf[self.pin_model.getFrameId(self.tool_frame[side])].homogeneous
        return T

    def park(self, side: Side) -> Array:
        """Return the parked arm's joints (arm,) [rad]."""
        return self.q_park[self.arm(side)]

    def arm(self, side: Side) -> slice:
        """Return the slice of an arm's joints in a joint vector."""
        return arm_slice(side, len(self.q_park))


def arm_chain(model: pin.Model, joints: tuple[str, ...], tool_frame: str) -> ArmChain:
    """Return the chain of revolute joints that ends in `tool_frame`. Raises ValueError if there is no such
    chain."""
    ids = [model.getJointId(name) for name in joints]
    axes = []
    for before, joint in zip([0, *ids], ids, strict=False):
        axis = _axis(model.joints[joint])
        if axis is None or model.parents[joint] != before:
            raise ValueError(
                f"{model.names[joint]} is not a revolute joint with limits that follows {model.names[before]}"
            )
        axes.append(_z_to(axis))
    frame = model.frames[model.getFrameId(tool_frame)]
    if frame.parentJoint != ids[-1]:
        raise ValueError(f"{tool_frame} is not fixed to {joints[-1]}")
    placements = [model.jointPlacements[i] for i in ids] + [frame.placement]
    back, rotations, translations = np.eye(3), [], []
    for placement, to in zip(placements, [*axes, np.eye(3)], strict=True):
        rotations.append(back @ placement.rotation @ to)
        translations.append(back @ placement.translation)
        back = to.T
    return ArmChain(frozen(np.array(rotations)), frozen(np.array(translations)))


def _axis(joint: pin.JointModel) -> Array | None:
    """Return the axis (3,) of a revolute joint with limits in its own frame, or None for another joint."""
    kind = joint.shortname()
    if kind == "JointModelRevoluteUnaligned":
        return np.array(joint.extract().axis)
    return {f"JointModelR{name}": axis for name, axis in zip("XYZ", np.eye(3), strict=True)}.get(kind)


def _z_to(axis: Array) -> Array:
    """Return a rotation (3, 3) that turns z to a unit vector (3,)."""
    if axis[2] == 1.0:
        return np.eye(3)
    other = np.cross((0.0, 0.0, 1.0), axis)
    side = other / np.linalg.norm(other) if np.linalg.norm(other) > 1e-9 else np.array([1.0, 0.0, 0.0])
    return np.column_stack((side, np.cross(axis, side), axis))
