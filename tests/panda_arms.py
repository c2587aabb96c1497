"""Two Franka Emika Panda arms side by side, as a RobotModel that differs much from Baxter.

It has no torso and no head, an elbow whose range does not contain zero, and other limits and tools. The models are
those of the example-robot-data wheel.
"""

from __future__ import annotations

from functools import lru_cache
from importlib.metadata import distribution
from pathlib import Path

import coal
import numpy as np
import pinocchio as pin

from foldcell.robots.model import JointLimits, RobotModel, arm_chain
from foldcell.robots.ports import Array, Side, frozen

JOINTS = tuple(f"panda_joint{i}" for i in range(1, 8))
BASES = {Side.LEFT: 0.32, Side.RIGHT: -0.32}
"""y of each arm's base [m]. Both bases are at x = 0, z = 0 and face along x."""
PARK = np.array([0.9, -1.2, 0.0, -2.6, 0.0, 1.6, 0.8])
MIRROR = np.array([-1.0, 1.0, -1.0, 1.0, -1.0, 1.0, -1.0])
ACCELERATION, JERK = 5.0, 60.0  # [rad/s2], [rad/s3]: well below the data sheet's limits


def _package_root() -> Path:
    return Path(str(distribution("example-robot-data").locate_file("cmeel.prefix"))) / "share"


def _one_arm(side: Side) -> tuple[pin.Model, pin.GeometryModel]:
    """One arm. All its names begin with the side."""
    folder = _package_root() / "example-robot-data/robots/panda_description"
    urdf, srdf = ((folder / name).read_text() for name in ("urdf/panda.urdf", "srdf/panda.srdf"))
    urdf, srdf = (text.replace('"panda_', f'"{side}_panda_') for text in (urdf, srdf))
    model = pin.buildModelFromXML(urdf)
    geometry = pin.buildGeomFromUrdfString(
        model, urdf, pin.GeometryType.COLLISION, package_dirs=[str(_package_root())]
    )
    for shape in geometry.geometryObjects:
        if isinstance(shape.geometry, coal.BVHModelBase):
            shape.geometry.buildConvexHull(True, "Qt")
            shape.geometry = shape.geometry.convex
    geometry.addAllCollisionPairs()
    pin.removeCollisionPairsFromXML(model, geometry, srdf)
    return model, geometry


def _limits(model: pin.Model, index: Array, margin: float, share: float, dynamics: float) -> JointLimits:
    columns = index.astype(int)  # valid because all these joints have one coordinate
    return JointLimits(
        frozen(model.lowerPositionLimit[columns] + margin),
        frozen(model.upperPositionLimit[columns] - margin),
        frozen(share * model.velocityLimit[columns]),
        frozen(np.full(14, dynamics * ACCELERATION)),
        frozen(np.full(14, dynamics * JERK)),
    )


@lru_cache(maxsize=1)
def load_pandas() -> RobotModel:
    model, geometry = pin.Model(), pin.GeometryModel()
    allowed: set[frozenset[str]] = set()
    for side in Side:
        arm, shapes = _one_arm(side)
        names = [s.name for s in shapes.geometryObjects]
        allowed |= {frozenset((names[p.first], names[p.second])) for p in shapes.collisionPairs}
        place = pin.SE3(np.eye(3), np.array([0.0, BASES[side], 0.0]))
        model, geometry = pin.appendModel(model, arm, geometry, shapes, 0, place)
    geometry.removeAllCollisionPairs()
    names = [s.name for s in geometry.geometryObjects]
    for j, second in enumerate(names):
        for i, first in enumerate(names[:j]):
            if first.split("_")[0] != second.split("_")[0] or frozenset((first, second)) in allowed:
                geometry.addCollisionPair(pin.CollisionPair(i, j))
    joints = {side: tuple(f"{side}_{name}" for name in JOINTS) for side in Side}
    order = joints[Side.LEFT] + joints[Side.RIGHT]
    index = np.array([model.joints[model.getJointId(name)].idx_q for name in order])
    q_rest = pin.neutral(model)
    for side in Side:
        for finger in (1, 2):
            q_rest[model.joints[model.getJointId(f"{side}_panda_finger_joint{finger}")].idx_q] = 0.02
    return RobotModel(
        name="pandas",
        pin_model=model,
        collision_model=geometry,
        joint_names=order,
        joint_index=frozen(index),
        q_rest=frozen(q_rest),
        tool_frame={side: f"{side}_panda_hand_tcp" for side in Side},
        chains={side: arm_chain(model, joints[side], f"{side}_panda_hand_tcp") for side in Side},
        planning=_limits(model, index, 0.03, 0.8, 1.0),
        commissioning=_limits(model, index, 0.03, 0.4, 0.4),
        protective=_limits(model, index, 0.0, 1.0, 2.0),
        q_park=frozen(np.concatenate([PARK, PARK * MIRROR])),
        head_pan=0.0,
        floor=-0.90,
        fingertips={side: tuple(n for n in names if n.startswith(str(side)) and "finger" in n) for side in Side},
    )
