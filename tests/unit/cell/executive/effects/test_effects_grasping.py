"""A whole grasp: both hands descend, press, close and confirm the layers."""

from __future__ import annotations

import itertools
from collections.abc import Collection
from dataclasses import replace
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from foldcell.cell.control.motions.guarded_motions import FingertipForceMonitor
from foldcell.cell.control.motions.hands import Hands
from foldcell.cell.executive.effects import EFFECTS, folding, grasping
from foldcell.cell.executive.effects.recovery import deciding
from foldcell.cell.hardware.workcell import Workcell
from foldcell.cell.states.fold_context import FoldContext
from foldcell.cell.states.recovery_table import Adjustment
from foldcell.cell.states.run_context import RunContext
from foldcell.cell.states.stages import Repair
from foldcell.cell.states.transition_table import Effect, Event
from foldcell.robots.baxter.ros.electric_gripper import FULL_FORCE
from foldcell.robots.errors import Failure, FailureKind
from foldcell.robots.ports import Array, GripperState, JointState, Side, TactileReading, arm_slice
from foldcell.skills.grasping.descend import ARM_STIFFNESS
from foldcell.skills.grasping.hand_reading import HandReading
from foldcell.skills.grasping.standing import lower_tip, to_stand_at
from foldcell.skills.grasping.tare import TactileBias
from foldcell.skills.motion.kinematics.posture import Posture
from foldcell.skills.motion.moves.grasp import Descent
from foldcell.skills.vocabulary import Grasp, GraspId, Outcome
from tests.builders.contexts import context_with
from tests.fakes import FakeCell, live_noise
from tests.workcells import fake_workcell

K = FailureKind
ABOVE, LAYER, LAYERS = 0.040, 0.002, 2
"""Height of both tools above the table [m], thickness of a layer [m], and number of layers."""
STACK = LAYER * LAYERS
NOISE = 0.03
"""Largest effect of the fake cells' noise on the mean force of a pad of 12 cells [N]."""
HOME = -0.1
"""Position of all joints above the grasp [rad]."""
WAY = Descent(np.linspace(HOME, HOME + 0.5, 51)[:, None] * np.ones(7), np.linspace(0.0, 0.05, 51), ABOVE - STACK)
"""Each joint turns by 10 rad per metre of the hand's path."""


def height(cell: Any, side: Side, q: Array) -> float:
    return ABOVE - float(np.interp(q[arm_slice(side, 14)][0], WAY.q[:, 0], WAY.depth))


class Hand:
    """A hand whose tips feel the table through the stack. Its pads close at 0.1 m/s on the cloth between them."""

    max_opening = 0.0416

    def __init__(self, cell: FakeCell, side: Side, table: float = 0.0, between: float = STACK) -> None:
        self._cell, self.side, self._table, self.between = cell, side, table, between
        self._opening, self._told, self._since = 0.035, 0.035, 0.0
        self.force = 0.0
        self.jammed = False
        self.lowest = np.inf
        self.heard: list[tuple[float, float]] = []
        """Commanded openings: (time [s], opening [m])."""

    def command(self, opening: float, force: float) -> None:
        self._opening, self._since = self._now(), self._cell.now
        self._told, self.force = opening, force
        self.heard.append((self._cell.now, opening))

    def _now(self) -> float:
        goal, way = max(self._told, self.between), 0.1 * (self._cell.now - self._since)
        if self.jammed:
            return self._opening
        return self._opening + float(np.clip(goal - self._opening, -way, way))

    def state(self) -> GripperState:
        return GripperState(self._cell.now, self.side, self._now(), self.force, False, True)

    def reading(self) -> TactileReading:
        now = height(None, self.side, self._cell.q)
        self.lowest = min(self.lowest, now)
        tip = 2500.0 * max(0.0, self._table - now) + 0.2  # the tip has an offset
        pressed = self._told < self.between and self._now() <= self.between + 1e-9
        pads, noise = self.force * pressed * (self.between > 0.0), live_noise(self._cell.now)
        cells, tips = np.full((2, 4, 3), pads / 12 + noise), np.array([tip, 0.5 * tip]) + noise
        return TactileReading(self._cell.now, self.side, cells, tips)


