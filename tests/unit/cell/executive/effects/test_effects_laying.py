"""Laying down the cloth in the hands when a fold has to end."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import foldcell.cell.executive.effects.recovery.laying as laying
import foldcell.cell.executive.effects.recovery.ways_out as ways_out
from foldcell.cell.executive.effects import EFFECTS
from foldcell.cell.hardware.workcell import Workcell
from foldcell.cell.states.recovery_table import Laying
from foldcell.cell.states.run_context import RunContext
from foldcell.cell.states.transition_table import Effect, Event
from foldcell.robots.baxter.robot import load_model
from foldcell.robots.errors import DriverError, Failure, FailureKind
from foldcell.robots.ports import ArmTrajectory, Array, Side
from foldcell.skills.grasping.confirm import Held, LayerCount
from foldcell.skills.motion.moves.lift import plan_lift
from foldcell.skills.motion.timing.timing import free_motion
from foldcell.skills.motion.validation.collision import CollisionChecker
from tests.builders.contexts import context_with
from tests.fakes import FakeCell
from tests.workcells import fake_workcell

K = FailureKind
BAXTER = load_model()
CHECKER = CollisionChecker(BAXTER, fake_workcell(FakeCell()).table)
lay_back = EFFECTS[Effect.LAY_BACK]
THICK = 0.004  # opening of pads that hold cloth [m]


def turned(shoulder: float, raised: float) -> Array:
    """A posture near the parked one: both shoulders turned outwards, both arms raised [rad]."""
    arm = np.r_[shoulder, -raised, np.zeros(5)]
    return BAXTER.q_park + np.r_[arm, arm * np.r_[-1.0, 1.0, np.ones(5)]]


GRASP = turned(0.3, 0.0)
LIFT = plan_lift(BAXTER, CHECKER, GRASP, tuple(Side), 0.03).unwrap()
ARC = free_motion(LIFT.q[-1], LIFT.q[-1] + turned(-0.5, 0.25) - BAXTER.q_park, BAXTER.planning)


def carrying(
    share: float, kind: FailureKind = K.STALE_STATE, **values: Any
) -> tuple[FakeCell, Workcell, RunContext]:
    """Both hands hold cloth, after this share of the arc. The fold has failed."""
    cell = FakeCell(q=ARC.at(share * ARC.duration)[0])
    cell.openings = dict.fromkeys(Side, THICK)
    workcell = fake_workcell(
        cell, robot=BAXTER, checker=CHECKER, execution_checker=CHECKER, limits=BAXTER.planning
    )
    held = dict.fromkeys(Side, Held(0.0, 12.0, THICK, LayerCount((0.0, 1.0), 1.0, 0.1)))
    context = context_with(held=held, carrying=(LIFT, ARC), tool_speed=0.3, carried=False)
    return cell, workcell, context.with_failure(Failure(kind, "the fold has to end", values=values))


def opened_at(cell: FakeCell) -> list[Array]:
    """The list that collects the arms' joints whenever a hand lets go of its cloth."""
    where: list[Array] = []

    class Openings(dict[Side, float]):
        def __setitem__(self, side: Side, opening: float) -> None:
            if self[side] < 0.01 <= opening:
                where.append(cell.q.copy())
            super().__setitem__(side, opening)

    cell.openings = Openings(cell.openings)
    return where


@pytest.mark.parametrize(("share", "back"), [(0.1, True), (0.35, True), (0.8, False), (0.95, False)])
def test_the_cloth_is_released_at_the_nearer_end_of_the_path(share: float, back: bool) -> None:
    cell, workcell, context = carrying(share)
    where = opened_at(cell)
    result = lay_back(workcell, context)
    assert result.event is Event.DONE and result.record["laying"] == ("back" if back else "onward")
    assert len(where) == 2 and where[0] == pytest.approx(GRASP if back else ARC.q[-1], abs=1e-3)
    assert result.context.fold.carried is not back, "the next picture is judged as that of a completed fold"
    assert result.context.fold.attempt.disturbed is not back, "layers below may lie elsewhere than planned"
    assert result.context.failure is context.failure, "the recovery is chosen for the failure of the fold"
    assert 0.01 < min(cell.openings.values()) < 0.03, "the pads open just wide enough"
    heights = [workcell.hands.height(side, cell.q) - workcell.hands.height(side, where[0]) for side in Side]
    assert min(heights) > 0.03, "then the hands rise"


