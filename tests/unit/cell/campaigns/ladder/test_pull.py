"""The pull of the ladder at a cell without dynamics: it ends with the slip, and before the effort of a contact."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from typing import Any, cast

import numpy as np
import pytest

from foldcell.cell.campaigns.ladder.pull import REACH, pulling
from foldcell.cell.config.cell_settings import load_settings
from foldcell.cell.hardware.camera import camera_calibration
from foldcell.cell.hardware.workcell import Workcell
from foldcell.cell.states.fold_context import FoldContext
from foldcell.cell.states.run_context import RunContext
from foldcell.robots.errors import Failure, FailureKind
from foldcell.robots.ports import Array, JointState, Ports, Side, frozen
from foldcell.skills.grasping.confirm import Held
from foldcell.skills.grasping.tare import TactileBias
from foldcell.skills.motion.kinematics.ik import tool_pose
from tests.fakes import FakeCell
from tests.kinematic_cell import KinematicCell, kinematic_rig
from tests.workcells import fake_workcell

SETTINGS = load_settings()
FORCE = 0.5  # of the cloth on each cell [N]


def tools(cell: Any, q: Array) -> Array:
    return np.array([tool_pose(cell.robot.chains[side], q[cell.robot.arm(side)])[:3, 3] for side in Side])


@contextmanager
def holding(slips_at: float = np.inf, strains_at: float = np.inf) -> Iterator[Workcell]:
    """A cell whose hands hold cloth until each has gone `slips_at` [m]. From `strains_at` on, a joint feels it."""

    def gone(cell: KinematicCell) -> float:
        places = [
            [tool_pose(cell.model.chains[s], q[cell.model.arm(s)])[:3, 3] for s in Side]
            for q in (cell.q, cell.model.q_park)
        ]
        return float(np.linalg.norm(np.subtract(*places), axis=1).max())

    def broken(cell: KinematicCell) -> Ports:
        state, ports = cell.state, cell.ports()

        def strained() -> JointState:
            effort = np.full(len(cell.q), 10.0 * (gone(cell) > strains_at))
            return replace(state(), effort=frozen(effort))

        def pressed(reading: Callable[[], Any]) -> Callable[[], Any]:
            def read() -> Any:
                felt = reading()
                return replace(felt, cells=frozen(felt.cells + FORCE * (gone(cell) < slips_at)))

            return read

        cast(Any, cell).state = strained
        for hand in cell.hands.values():
            cast(Any, hand).reading = pressed(hand.reading)
        return replace(ports, tactile=cast(Any, cell.hands))

    with kinematic_rig(SETTINGS, camera_calibration(SETTINGS), SETTINGS.table, broken) as rig:
        models = {"robot": rig.model, "checker": rig.checker, "execution_checker": rig.checker}
        rig.ports.arms.enable()
        for gripper in rig.ports.grippers.values():
            gripper.calibrate()
        rig.wait(2.0)
        yield fake_workcell(FakeCell(), ports=rig.ports, limits=rig.model.commissioning, **models)


def pulled(cell: Workcell) -> tuple[Failure, dict[str, float]]:
    """Perform the effect, require that the hands are back, and return its failure and figures."""
    grip = FORCE * 12
    held = {side: Held(0.0, grip, cell.ports.grippers[side].state().opening, cast(Any, None)) for side in Side}
    bias = TactileBias(0.0, np.zeros((2, 4, 3)), np.zeros(2), 0.004)
    context = RunContext(fold=FoldContext(held=held, biases=dict.fromkeys(Side, bias)))
    begun, figures = tools(cell, cell.ports.arms.state().q), dict[str, float]()
    failure = pulling(figures)(cell, context).context.failure
    assert failure is not None
    np.testing.assert_allclose(tools(cell, cell.ports.arms.state().q), begun, atol=5e-3)
    return failure, figures


def test_the_pull_ends_with_the_slip_and_leads_the_hands_back() -> None:
    with holding(slips_at=0.02) as cell:
        failure, figures = pulled(cell)
    assert failure.kind is FailureKind.SLIPPED
    assert 0.02 < figures["pulled_m"] < 0.03 and figures["effort_nm"] == 0.0


@pytest.mark.parametrize(
    ("fault", "says", "gone"),
    [({}, "no hand has felt the cloth slip", REACH), ({"strains_at": 0.02, "slips_at": 0.04}, "10.0 Nm", 0.02)],
    ids=["never felt", "felt too late"],
)
def test_a_slip_that_is_not_felt_in_time_is_none(fault: dict[str, float], says: str, gone: float) -> None:
    with holding(**fault) as cell:
        failure, figures = pulled(cell)
    assert failure.kind is FailureKind.LIMIT_EXCEEDED and says in failure.what
    assert figures["pulled_m"] == pytest.approx(gone, abs=8e-3)
