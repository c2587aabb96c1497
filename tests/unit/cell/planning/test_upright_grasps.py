"""A recovery can ask for hands that are upright at the grasp."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from foldcell.cell.config.cell_settings import load_settings
from foldcell.cell.config.garments.garment_file import load_garment
from foldcell.cell.executive.effects import planning
from foldcell.cell.planning import fold_planning
from foldcell.cell.states.recovery_table import Adjustment
from foldcell.cell.states.stages import Repair
from foldcell.robots.errors import Failure, FailureKind
from foldcell.skills.vocabulary import Grasp, GraspId, Outcome
from tests.builders.contexts import context_with
from tests.fakes import FakeCell
from tests.workcells import fake_workcell


def upright_hands(monkeypatch: pytest.MonkeyPatch, height: float, **changes: Any) -> list[bool]:
    """Plan the motion of a grasp of two layers of pants. height: of the grasp, in stated thicknesses of a layer.
    Return whether each plan was asked to have upright hands at the grasp."""
    asked: list[bool] = []

    def plan(*_: Any, upright_grasps: bool, **__: Any) -> Outcome[Any]:
        asked.append(upright_grasps)
        return Outcome(failure=Failure(FailureKind.UNREACHABLE, "no posture"))

    garment = load_garment("pants")
    grasp = Grasp(np.zeros(2), 0.0, 2, height * garment.material.thickness)
    task = SimpleNamespace(step=SimpleNamespace(grasps={GraspId.LEFT: grasp}), paths={})
    monkeypatch.setattr(fold_planning, "plan_hands_motion", plan)
    monkeypatch.setattr(planning, "_task", lambda *_: task)
    monkeypatch.setattr(planning, "fresh_state", lambda *_: Outcome(SimpleNamespace(q=np.zeros(14))))
    context = context_with(garment=garment, **changes, trajectory=SimpleNamespace(), step=task.step)
    workcell = fake_workcell(FakeCell(), settings=load_settings())
    planning.plan_motion(workcell, context, context.plan, context.fold.trajectory)
    return asked


@pytest.mark.parametrize("adjustments", [(), (Adjustment.INWARD,), (Adjustment.INWARD, Adjustment.UPRIGHT)])
def test_hands_are_upright_at_the_grasp_after_the_recovery(
    adjustments: tuple[Adjustment, ...], monkeypatch: pytest.MonkeyPatch
) -> None:
    asked = upright_hands(monkeypatch, 2.0, adjustments=adjustments)
    assert asked == [Adjustment.UPRIGHT in adjustments]


def test_hands_of_a_repair_that_take_upper_layers_of_a_thin_fabric_are_upright(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Three layers of 0.6 of the stated thickness, of which two are taken, are lower than two and a half stated
    ones."""
    plan: Any = SimpleNamespace(thickness=0.6 * load_garment("pants").material.thickness)
    nothing: Any = SimpleNamespace()
    repair = Repair(plan, nothing, nothing, nothing, nothing, nothing)
    assert upright_hands(monkeypatch, 3 * 0.6, repair=repair) == [True]
    assert upright_hands(monkeypatch, 2 * 0.6, repair=repair) == [False]
