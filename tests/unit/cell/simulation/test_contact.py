"""Fingertips on table and cloth: springs in balance."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from foldcell.cell.simulation.robot.contact import Stiffness, finger_axes, fingertips, touch
from foldcell.robots.baxter.robot import GRIPPER

S = Stiffness(arm=1500.0, tip=2500.0, cloth=250.0)
depth = st.floats(-0.02, 0.02)


def tips(a: float, b: float) -> np.ndarray:
    return np.array([[0.5, 0.01, a], [0.5, -0.01, b]])


@given(depth, depth)
def test_the_arm_yields_until_the_forces_balance(a: float, b: float) -> None:
    felt = touch(tips(a, b), np.zeros(2), S)
    assert felt.force.sum() == pytest.approx(S.arm * felt.lift, abs=1e-9)
    assert (felt.force >= 0).all()
    if min(a, b) >= 0:
        assert felt.lift == 0.0


def test_force_grows_with_the_layers_pressed() -> None:
    one, two = (touch(tips(0.0, 0.0), np.full(2, top), S).force[0] for top in (0.0025, 0.005))
    assert one == pytest.approx(250.0 * 0.0025)
    assert two == pytest.approx(2 * one)
    assert touch(tips(0.006, 0.006), np.full(2, 0.005), S).force.max() == 0.0


def test_the_distance_between_the_tips_follows_the_opening() -> None:
    a, b = fingertips(GRIPPER, np.zeros(3), np.diag([1.0, -1.0, -1.0]), 0.03)
    assert np.linalg.norm(a - b) == pytest.approx(0.03 + GRIPPER.pad_thickness)
    assert a[1] < b[1]  # finger 0 is on the tool's +y side


def test_fingers_rest_on_the_layers_below_them() -> None:
    down = np.diag([1.0, -1.0, -1.0])
    low, high = finger_axes(GRIPPER, np.array([0.5, 0, -0.01]), down, 0.02, np.array([0.003, 0.0]), 0.0)
    assert low[:, 2].tolist() == pytest.approx([0.011, 0.008])
    assert (high[:, 2] > 0.07).all()
