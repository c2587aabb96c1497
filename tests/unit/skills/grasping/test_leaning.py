"""The fingertips of a leaning hand: where the lower one touches, against the geometry of the simulated fingers."""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest

from foldcell.cell.config.cell_settings import load_settings
from foldcell.cell.simulation.robot.contact import Stiffness, fingertips, touch
from foldcell.robots.registry import find_robot, list_robots
from foldcell.skills.grasping.descend import ARM_STIFFNESS, TIP_STIFFNESS, yielding
from foldcell.skills.grasping.standing import lower_tip, standing_height, to_stand_at
from foldcell.skills.motion.kinematics.posture import Posture
from foldcell.skills.motion.moves.posture_search import PITCH, ROLL
from foldcell.skills.vocabulary import GraspId, ToolPath

SPRINGS = Stiffness(arm=ARM_STIFFNESS, tip=TIP_STIFFNESS, cloth=250.0)
TOO_LOW = 0.002
"""Depth of the commanded lower tip below the table [m]."""
WAY = ToolPath(np.zeros(1), np.zeros((1, 3)), np.full(1, 0.7), np.zeros(1), np.zeros(1))


@pytest.mark.parametrize("name", list_robots())
def test_a_leaning_hand_s_touch_is_right_for_all_leans_of_the_search(name: str) -> None:
    """The middle between the tips is as high as computed when the lower tip of the simulated hand touches. The
    table's height follows from a touch that is some newtons hard."""
    robot, settings = find_robot(name), load_settings()
    distance = robot.gripper.tip_distance(settings.gripper.opening)
    for pitch, roll, turned in product(PITCH, ROLL, (False, True)):
        rotation = Posture(GraspId.LEFT, turned, float(pitch), float(roll)).rotation(WAY)[0]
        tips = fingertips(robot.gripper, np.zeros(3), rotation, settings.gripper.opening)
        below = lower_tip(distance, float(pitch))
        assert below == pytest.approx(-tips[:, 2].min(), abs=1e-6)
        commanded = np.array([0.0, 0.0, below - TOO_LOW])
        felt = touch(tips + commanded, np.zeros(2), SPRINGS)
        table = commanded[2] - below + yielding(float(felt.force.max()), 1 if pitch else 2)
        assert table == pytest.approx(0.0, abs=1e-4)


@pytest.mark.parametrize("wanted", [0.0, 0.0012, -0.002])
def test_a_leaning_hand_stands_as_high_as_it_is_pushed_to(wanted: float) -> None:
    """Arm and tip yield to the table. With closed pads, the middle between the tips is where it was wanted."""
    gripper = find_robot("baxter").gripper
    for pitch, roll in product(PITCH[PITCH != 0.0], ROLL):
        rotation = Posture(GraspId.LEFT, False, float(pitch), float(roll)).rotation(WAY)[0]
        below = lower_tip(gripper.tip_distance(0.004), float(pitch))
        commanded = to_stand_at(wanted, below)
        tips = fingertips(gripper, np.array([0.0, 0.0, commanded]), rotation, 0.004)
        lift = touch(tips, np.zeros(2), SPRINGS).lift
        assert standing_height(commanded, below) == pytest.approx(commanded + lift, abs=1e-9)
        if wanted > -below:  # else the upper tip touches, too, and lifts the hand
            assert commanded + lift == pytest.approx(wanted, abs=1e-6)
