"""The height of the table as a hand feels it: the height from the joints, plus the deflection of arm and tips."""

from __future__ import annotations

import numpy as np
import pytest

from foldcell.cell.simulation.robot.contact import Stiffness, touch
from foldcell.skills.grasping.descend import ARM_STIFFNESS, TIP_STIFFNESS, yielding

SPRINGS = Stiffness(arm=ARM_STIFFNESS, tip=TIP_STIFFNESS, cloth=250.0)


@pytest.mark.parametrize("tips", [1, 2])
@pytest.mark.parametrize("depth", [0.001, 0.003])
def test_the_felt_height_is_corrected_by_the_deflection_of_arm_and_tips(tips: int, depth: float) -> None:
    other = 0.0 if tips == 2 else 0.01
    felt = touch(np.array([[0.0, 0.0, -depth], [0.0, 0.0, other - depth]]), np.zeros(2), SPRINGS).force.max()
    assert yielding(float(felt), tips) == pytest.approx(depth)