def over_cloth(monkeypatch: pytest.MonkeyPatch, **left: float) -> tuple[FakeCell, Workcell, RunContext, Any]:
    """Both hands are above two layers. left: other values for the table and the cloth under the left hand."""
    cell = FakeCell(q=np.full(14, HOME))
    both: Any = {side: Hand(cell, side, **(left if side is Side.LEFT else {})) for side in Side}
    monkeypatch.setattr(Hands, "height", height)
    work = fake_workcell(cell, ports=replace(cell.ports(), grippers=both, tactile=both))
    garment: Any = SimpleNamespace(
        material=SimpleNamespace(thickness=LAYER), thickness_sigma=lambda spread: spread * LAYER
    )
    grasps = {i: Grasp(np.zeros(2), 0.0, LAYERS, STACK) for i in GraspId}
    motion: Any = SimpleNamespace(
        descend=dict.fromkeys(Side, WAY),
        postures={Side.LEFT: Posture(GraspId.LEFT, pitch=0.1), Side.RIGHT: Posture(GraspId.RIGHT, pitch=-0.1)},
    )
    step: Any = SimpleNamespace(grasps=grasps)
    return cell, work, context_with(garment=garment, motion=motion, step=step), both


def lean(context: RunContext, pitch: float) -> None:
    """Let both hands lean by `pitch` [rad]."""
    postures = context.fold.attempt.motion.postures
    postures.update({side: replace(posture, pitch=pitch) for side, posture in postures.items()})


def test_both_hands_grasp_the_cloth(monkeypatch: pytest.MonkeyPatch) -> None:
    cell, work, context, both = over_cloth(monkeypatch)
    lean(context, 0.3)
    result = EFFECTS[Effect.GRASP](work, context)
    assert result.event is Event.DONE
    assert {s: held.count.layers for s, held in result.context.fold.held.items()} == dict.fromkeys(Side, LAYERS)
    for side in Side:
        assert result.context.fold.biases[side].tip == pytest.approx([0.2, 0.1], abs=0.002), (
            "the tare was made in the air"
        )
        assert result.context.fold.held[side].grip == pytest.approx(work.grasp.grip_force, abs=NOISE)
        touched = result.record["contact_height_m"][side]  # type: ignore[index]
        assert abs(touched) < 0.002 and result.record["contact_by"][side] == "tip"  # type: ignore[index]
        # the press goes so deep that the arm, which yields, holds the middle between closed tips on the table
        closed = work.grasp.tip_distance - work.settings.gripper.opening + LAYERS * LAYER
        goal = result.context.fold.table_contact[side] + to_stand_at(0.0, lower_tip(closed, 0.3))
        assert both[side].lowest == pytest.approx(goal, abs=3e-4) and goal < touched - 0.003
        closing = [t for t, opening in both[side].heard if opening == 0.0]
        assert closing and height(None, side, cell.q) == pytest.approx(both[side].lowest, abs=2e-4)
        down = next(t for t, q in cell.commands if height(None, side, q) < both[side].lowest + 2e-4)
        assert closing[0] > down, "the pads close after the press"
    assert 1.0 < result.record["strongest_push_n"] < work.settings.grasp.press_force  # type: ignore[operator]
    assert np.diff([t for t, _ in cell.commands]) == pytest.approx(0.01), "there is one set-point per tick"


@pytest.mark.parametrize(
    ("under", "kind"),
    [({"table": -0.05}, K.NO_CONTACT), ({"between": 0.0}, K.MISSED_GRASP), ({"table": 0.036}, K.IN_COLLISION)],
)
def test_a_miss_by_one_hand_ends_the_grasp(
    under: dict[str, float], kind: FailureKind, monkeypatch: pytest.MonkeyPatch
) -> None:
    """There is no table below the hand, no cloth between its pads, or an object under it."""
    cell, work, context, both = over_cloth(monkeypatch, **under)
    result = EFFECTS[Effect.GRASP](work, context)
    failure = result.context.failure
    assert result.event is Event.FAILED and failure is not None and failure.kind is kind and "left" in failure.what
    assert not result.context.fold.held
    if kind is not K.MISSED_GRASP:
        assert not any(hand.heard for hand in both.values()), "no hand closes"
    assert np.diff([t for t, _ in cell.commands]).max() < 0.2


