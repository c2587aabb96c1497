"""The height of the table as a hand feels it: arm and tips give way, which the hand's own height does not show."""

from __future__ import annotations

import numpy as np
import pytest

from cell.simulation.robot.contact import Stiffness, touch
from skills.grasping.settings import GraspSettings

SETTINGS = GraspSettings()
SPRINGS = Stiffness(arm=SETTINGS.arm_stiffness, tip=SETTINGS.tip_stiffness, cloth=250.0)


@pytest.mark.parametrize("tips", [1, 2])
@pytest.mark.parametrize("depth", [0.001, 0.003])
def test_the_felt_table_is_corrected_for_what_arm_and_tips_give_way(tips: int, depth: float) -> None:
    other = 0.0 if tips == 2 else 0.01
    felt = touch(np.array([[0.0, 0.0, -depth], [0.0, 0.0, other - depth]]), np.zeros(2), SPRINGS).force.max()
    assert SETTINGS.yielding(float(felt), tips) == pytest.approx(depth)
