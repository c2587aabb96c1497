"""Figures of the arms that no planner needs, for measuring plans and for checking the planners' own figures."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from foldcell.robots.model import ArmChain
from foldcell.robots.ports import Array
from foldcell.skills.motion.kinematics import ik
from foldcell.skills.motion.validation.collision import CollisionChecker


def clearance(checker: CollisionChecker, q: Array, *, allow_fingertips: bool = False) -> float:
    """Compute the smallest distance of all pairs at q (joints,) [m]. allow_fingertips: ignore the pairs of fingers
    and table."""
    model, geometry = checker.model, checker._geometry
    data = geometry.createData()
    pin.updateGeometryPlacements(
        model.pin_model, model.pin_model.createData(), geometry, data, model.configuration(q)
    )
    skipped = checker._finger_pairs if allow_fingertips else []
    pairs = [i for i in range(len(geometry.collisionPairs)) if i not in skipped]
    return float(min(pin.computeDistance(geometry, data, i).min_distance for i in pairs))


def jacobian(chain: ArmChain, q: Array) -> Array:
    """Jacobian (6, arm) of the tool's origin at q (arm,): linear above angular, in the base frame's axes."""
    n = len(q)
    axes, origins, p, J = np.empty((n, 3)), np.empty((n, 3)), np.empty(3), np.empty((6, n))
    ik._forward(chain.rotation, chain.translation, np.asarray(q, float), axes, origins, np.empty((3, 3)), p)
    ik._fill_jacobian(axes, origins, p, J)
    return J