def test_the_hands_return_along_the_arc() -> None:
    cell, workcell, context = carrying(0.45)
    lay_back(workcell, context)
    path = np.vstack([LIFT.q, ARC.q])
    sent = np.array([q for _, q in cell.commands])
    off = np.array([np.abs(path - q).max(axis=1).min() for q in sent])
    until = int(np.abs(sent - GRASP).max(axis=1).argmin())
    assert off[: until + 1].max() < 0.005


def test_with_one_hand_left_the_cloth_is_laid_back_unless_the_fold_is_nearly_done() -> None:
    for share, chosen in ((0.6, "back"), (0.95, "onward")):
        cell, workcell, context = carrying(share, K.SLIPPED, side="left")
        result = lay_back(workcell, context)
        assert (result.record["laying"], result.record["holding"]) == (chosen, ["right"])
    cell, workcell, context = carrying(0.6)
    cell.openings[Side.RIGHT] = 0.0  # its pads have closed on each other
    assert lay_back(workcell, context).record["holding"] == ["left"]


@pytest.mark.parametrize(("kind", "event"), [(K.SKILL_CRASHED, Event.CRASH), (K.ABORTED, Event.GIVE_UP)])
def test_a_bug_and_an_abort_end_the_run_when_the_cloth_is_laid_down(kind: K, event: Event) -> None:
    cell, workcell, context = carrying(0.2, kind)
    where = opened_at(cell)
    result = lay_back(workcell, context)
    assert result.event is event and where[0] == pytest.approx(GRASP, abs=1e-3)
    assert result.context.failure is context.failure and result.context.failure.kind is kind


def test_a_hand_that_strayed_near_the_target_does_not_drag_the_fold_back_alone() -> None:
    """Something may stand ahead, so the way back is taken from farther off."""
    for share, chosen in ((0.6, "back"), (0.97, "onward")):
        cell, workcell, context = carrying(share, K.TRACKING_ERROR)
        cell.openings[Side.LEFT] = 0.0
        result = lay_back(workcell, context)
        assert (result.record["laying"], result.record["holding"]) == (chosen, ["right"])


def test_empty_hands_open_where_they_are() -> None:
    cell, workcell, context = carrying(0.4, K.SLIPPED, side="left")
    cell.openings[Side.RIGHT] = 0.0
    where, stood = opened_at(cell), cell.q.copy()
    result = lay_back(workcell, context)
    assert result.record["laying"] == Laying.RELEASE and result.event is Event.DONE
    assert where[0] == pytest.approx(stood, abs=1e-9)


def test_a_garment_that_was_only_lifted_is_set_down_again() -> None:
    cell, workcell, context = carrying(0.0, K.MISSED_GRASP)
    context = replace(context, fold=replace(context.fold, carrying=(LIFT,)))
    where = opened_at(cell)
    assert lay_back(workcell, context).record["laying"] == "back"
    assert where[0] == pytest.approx(GRASP, abs=1e-3)


def test_a_hand_that_had_not_begun_to_lift_opens_at_its_grasp() -> None:
    cell, workcell, context = carrying(0.0, K.UNREACHABLE)
    cell.q = GRASP.copy()
    where = opened_at(cell)
    assert lay_back(workcell, replace(context, fold=replace(context.fold, carrying=()))).event is Event.DONE
    assert where[0] == pytest.approx(GRASP, abs=1e-9)


def hanging(cell: FakeCell, until: float) -> None:
    """The arms do not follow their set-points until a moment of cell time."""
    cell.follows = False
    cell.at(until, lambda: setattr(cell, "follows", True))


