"""Load the model of the robot that the settings name. The settings may also state how its arms park."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache

from foldcell.cell.config.cell_settings import CellSettings
from foldcell.robots.errors import ConfigurationError
from foldcell.robots.model import RobotModel
from foldcell.robots.ports import Side
from foldcell.robots.registry import find_robot
from foldcell.skills.vocabulary import frozen


def load_robot(settings: CellSettings) -> RobotModel:
    """Return the robot's model; the same settings give the same object.

    Raises ConfigurationError with key and value if the angles of a parked arm do not fit its number of joints.
    """
    return _parked(find_robot(settings.robot).load_model(), settings.park.left, settings.park.right)


# checkers and kinematics are cached by the model's identity
@lru_cache(maxsize=4)
def _parked(model: RobotModel, left: tuple[float, ...] | None, right: tuple[float, ...] | None) -> RobotModel:
    if left is None and right is None:
        return model
    q = model.q_park.copy()
    for side, angles in ((Side.LEFT, left), (Side.RIGHT, right)):
        if angles is None:
            continue
        joints = len(model.park(side))
        if len(angles) != joints:
            raise ConfigurationError(
                f"park.{side.value} = {list(angles)}: {len(angles)} angles",
                f"an arm of this robot has {joints} joints; or null for its own parked posture",
            )
        q[model.arm(side)] = angles
    return replace(model, q_park=frozen(q))
