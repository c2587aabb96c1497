"""The height of the table as a hand feels it: arm and tips give way, which the hand's own height does not show."""

from __future__ import annotations

import numpy as np
import pytest

from cell.simulation.robot.contact import Stiffness, touch
from skills.grasping.settings import GraspSettings

SPRINGS = Stiffness(arm=1500.0, tip=2500.0, cloth=250.0)


@pytest.mark.parametrize("tips", [1, 2])
@pytest.mark.parametrize("force", [1.0, 1.5, 2.0, 2.5])
def test_the_felt_table_is_corrected_for_what_arm_and_tips_give_way(tips: int, force: float) -> None:
    other = 0.0 if tips == 2 else 0.005
    for depth in np.arange(0.0, 0.01, 1e-5):
        felt = touch(np.array([[0.0, 0.0, -depth], [0.0, 0.0, other - depth]]), np.zeros(2), SPRINGS).force.max()
        if felt >= force:
            break
    assert -depth < -0.001, "what the hand reads"
    assert -depth + GraspSettings().compliance * felt == pytest.approx(0.0, abs=0.45 * depth)