@pytest.mark.parametrize("hangs_s", [1.0, 2.0])
def test_arms_that_hang_for_a_moment_still_lay_the_cloth_back(hangs_s: float) -> None:
    cell, workcell, context = carrying(0.48, K.TRACKING_ERROR)
    where = opened_at(cell)
    hanging(cell, hangs_s)
    assert lay_back(workcell, context).event is Event.DONE
    assert where[0] == pytest.approx(GRASP, abs=1e-3) and cell.now > hangs_s


def test_arms_that_hang_for_good_end_the_laying_back() -> None:
    cell, workcell, context = carrying(0.48, K.STALE_STATE)
    hanging(cell, 1e9)
    result = lay_back(workcell, context)
    assert result.event is Event.FAILED and result.context.failure.kind is K.TRACKING_ERROR
    assert result.context.cause is context.failure and cell.now < 10.0
    assert min(cell.openings.values()) == THICK, "clearing opens the hands, after the arms have come to rest again"


def test_a_state_that_returns_after_a_second_is_waited_for() -> None:
    cell, workcell, context = carrying(0.3)
    cell.now, cell.frozen_since = 5.0, 4.0
    cell.at(6.0, lambda: setattr(cell, "frozen_since", None))
    assert lay_back(workcell, context).event is Event.DONE


def test_the_operators_abort_lays_the_cloth_back_and_ends_the_run() -> None:
    cell, workcell, context = carrying(0.3, K.ABORTED)
    where = opened_at(cell)
    result = lay_back(workcell, context)
    assert result.event is Event.GIVE_UP and result.context.failure.kind is K.ABORTED
    assert where[0] == pytest.approx(GRASP, abs=1e-3)


@pytest.mark.parametrize("kind", [K.ABORTED, K.SLIPPED])
def test_an_abort_of_the_laying_back_ends_it_at_once(kind: FailureKind) -> None:
    cell, workcell, context = carrying(0.4, kind)
    where = opened_at(cell)
    cell.at(0.8, lambda: workcell.commands.put(Event.ABORT))
    result = lay_back(workcell, context)
    assert result.context.failure.kind is K.ABORTED and where == [] and cell.now < 2.0
    assert result.event is (Event.GIVE_UP if kind is K.ABORTED else Event.FAILED), "the runner makes it an abort"


def test_a_stop_ends_the_laying_back_with_the_hands_closed() -> None:
    cell, workcell, context = carrying(0.4)
    cell.at(0.8, lambda: workcell.ports.stop.trigger("button"))
    result = lay_back(workcell, context)
    assert result.event is Event.FAILED and result.context.failure.kind is K.STOPPED
    assert set(cell.openings.values()) == {THICK} and cell.now < 0.9


def test_an_error_of_the_driver_is_a_failure_and_keeps_the_cause(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: Any, **__: Any) -> None:
        raise DriverError(K.STALE_STATE, "the positions of the arms are unknown")

    _, workcell, context = carrying(0.4)
    monkeypatch.setattr(laying, "move", refuse)
    result = lay_back(workcell, context)
    assert (result.event, result.context.failure.kind) == (Event.FAILED, K.STALE_STATE)
    assert result.context.cause is context.failure


def test_a_blocked_path_is_tried_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """Its plan does not change by waiting. A motion that fails is tried as often as the ways out say."""
    tries: list[ArmTrajectory] = []

    def fail(cell: Workcell, motion: ArmTrajectory, **_: Any) -> Failure:
        tries.append(motion)
        return Failure(K.TRACKING_ERROR, "the arm lags")

    _, workcell, context = carrying(0.4)
    monkeypatch.setattr(ways_out, "move", fail)
    assert lay_back(workcell, context).event is Event.FAILED and len(tries) == ways_out.LAYING[0].tries
    cell, workcell, context = carrying(0.4)
    cell.q = cell.q + 0.5  # somebody has moved the arms far away
    tries.clear()
    result = lay_back(workcell, context)
    assert result.context.failure.kind is K.UNREACHABLE and tries == []
