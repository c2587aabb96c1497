"""The `RobotModel` of a robot that one URDF describes."""

from __future__ import annotations

import coal
import numpy as np
import pinocchio as pin

from foldcell.robots.errors import ConfigurationError
from foldcell.robots.model import JointLimits, RobotModel, arm_chain
from foldcell.robots.ports import Array, Side, frozen
from foldcell.robots.urdf.description import Dynamics, RobotDescription
from foldcell.robots.urdf.elements import neighbours, resolved


def build_model(description: RobotDescription) -> RobotModel:
    """Build the model. Raises ConfigurationError if the URDF is not readable, lacks a joint or link that the
    description names, or an arm is not a chain of revolute joints with limits."""
    try:
        return _built(description)
    except (ValueError, RuntimeError) as error:
        raise ConfigurationError(
            f"the URDF of the robot '{description.name}' cannot be used: {error}",
            f"correct {description.source()} or the robot's description",
            robot=description.name,
        ) from error


def _built(description: RobotDescription) -> RobotModel:
    text = resolved(description.urdf(), description.meshes())
    model = pin.buildModelFromXML(text)
    _expect_names(description, model)
    index = np.array([model.joints[model.getJointId(name)].idx_q for name in description.joint_names])
    q_rest = pin.neutral(model)
    for side in Side:
        for joint, position in description.gripper.finger_positions(side, description.opening).items():
            q_rest[model.joints[model.getJointId(joint)].idx_q] = position
    geometry = _collision_model(description, model, text)
    return RobotModel(
        name=description.name,
        pin_model=model,
        collision_model=geometry,
        joint_names=description.joint_names,
        joint_index=frozen(index),
        q_rest=frozen(q_rest),
        tool_frame=description.tool_links,
        chains={
            side: arm_chain(model, description.arm_joints[side], description.tool_links[side]) for side in Side
        },
        planning=_limits(description, model, index, description.planning, description.position_margin),
        commissioning=_limits(description, model, index, description.commissioning, description.position_margin),
        protective=_limits(description, model, index, description.protective, 0.0),
        q_park=frozen(np.concatenate([description.park[side] for side in Side])),
        head_pan=0.0,
        contact_effort=description.contact_effort,
        floor=description.floor,
        fingertips={
            side: tuple(
                shape.name
                for shape in geometry.geometryObjects
                if model.frames[shape.parentFrame].name in description.fingers[side]
            )
            for side in Side
        },
    )


def _expect_names(description: RobotDescription, model: pin.Model) -> None:
    fingers = [name for side in Side for name, _ in description.gripper.finger_joints[side]]
    missing = [name for name in (*description.joint_names, *fingers) if not model.existJointName(name)]
    links = [*description.tool_links.values(), *(link for side in Side for link in description.fingers[side])]
    missing += [name for name in links if not model.existBodyName(name)]
    if missing:
        raise ValueError(f"it has no {', '.join(missing)}")


def _limits(
    description: RobotDescription, model: pin.Model, index: Array, dynamics: Dynamics, margin: float
) -> JointLimits:
    position = index.astype(np.intp)
    velocity = np.array([model.joints[model.getJointId(name)].idx_v for name in description.joint_names])
    share = np.tile([*[1.0] * (len(index) // 2 - 3), *[dynamics.wrist] * 3], 2)
    return JointLimits(
        lower=frozen(model.lowerPositionLimit[position] + margin),
        upper=frozen(model.upperPositionLimit[position] - margin),
        velocity=frozen(dynamics.velocity * model.velocityLimit[velocity]),
        acceleration=frozen(dynamics.acceleration * share),
        jerk=frozen(dynamics.jerk * share),
    )


def _collision_model(description: RobotDescription, model: pin.Model, text: str) -> pin.GeometryModel:
    """Return the collision geometry with all pairs of links that are neither neighbours nor disabled. Meshes
    become convex hulls."""
    geometry = pin.buildGeomFromUrdfString(model, text, pin.GeometryType.COLLISION)
    for shape in geometry.geometryObjects:
        if isinstance(shape.geometry, coal.BVHModelBase):
            shape.geometry.buildConvexHull(True, "Qt")
            shape.geometry = shape.geometry.convex
    apart = neighbours(text) | description.disabled_pairs()
    link = [model.frames[shape.parentFrame].name for shape in geometry.geometryObjects]
    for first in range(len(link)):
        for second in range(first + 1, len(link)):
            if link[first] != link[second] and frozenset((link[first], link[second])) not in apart:
                geometry.addCollisionPair(pin.CollisionPair(first, second))
    return geometry