def test_fewer_layers_than_planned_are_a_missed_grasp(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    _, work, context, _ = over_cloth(monkeypatch, between=LAYER)
    result = EFFECTS[Effect.GRASP](work, context)
    assert result.event is Event.FAILED and result.context.failure.kind is K.MISSED_GRASP
    assert "left hand holds 1 layers, not 2" in result.context.failure.what


@pytest.mark.parametrize(("known", "event"), [(None, Event.FAILED), (0.6 * LAYER, Event.DONE)])
def test_layers_are_counted_by_the_thickness_that_an_earlier_fold_has_shown(
    monkeypatch: pytest.MonkeyPatch, known: float | None, event: Event
) -> None:
    """Two layers of a fabric thinner than its file says look like one."""
    _, work, context, both = over_cloth(monkeypatch)
    for hand in both.values():
        hand.between = 2 * 0.6 * LAYER
    result = EFFECTS[Effect.GRASP](work, replace(context, layer_thickness=known))
    assert result.event is event
    if event is Event.DONE:
        assert result.context.fold.layer_thickness == pytest.approx(0.6 * LAYER, rel=0.05)


def test_a_grasp_of_the_whole_stack_may_hold_more_layers_whatever_their_learned_thickness(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The height of the grasp was planned with the stated thickness, so this decides what the hand reaches."""
    thin = 0.6 * LAYER
    _, work, context, both = over_cloth(monkeypatch)
    for hand in both.values():
        hand.between = (LAYERS + 1) * thin
    assert EFFECTS[Effect.GRASP](work, replace(context, layer_thickness=thin)).event is Event.DONE


def test_a_second_grasp_of_a_repair_counts_with_the_thickness_that_the_first_has_measured(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The repair was planned before any layer was measured, so with the stated thickness."""
    _, work, context, _ = over_cloth(monkeypatch)
    garment: Any = context.plan.garment
    garment.thickness_of = lambda measured: LAYER if measured is None else max(measured, 0.7 * LAYER)
    plan, nothing = cast("Any", SimpleNamespace(thickness=LAYER)), cast("Any", None)
    context = context_with(context, repair=Repair(plan, nothing, nothing, nothing, nothing, nothing))
    settings = grasping.grip_settings(work, context.fold)
    assert grasping._layer_thickness(context, garment, settings) == (LAYER, settings.thickness_error)
    context = context_with(context, layer_thickness=0.6 * LAYER)
    counted = grasping._layer_thickness(context, garment, settings)
    assert counted == (0.7 * LAYER, grasping.LEARNED_ERROR), "no thinner than the class"


def test_pads_that_do_not_move_are_a_fault_of_the_gripper(monkeypatch: pytest.MonkeyPatch) -> None:
    _, work, context, both = over_cloth(monkeypatch)
    both[Side.RIGHT].jammed = True
    result = EFFECTS[Effect.GRASP](work, context)
    assert result.event is Event.FAILED and result.context.failure.kind is K.GRIPPER_FAULT
    assert "right gripper" in result.context.failure.what


@pytest.mark.long
@pytest.mark.parametrize(
    ("spoil", "kind"),
    [
        (lambda c: setattr(c, "stop_reason", "button"), K.STOPPED),
        (lambda c: setattr(c, "frozen_since", c.now), K.STALE_STATE),
        (lambda c: (setattr(c, "follows", False), setattr(c, "q", c.q + 0.2)), K.TRACKING_ERROR),
    ],
)
@pytest.mark.parametrize("searching", [False, True])
def test_a_fault_at_any_time_of_a_grasp_ends_it_with_its_kind(
    searching: bool, spoil: Any, kind: FailureKind, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The fault occurs during the tare, the descent, the press or the closing. searching: or while the left hand
    opens, moves and closes again at another height. The fake raises an error on a set-point to a stopped robot."""

    def begin() -> tuple[FakeCell, Workcell, RunContext, Any]:
        return in_stack(monkeypatch, -1.6 * LAYER) if searching else over_cloth(monkeypatch)

    cell, work, context, _ = begin()
    assert EFFECTS[Effect.GRASP](work, context).event is Event.DONE
    for moment in np.linspace(0.02, cell.now - 0.15, 15):
        again, work, context, _ = begin()
        again.at(float(moment), lambda again=again: spoil(again))
        result = EFFECTS[Effect.GRASP](work, context)
        assert result.event is Event.FAILED and result.context.failure.kind is kind, moment
        assert again.now < moment + 0.13, "the effect ends within a tick, or as soon as a state is too old"


def test_a_leaning_hand_feels_the_table_with_its_lower_tip(monkeypatch: pytest.MonkeyPatch) -> None:
    felt = []
    for pitch in (0.0, 0.1):
        _, work, context, _ = over_cloth(monkeypatch)
        lean(context, pitch)
        felt.append(EFFECTS[Effect.GRASP](work, context).context.fold.table_contact[Side.LEFT])
    lower_tip = 0.5 * work.grasp.tip_distance * np.sin(0.1)
    force = (felt[0] - felt[1] - lower_tip) * ARM_STIFFNESS
    assert 0.5 < force < 5.0, "of the other tip, which an upright hand has on the table, too"


@pytest.mark.parametrize("pitch", [0.0, 0.1])
@pytest.mark.parametrize("high", [False, True])
def test_a_hand_that_holds_too_few_layers_says_whether_it_stood_too_high(
    pitch: float, high: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A push that is limited to a small force leaves a hand that stands too high. The recovery follows from it."""
    _, work, context, both = over_cloth(monkeypatch)
    lean(context, pitch)
    both[Side.LEFT].between = LAYER
    if high:
        monkeypatch.setattr(grasping, "_pushed_height", lambda *arguments: arguments[-1])
        monkeypatch.setattr(grasping, "_table_height", lambda _, __, contact: contact.height - 0.01)
    result = EFFECTS[Effect.GRASP](work, context)
    failure = result.context.failure
    assert failure.kind is K.MISSED_GRASP and failure.values["side"] == "left"
    assert (failure.values["too_high_m"] > 0.0) is high
    context.plan.garment.plan = [SimpleNamespace(variants=(None,))]
    record = deciding.choose_next(work, result.context, failure).record
    assert record["change"] == ("lower" if high else "inward")
    said = str(record["because"])
    assert said.startswith("the left hand stood") and ("mm too high: it presses 2 mm deeper" in said) is high


@pytest.mark.parametrize(("above", "event"), [(0, Event.DONE), (1, Event.FAILED)])
def test_only_a_grasp_under_the_whole_stack_accepts_more_layers(
    monkeypatch: pytest.MonkeyPatch, above: int, event: Event
) -> None:
    """above: layers between the table and the planned height of the grasp. A grasp of only the upper layers must
    not take more layers."""
    _, work, context, both = over_cloth(monkeypatch)
    for hand in both.values():
        hand.between = (LAYERS + 2) * LAYER
    grasps = context.fold.attempt.step.grasps
    for grasp_id, grasp in grasps.items():
        grasps[grasp_id] = replace(grasp, height=(LAYERS + above) * LAYER)
    assert EFFECTS[Effect.GRASP](work, context).event is event


@pytest.mark.parametrize(("more", "layer"), [({}, LAYER), ({Side.LEFT}, LAYER), (set(Side), 1.5 * LAYER)])
def test_a_pleat_in_one_hand_does_not_thicken_the_fabric(
    more: Collection[Side], layer: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """more: hands that hold a layer more than planned. If both do, the fabric may be thicker than expected."""
    _, work, context, both = over_cloth(monkeypatch)
    for side in more:
        both[side].between = (LAYERS + 1) * LAYER
    result = EFFECTS[Effect.GRASP](work, replace(context, layer_thickness=LAYER))
    assert result.context.fold.layer_thickness == pytest.approx(layer, rel=0.05)
    told: Any = result.record["held"]
    counted = {side: (told[side]["layers"], told[side]["planned"]) for side in Side}
    assert counted == {side: (LAYERS + (side in more), LAYERS) for side in Side}


def test_each_grasp_retry_squeezes_harder_up_to_the_grippers_limit() -> None:
    work = fake_workcell(FakeCell())
    tries = [(Adjustment.STRONGER,) * n for n in range(3)]
    forces = [grasping.grip_settings(work, FoldContext(adjustments=a)).grip_force for a in tries]
    assert forces[0] == work.grasp.grip_force and np.all(np.diff(forces) > 3.0) and forces[-1] <= FULL_FORCE


@pytest.mark.parametrize("part", ["plan", "move"])
def test_a_hand_that_cannot_rise_is_a_failed_lift(part: str, monkeypatch: pytest.MonkeyPatch) -> None:
    _, work, context, _ = over_cloth(monkeypatch)
    held = EFFECTS[Effect.GRASP](work, context).context
    why = Failure(K.TRACKING_ERROR, "the arm lags")
    lift: Any = object()
    monkeypatch.setattr(
        folding, "plan_lift", lambda *_, **__: Outcome(failure=why) if part == "plan" else Outcome(lift)
    )
    monkeypatch.setattr(folding, "move", lambda *_, **__: why)
    result = folding.lift(work, held)
    assert result.event is Event.FAILED and result.context.failure is why


def test_slip_detection_uses_the_grip_measured_after_the_lift(monkeypatch: pytest.MonkeyPatch) -> None:
    cell, work, context, both = over_cloth(monkeypatch)
    context = EFFECTS[Effect.GRASP](work, context).context
    monkeypatch.setattr(folding, "plan_lift", lambda *_, **__: Outcome("up"))
    monkeypatch.setattr(folding, "move", lambda *_, **__: None)
    both[Side.LEFT].force *= 0.8  # the grip settles
    lifted = folding.lift(work, context)
    assert lifted.event is Event.DONE
    before, after = context.fold.held[Side.LEFT], lifted.context.fold.held[Side.LEFT]
    assert after.grip == pytest.approx(0.8 * before.grip, abs=NOISE) and after.stamp > before.stamp
    assert lifted.context.fold.held[Side.RIGHT].grip == pytest.approx(before.grip, abs=NOISE)
    assert cell.now > after.stamp - 0.1


def test_an_idle_arm_stays_at_its_set_point(monkeypatch: pytest.MonkeyPatch) -> None:
    """The arm sags a little below its set-point, so a set-point at its reading would be a jump."""
    cell, work, context, _ = over_cloth(monkeypatch)
    only = {Side.LEFT: WAY}
    motion: Any = SimpleNamespace(descend=only, postures={Side.LEFT: Posture(GraspId.LEFT)})
    context = context_with(context, motion=motion)
    cell.q[arm_slice(Side.RIGHT, 14)] = HOME - 0.005
    work.last_command.q = np.full(14, HOME)
    through, cell.follows = work.ports.arms.command, False

    def sagging(q: Array, qd: Array) -> Any:
        told = through(q, qd)
        cell.q = q - 0.005 * (np.arange(14) > 6)
        return told

    monkeypatch.setattr(work.ports.arms, "command", sagging)
    assert EFFECTS[Effect.GRASP](work, context).event is Event.DONE
    right = np.array([q[arm_slice(Side.RIGHT, 14)] for _, q in cell.commands])
    assert np.abs(np.diff(right, axis=0)).max() < 5e-4 and np.abs(right[0] - HOME).max() < 1e-9


def state_of(stamp: float) -> JointState:
    return JointState(stamp, np.zeros(14), np.zeros(14), np.zeros(14), 0.0)


def test_the_push_force_is_relative_to_the_free_fingertip(monkeypatch: pytest.MonkeyPatch) -> None:
    felt = {Side.LEFT: [2.0, -1.0], Side.RIGHT: [0.5, 0.5]}

    def read(cell: Any, side: Side, state: JointState) -> Any:
        tactile = TactileReading(state.stamp, side, np.zeros((2, 4, 3)), np.array(felt[side]))
        gripper = GripperState(state.stamp, side, 0.03, 0.0, False, True)
        return HandReading(state.stamp, tactile, gripper, 0.05, np.zeros(7))

    monkeypatch.setattr(Hands, "read", read)
    air = TactileBias(0.0, np.zeros((2, 4, 3)), np.array([2.0, -1.0]), 0.01)
    right = TactileBias(0.0, np.zeros((2, 4, 3)), np.array([0.5, 0.5]), 0.01)
    work = fake_workcell(FakeCell())
    pushes = FingertipForceMonitor(work.hands, {Side.LEFT: air, Side.RIGHT: right})
    assert pushes.look(state_of(0.0)) is None
    assert pushes.now == {Side.LEFT: 0.0, Side.RIGHT: 0.0} and pushes.strongest == 0.0
    felt[Side.LEFT] = [2.5, 5.0]
    assert pushes.look(state_of(0.1)) is None
    assert pushes.now == {Side.LEFT: 6.0, Side.RIGHT: 0.0} and pushes.strongest == 6.0
    felt[Side.LEFT], felt[Side.RIGHT] = [2.0, -1.0], [1.5, 0.5]
    assert pushes.look(state_of(0.2)) is None
    assert pushes.now == {Side.LEFT: 0.0, Side.RIGHT: 1.0} and pushes.strongest == 6.0, (
        "the strongest push so far is kept"
    )
    felt[Side.RIGHT] = [float("nan"), 0.5]
    bad = pushes.look(state_of(0.3))
    assert bad is not None and bad.kind is K.TACTILE_FAULT and "right" in bad.what


class InStack(Hand):
    """A hand in a stack of four layers, whose pads take the layers with upper sides above its tips. raised: by
    which these lie higher than planned [m]."""

    raised = 0.0

    @property
    def between(self) -> float:
        here = height(None, self.side, self._cell.q) - self.raised
        return sum((k + 1) * LAYER > here for k in range(4)) * LAYER

    @between.setter
    def between(self, _: float) -> None: ...


def in_stack(monkeypatch: pytest.MonkeyPatch, raised: float) -> tuple[FakeCell, Workcell, RunContext, Any]:
    """Both hands are to take two of four layers. raised: of the layers under the left hand [m]."""
    monkeypatch.setitem(over_cloth.__globals__, "Hand", InStack)
    cell, work, context, both = over_cloth(monkeypatch)
    both[Side.LEFT].raised = raised
    lean(context, 0.0)
    grasps = context.fold.attempt.step.grasps
    grasps.update({i: replace(g, height=(LAYERS + 2) * LAYER) for i, g in grasps.items()})
    return cell, work, context, both


@pytest.mark.parametrize("raised", [-1.6 * LAYER, -0.8 * LAYER, 0.0, 0.8 * LAYER, 1.6 * LAYER])
def test_a_hand_that_takes_other_upper_layers_than_planned_closes_again_at_another_height(
    raised: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    cell, work, context, both = in_stack(monkeypatch, raised)
    result = EFFECTS[Effect.GRASP](work, context)
    assert result.event is Event.DONE
    assert {s: h.count.layers for s, h in result.context.fold.held.items()} == dict.fromkeys(Side, LAYERS)
    closed = {side: sum(opening == 0.0 for _, opening in told(both[side])) for side in Side}
    assert closed[Side.RIGHT] == 1, "it holds its layers meanwhile"
    assert (closed[Side.LEFT] > 1) == (raised != 0.0) == ("held_before" in result.record)
    heights = [h for h, _ in result.record.get("held_before", {"left": []})["left"]]  # type: ignore[attr-defined]
    ends = [*heights, height(None, Side.LEFT, cell.q)]
    assert all((b - a) * raised > 0.0 for a, b in itertools.pairwise(ends)) or len(ends) > 3
    assert np.diff([t for t, _ in cell.commands]).max() < 0.011, "the arms are commanded all the time"


def told(hand: Any) -> list[tuple[float, float]]:
    """Return the commanded openings when they change."""
    heard = hand.heard
    return [heard[0], *(b for a, b in itertools.pairwise(heard) if a[1] != b[1])]


def test_a_hand_that_holds_nothing_at_its_lowest_height_closes_there_only_once(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    _, work, context, _ = in_stack(monkeypatch, 0.0)
    monkeypatch.setattr(InStack, "between", property(lambda hand: 0.0, lambda hand, _: None))
    result = EFFECTS[Effect.GRASP](work, context)
    assert result.event is Event.FAILED and result.context.failure.kind is K.MISSED_GRASP
    heights = [h for h, _ in result.record["held_before"]["left"]]  # type: ignore[index]
    assert heights[-1] == pytest.approx(grasping.LOWEST * LAYER, abs=1e-4), "it has tried the lowest height"
    assert all(a - b > 1e-4 for a, b in itertools.pairwise(heights))


def test_a_hand_whose_layers_cannot_be_told_apart_gives_up(monkeypatch: pytest.MonkeyPatch) -> None:
    """The layers stick together: the pads take all or none."""
    _, work, context, _ = in_stack(monkeypatch, 0.0)
    sticking = property(
        lambda hand: 4 * LAYER * (height(None, hand.side, hand._cell.q) < 2.3 * LAYER), lambda hand, _: None
    )
    monkeypatch.setattr(InStack, "between", sticking)
    result = EFFECTS[Effect.GRASP](work, context)
    assert result.event is Event.FAILED and result.context.failure.kind in {K.MISSED_GRASP, K.MISSED_LAYER}
    tries = result.record["held_before"]
    assert 3 <= len(tries["left"]) <= 5 and not result.context.fold.held  # type: ignore[index]
