"""Assembling a workcell from its settings: motion limits, collision margins, and whether an operator attends."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
import pytest

from foldcell.cell.hardware.assembly import assemble
from foldcell.cell.hardware.workcell import Workcell
from foldcell.cell.states.commands import CommandQueue
from foldcell.cell.view.recorder import Recorder
from foldcell.robots.baxter.robot import load_model
from foldcell.robots.ports import Side, arm_slice
from foldcell.skills.motion.kinematics import ik
from foldcell.skills.vocabulary import tool_rotation
from tests.fakes import FakeCell
from tests.runs import fold_request

BAXTER = load_model()


def put_together(tmp_path: Path, motion: Mapping[str, float] = MappingProxyType({}), **changes: Any) -> Workcell:
    request = fold_request(tmp_path, {"motion": motion}, **changes)
    return assemble(
        request, BAXTER, FakeCell().ports(), Recorder.silent(), CommandQueue(), None,  # type: ignore[arg-type]
        lambda text: None, lambda done, total, remark: None,
    )  # fmt: skip


def test_motion_limits_come_from_the_settings(tmp_path: Path) -> None:
    motion = {
        "start_tolerance_deg": 0.5,
        "tracking_tolerance": 0.2,
        "max_state_age_s": 0.07,
        "velocity_scale": 0.5,
    }
    cell = put_together(tmp_path, motion)
    limits = cell.execution
    assert limits.start == pytest.approx(np.deg2rad(0.5))
    assert (limits.tracking, limits.stale_s) == (0.2, 0.07)
    full = put_together(tmp_path, {"velocity_scale": 1.0}).limits
    assert cell.limits.velocity == pytest.approx(0.5 * full.velocity)


@pytest.mark.parametrize("approve", [False, True])
def test_an_approving_operator_is_also_asked_after_the_last_recovery(tmp_path: Path, approve: bool) -> None:
    cell = put_together(tmp_path, approve=approve)
    assert cell.approve is cell.attended is approve


def fingers_at(cell: Workcell, height: float) -> np.ndarray:
    """Joints (14,) with the left hand pointing down and its fingertips at this height above the table [m]. The
    fingers end 5.15 mm beyond the tool centre point."""
    T = np.eye(4)
    T[:3, :3] = tool_rotation(np.zeros(1), np.zeros(1), np.zeros(1))[0]
    T[:3, 3] = [0.65, 0.25, cell.table.height + height + 0.00515]
    seeds = np.random.default_rng(5).uniform(-1, 1, (30, 7)) + BAXTER.park(Side.LEFT)
    cut = arm_slice(Side.LEFT, 14)
    seeds = np.clip(seeds, BAXTER.planning.lower[cut], BAXTER.planning.upper[cut])
    q = np.array(BAXTER.q_park)
    q[cut] = ik.solve_seeds(BAXTER, Side.LEFT, T, seeds)[0]
    return q


def test_the_execution_margin_is_two_millimetres_smaller_than_the_planning_margin(tmp_path: Path) -> None:
    """The arms deviate a little from the plan, so with equal margins a planned path could be refused at its
    start."""
    cell = put_together(tmp_path)
    verdicts = [
        (cell.checker.in_collision(q), cell.execution_checker.in_collision(q))
        for q in (fingers_at(cell, h) for h in (0.0205, 0.0195, 0.0185, 0.0175))
    ]
    assert verdicts == [(False, False), (True, False), (True, False), (True, True)]
