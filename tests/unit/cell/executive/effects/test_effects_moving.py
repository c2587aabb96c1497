"""Preparing, parking and making the cell safe."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import foldcell.cell.executive.effects.moving as moving
import foldcell.cell.executive.effects.recovery.parking as parking
import foldcell.cell.executive.effects.recovery.ways_out as ways_out
from foldcell.cell.config.cell_settings import load_settings
from foldcell.cell.control.set_points import LastCommand
from foldcell.cell.executive.effects import EFFECTS
from foldcell.cell.executive.effects.checked_motion import move
from foldcell.cell.executive.effects.moving import clear, clear_again, hold_still, make_safe, prepare, retreat
from foldcell.cell.executive.effects.recovery.ways_out import CLEARING_DWELL_S, PREPARING_DWELLS_S
from foldcell.cell.hardware.workcell import Workcell
from foldcell.cell.states.run_context import RunContext
from foldcell.cell.states.transition_table import Effect, Event
from foldcell.robots.baxter.robot import load_model
from foldcell.robots.errors import DriverError, Failure, FailureKind
from foldcell.robots.ports import ArmTrajectory, GripperState, Side
from foldcell.skills.motion.moves.retreat import Retreat
from foldcell.skills.motion.timing.timing import free_motion
from foldcell.skills.motion.validation.collision import CollisionChecker
from foldcell.skills.vocabulary import Outcome
from tests.builders.contexts import context_with
from tests.fakes import FakeCell
from tests.workcells import fake_workcell

K = FailureKind
approach, reenter = EFFECTS[Effect.APPROACH], EFFECTS[Effect.REENTER]
FIRST = RunContext().with_failure(Failure(K.CATEGORY_MISMATCH, "these are trousers"))


BAXTER = load_model()


@pytest.fixture(scope="module")
def baxter() -> dict[str, Any]:
    """Robot model, checkers and limits with which a fake cell checks motions of the real arms."""
    execution_checker = CollisionChecker(BAXTER, fake_workcell(FakeCell()).table)
    return {
        "robot": BAXTER,
        "execution_checker": execution_checker,
        "checker": execution_checker,
        "limits": BAXTER.planning,
    }


def test_a_parked_cell_is_made_safe_by_opening_the_hands() -> None:
    cell = FakeCell()
    cell.openings = dict.fromkeys(cell.openings, 0.0)
    result = make_safe(fake_workcell(cell), FIRST)
    assert result.event is Event.DONE
    assert set(cell.openings.values()) == {cell.ports().grippers["left"].max_opening}  # type: ignore[index]
    assert result.context.failure is FIRST.failure, "the failure that ended the run is kept"


def test_the_hands_open_in_the_same_order_in_every_run(monkeypatch: pytest.MonkeyPatch) -> None:
    """In the order of a set, which differs between processes, a replay made another decision."""
    order: list[Side] = []
    monkeypatch.setattr(parking, "open_hands", lambda cell, sides: order.extend(sides))
    make_safe(fake_workcell(FakeCell()), FIRST)
    assert order == list(Side)


def test_a_stop_while_making_safe_is_reported_as_a_stop() -> None:
    cell = FakeCell()
    workcell = fake_workcell(cell)
    cell.at(0.3, lambda: workcell.ports.stop.trigger("button"))
    result = make_safe(workcell, FIRST)
    assert result.event is Event.FAILED
    assert result.context.failure.kind is K.STOPPED


def test_the_reason_is_reported_if_the_cell_cannot_be_made_safe(monkeypatch: pytest.MonkeyPatch) -> None:
    no_way = Outcome(failure=Failure(K.UNREACHABLE, "no way up and home was found", "jog the arms by hand"))
    monkeypatch.setattr(ways_out, "plan_free_motion", lambda *_, **__: no_way)
    monkeypatch.setattr(ways_out, "plan_retreat", lambda *_, **__: no_way)
    result = make_safe(fake_workcell(FakeCell(q=np.full(14, 0.5))), FIRST)
    assert result.event is Event.FAILED
    assert result.context.failure.kind is K.UNREACHABLE and "by hand" in result.context.failure.hint


def test_arms_that_violate_only_the_planning_margin_are_parked(monkeypatch: pytest.MonkeyPatch) -> None:
    """Execution has a smaller margin than planning, so arms that reached such a pose may also leave it."""
    execution_checker, moved, risen = SimpleNamespace(), [], []
    too_near = Outcome[Any](failure=Failure(K.IN_COLLISION, "the forearms are 9 mm apart"))
    way = Outcome(Retreat("up", "home"))  # type: ignore[arg-type]
    monkeypatch.setattr(ways_out, "plan_free_motion", lambda *_, **__: too_near)

    def plan(model: Any, checker: Any, q: Any, sides: Any, **_: Any) -> Outcome[Retreat]:
        risen.append(sides)
        return way if checker is execution_checker else too_near

    monkeypatch.setattr(ways_out, "plan_retreat", plan)
    monkeypatch.setattr(ways_out, "move", lambda cell, motion, **_: moved.append(motion))
    cell = FakeCell(q=np.full(14, 0.5))
    assert make_safe(fake_workcell(cell, execution_checker=execution_checker), FIRST).event is Event.DONE
    assert moved == ["up", "home"] and set(risen) == {tuple(Side)}, "both hands rise if both can"


@pytest.mark.parametrize("free", list(Side))
def test_one_hand_rises_if_the_other_cannot(free: Side, monkeypatch: pytest.MonkeyPatch) -> None:
    blocked, moved = Outcome[Any](failure=Failure(K.UNREACHABLE, "it cannot rise")), []
    way = Outcome(Retreat("up", "home"))  # type: ignore[arg-type]
    monkeypatch.setattr(ways_out, "plan_free_motion", lambda *_, **__: blocked)
    monkeypatch.setattr(
        ways_out, "plan_retreat", lambda model, checker, q, sides, **_: way if sides == (free,) else blocked
    )
    monkeypatch.setattr(ways_out, "move", lambda cell, motion, **_: moved.append(motion))
    assert make_safe(fake_workcell(FakeCell(q=np.full(14, 0.5))), FIRST).event is Event.DONE
    assert moved == ["up", "home"]
    moved.clear()
    other = Side.LEFT if free is Side.RIGHT else Side.RIGHT
    biases: Any = {other: None}
    result = retreat(fake_workcell(FakeCell(q=np.full(14, 0.5))), context_with(biases=biases))
    assert result.event is Event.FAILED and not moved, "the other hand is not moved in its place"


@pytest.mark.parametrize("fails", [False, True])
def test_a_fold_is_approached_with_open_hands_and_counts_as_an_attempt(
    fails: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    lags, frame = Failure(K.TRACKING_ERROR, "the arm lags"), FakeCell().ports().camera.capture()
    monkeypatch.setattr(moving, "move", lambda *_, **__: lags if fails else None)
    cell = FakeCell()
    cell.openings = dict.fromkeys(Side, 0.0)
    motion: Any = SimpleNamespace(postures={Side.LEFT: None}, approach=None)
    result = approach(fake_workcell(cell), context_with(motion=motion, frame=frame, grasps=1, carried=True))
    assert result.event is (Event.FAILED if fails else Event.DONE)
    assert result.context.failure is (lags if fails else None)
    assert cell.openings[Side.LEFT] >= 0.03 and cell.openings[Side.RIGHT] == 0.0, "only the grasping hand opens"
    after = result.context.fold
    assert (after.grasps, after.carried) == (2, False) and after.attempt.before is frame


def test_the_grasping_hand_opens_as_wide_as_the_settings_state(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(moving, "move", lambda *_, **__: None)
    shipped = load_settings()
    narrow = shipped.model_copy(update={"gripper": shipped.gripper.model_copy(update={"opening": 0.021})})
    cell, motion = FakeCell(), SimpleNamespace(postures={Side.RIGHT: None}, approach=None)
    frame = cell.ports().camera.capture()
    approach(fake_workcell(cell, settings=narrow), context_with(motion=motion, frame=frame))
    assert cell.openings[Side.RIGHT] == 0.021


def test_a_driver_error_while_making_safe_is_reported(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: Any) -> None:
        raise DriverError(K.HARDWARE_FAULT, "the motors are off", "see the robot's screen")

    monkeypatch.setattr(parking, "wait", refuse)
    result = make_safe(fake_workcell(FakeCell()), FIRST)
    assert (result.event, result.context.failure.kind) == (Event.FAILED, K.HARDWARE_FAULT)


@pytest.mark.parametrize("effect", [prepare, reenter])
@pytest.mark.parametrize(
    ("kind", "times", "tried"),
    [(K.STALE_STATE, 1, 2), (K.GRIPPER_FAULT, 2, 3), (K.TRACKING_ERROR, 9, 3), (K.HARDWARE_FAULT, 1, 1)],
)
def test_a_transient_failure_does_not_end_the_preparation(
    monkeypatch: pytest.MonkeyPatch, effect: Any, kind: FailureKind, times: int, tried: int
) -> None:
    """A hardware fault is a person's business; the motors are turned on once."""
    cell, asked, parked = FakeCell(q=np.zeros(14)), [], []

    def park(*_: Any) -> Failure | None:
        parked.append(cell.now)
        return Failure(kind, "it did not work") if len(parked) <= times else None

    monkeypatch.setattr(moving, "park", park)
    monkeypatch.setattr(parking, "park", park)
    ports = cell.ports()
    arms: Any = Watched(ports.arms, asked, "arms")
    result = effect(fake_workcell(cell, ports=replace(ports, arms=arms)), INTERRUPTED)
    assert (result.event is Event.FAILED) == (tried <= times) and len(parked) == tried
    assert asked == ["arms enable"]
    pauses = np.diff(parked)
    assert all(pause > dwell for pause, dwell in zip(pauses, PREPARING_DWELLS_S, strict=False))


def test_a_stopped_cell_is_not_prepared() -> None:
    cell = FakeCell()
    workcell = fake_workcell(cell)
    workcell.ports.stop.trigger("button")
    result = prepare(workcell, RunContext())
    assert result.event is Event.FAILED and result.context.failure.kind is K.STOPPED
    assert cell.commands == []


def test_holding_commands_the_present_position() -> None:
    cell = FakeCell(q=np.full(14, 0.3))
    cell.follows = False
    assert hold_still(fake_workcell(cell), FIRST).event is Event.DONE
    ((_, q),) = cell.commands
    np.testing.assert_array_equal(q, np.full(14, 0.3))


def test_holding_sends_nothing_to_a_stopped_robot() -> None:
    cell = FakeCell()
    workcell = fake_workcell(cell, robot=SimpleNamespace(q_park=np.zeros(14)))
    workcell.ports.stop.trigger("button")
    assert hold_still(workcell, FIRST).event is Event.DONE
    assert cell.commands == []


class Watched:
    """Arms, a head and a gripper that record their commands."""

    def __init__(self, part: Any, asked: list[str], name: str) -> None:
        self._part, self._asked, self._name = part, asked, name

    def __getattr__(self, what: str) -> Any:
        if what in ("enable", "calibrate", "command_pan"):
            self._asked.append(f"{self._name} {what}")
        return getattr(self._part, what)


@pytest.mark.parametrize(("effect", "calibrated"), [(prepare, 2), (reenter, 0)])
def test_preparing_enables_the_motors_first_then_turns_the_head_and_opens_the_hands(
    effect: Any, calibrated: int
) -> None:
    cell, asked = FakeCell(q=np.zeros(14)), []
    cell.openings = dict.fromkeys(Side, 0.0)
    ports = cell.ports()
    grippers: Any = {side: Watched(g, asked, side) for side, g in ports.grippers.items()}
    arms: Any = Watched(ports.arms, asked, "arms")
    pans: list[float] = []
    head: Any = SimpleNamespace(command_pan=pans.append)
    workcell = fake_workcell(cell, ports=replace(ports, arms=arms, head=head, grippers=grippers))
    workcell = replace(workcell, calibration=replace(workcell.calibration, head_pan=0.3))
    result = effect(workcell, INTERRUPTED)
    assert result.event in {Event.DONE, INTERRUPTED.reentry}
    assert asked[0] == "arms enable" and len(asked) == 1 + calibrated
    assert pans == [0.3] and min(cell.openings.values()) > 0.04
    assert cell.now >= 1.0, "the effect waits until the head has turned"


@pytest.mark.parametrize("off", [0.1, -0.1])
def test_preparing_the_cell_parks_the_arms(
    baxter: dict[str, Any], off: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """If the direct path is free, the arms do not rise first."""
    monkeypatch.setattr(ways_out, "plan_retreat", lambda *_, **__: pytest.fail("no retreat is planned"))
    cell = FakeCell(q=BAXTER.q_park + np.r_[off, np.zeros(13)])
    assert prepare(fake_workcell(cell, **baxter), RunContext()).event is Event.DONE
    assert cell.q == pytest.approx(BAXTER.q_park)


def test_time_in_pauses_is_not_robot_time(baxter: dict[str, Any]) -> None:
    cell = FakeCell(q=BAXTER.q_park + np.r_[0.2, np.zeros(13)])
    workcell = fake_workcell(cell, **baxter)
    cell.at(1.0, lambda: workcell.commands.put(Event.PAUSE))
    cell.at(2.2, lambda: workcell.commands.put(Event.RESUME))
    result = clear(workcell, replace(FIRST, waited_s=5.0))
    assert result.event is Event.DONE and cell.q == pytest.approx(BAXTER.q_park)
    assert 5.0 + 0.5 < result.context.waited_s < 5.0 + 1.2


@pytest.mark.parametrize("spoil", ["stop", "silence"])
def test_arms_without_a_valid_state_do_not_rise(spoil: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(
        ways_out, "plan_retreat", lambda *_, **__: pytest.fail("no motion is planned from an unknown state")
    )
    cell = FakeCell(q=np.full(14, 0.5))
    workcell = fake_workcell(cell, last_command=LastCommand(np.full(14, 0.52) if spoil == "stop" else None))
    if spoil == "stop":
        workcell.ports.stop.trigger("button")
    else:
        cell.now, cell.frozen_since = 5.0, 4.0
    result = retreat(workcell, RunContext())
    assert result.event is Event.FAILED and cell.commands == []
    assert result.context.failure.kind is (K.STOPPED if spoil == "stop" else K.STALE_STATE)


INTERRUPTED = RunContext(reentry=Event.LOOK_AGAIN)


class Hand:
    """A left gripper that lost its calibration, is in error or does not move."""

    max_opening = 0.0416

    def __init__(
        self,
        cell: FakeCell,
        calibrated: bool = True,
        stuck: bool = False,
        in_error: bool = False,
        broken: bool = False,
    ) -> None:
        self._cell, self._calibrated, self._stuck, self._in_error = cell, calibrated, stuck, in_error
        self._broken = broken
        self.calibrations = 0
        self.calibrated_at: list[np.ndarray] = []

    def calibrate(self) -> None:
        self.calibrations += 1
        self.calibrated_at.append(self._cell.q.copy())
        self._calibrated, self._in_error = True, self._broken

    def command(self, opening: float, force: float) -> None:
        if not self._calibrated or self._in_error:
            raise DriverError(K.GRIPPER_FAULT, "the left gripper reports an error", "calibrate it again")
        if not self._stuck:
            self._cell.openings[Side.LEFT] = opening

    def state(self) -> GripperState:
        return GripperState(
            self._cell.now, Side.LEFT, self._cell.openings[Side.LEFT], 0.0, False, self._calibrated, self._in_error
        )


def with_left(cell: FakeCell, hand: Hand) -> Workcell:
    ports = cell.ports()
    grippers = {**ports.grippers, Side.LEFT: hand}
    return fake_workcell(cell, ports=replace(ports, grippers=grippers))


@pytest.mark.parametrize(("calibrated", "in_error"), [(True, False), (False, False), (True, True)])
def test_a_resumed_run_starts_with_open_hands(calibrated: bool, in_error: bool) -> None:
    """Calibration closes a hand before it opens, so only a hand that needs it is calibrated."""
    cell = FakeCell()
    cell.openings = dict.fromkeys(Side, 0.0)
    hand = Hand(cell, calibrated, in_error=in_error)
    result = reenter(with_left(cell, hand), INTERRUPTED)
    assert (result.event, hand.calibrations) == (Event.LOOK_AGAIN, 0 if calibrated and not in_error else 1)
    assert min(cell.openings.values()) > 0.04
    assert result.context.reentry is Event.LOOK_AGAIN, "the run can be resumed again if it dies now"


@pytest.mark.parametrize(("calibrated", "in_error"), [(False, False), (True, True)])
def test_a_closed_hand_that_refuses_commands_is_opened_by_a_calibration_before_the_arms_move(
    baxter: dict[str, Any], calibrated: bool, in_error: bool
) -> None:
    cell = FakeCell(q=OUT)
    cell.openings = dict.fromkeys(Side, 0.002)
    hand = Hand(cell, calibrated, in_error=in_error)
    workcell = replace(with_left(cell, hand), **baxter)
    result = clear(workcell, RunContext().with_failure(CAUSE))
    assert result.event is Event.DONE and result.context.failure is CAUSE
    assert hand.calibrations == 1 and hand.calibrated_at[0] == pytest.approx(OUT)
    assert min(cell.openings.values()) > 0.04 and cell.q == pytest.approx(BAXTER.q_park)


def test_an_open_hand_in_error_is_calibrated_where_it_cannot_close_on_the_garment(baxter: dict[str, Any]) -> None:
    """A calibration closes the pads before it opens them, and the hand stands at the cloth."""
    cell = FakeCell(q=OUT)
    cell.openings = dict.fromkeys(Side, 0.04)
    hand = Hand(cell, in_error=True)
    result = clear(replace(with_left(cell, hand), **baxter), RunContext().with_failure(CAUSE))
    assert result.event is Event.DONE
    assert hand.calibrations == 1 and hand.calibrated_at[0] == pytest.approx(BAXTER.q_park)
    assert not hand.state().in_error


@pytest.mark.parametrize(("opening", "parks"), [(0.04, True), (0.002, False)])
def test_a_hand_that_stays_in_error_is_led_home_only_if_it_is_known_to_hold_nothing(
    baxter: dict[str, Any], opening: float, parks: bool
) -> None:
    """Then the run can still ask for a person, with both arms parked."""
    cell = FakeCell(q=OUT)
    cell.openings = dict.fromkeys(Side, opening)
    hand = Hand(cell, in_error=True, broken=True)
    workcell = replace(with_left(cell, hand), **baxter)
    for effect in (clear, make_safe):
        result = effect(workcell, RunContext().with_failure(CAUSE))
        assert result.event is (Event.DONE if parks else Event.FAILED)
        assert (cell.q == pytest.approx(BAXTER.q_park)) is parks, f"{result.context.failure}"
    if not parks:
        assert "left gripper does not open (2 mm)" in result.context.failure.what


@pytest.mark.parametrize(("effect", "context"), [(reenter, INTERRUPTED), (clear, FIRST), (make_safe, FIRST)])
def test_arms_do_not_move_with_a_hand_that_does_not_open(effect: Any, context: RunContext) -> None:
    cell = FakeCell(q=np.full(14, 0.5))
    cell.openings = dict.fromkeys(Side, 0.002)
    result = effect(with_left(cell, Hand(cell, stuck=True)), context)
    assert result.event is Event.FAILED and result.context.failure.kind is K.GRIPPER_FAULT
    assert "left gripper does not open (2 mm)" in result.context.failure.what
    assert (cell.q == 0.5).all(), "the arms stay where they are"


def test_a_stopped_cell_is_not_reentered() -> None:
    cell = FakeCell()
    workcell = fake_workcell(cell)
    workcell.ports.stop.trigger("button")
    result = reenter(workcell, INTERRUPTED)
    assert (result.event, result.context.failure.kind) == (Event.FAILED, K.STOPPED)
    assert cell.commands == []


@pytest.mark.parametrize(("age", "opening"), [(1.0, 0.03), (0.0, float("nan"))])
def test_arms_do_not_move_with_a_hand_of_unknown_opening(age: float, opening: float) -> None:
    """The connection broke while the pads were closing, so the last state says that they are open."""
    cell = FakeCell(q=np.full(14, 0.5))
    hand = Hand(cell)
    last = GripperState(-age, Side.LEFT, opening, 0.0, False, True)
    hand.state = lambda: replace(last, stamp=cell.now - age)  # type: ignore[method-assign]
    result = clear(with_left(cell, hand), FIRST)
    assert result.event is Event.FAILED and result.context.failure.kind is K.GRIPPER_FAULT
    assert "left gripper" in result.context.failure.what
    assert (cell.q == 0.5).all(), "the arms stay where they are"


# checks before a motion


def across() -> ArmTrajectory:
    """A motion from the parked pose to a pose in which the hands, not only their fingers, are in the table."""
    q1 = np.array(BAXTER.q_park)
    q1[[0, 7]] += [-0.5, 0.5]
    q1[[1, 8]] += 1.0
    return free_motion(BAXTER.q_park, q1, BAXTER.planning)


def hurried() -> ArmTrajectory:
    """A free motion at twice the allowed speed."""
    q1 = BAXTER.q_park + np.r_[0.2, 0.1, np.zeros(12)]
    slow = free_motion(BAXTER.q_park, q1, BAXTER.planning)
    return ArmTrajectory(slow.t / 2, slow.q, 2 * slow.qd, 4 * slow.qdd)


@pytest.mark.parametrize(("motion", "kind"), [(across, K.IN_COLLISION), (hurried, K.LIMIT_EXCEEDED)])
@pytest.mark.parametrize("fingertips", [False, True])
def test_a_colliding_or_too_fast_motion_is_not_begun(
    baxter: dict[str, Any], motion: Any, kind: FailureKind, fingertips: bool
) -> None:
    cell = FakeCell(q=BAXTER.q_park)
    failure = move(fake_workcell(cell, **baxter), motion(), fingertips=fingertips)
    assert failure is not None and failure.kind is kind
    assert cell.commands == []


def test_the_start_of_a_motion_is_checked_against_the_present_arm_state(baxter: dict[str, Any]) -> None:
    """The motion was planned from the parked pose. Meanwhile a person moved a wrist by two degrees."""
    cell = FakeCell(q=BAXTER.q_park + np.r_[np.zeros(13), np.deg2rad(2.0)])
    there = free_motion(BAXTER.q_park, BAXTER.q_park + np.r_[0.1, np.zeros(13)], BAXTER.planning)
    failure = move(fake_workcell(cell, **baxter), there)
    assert failure is not None and failure.kind is K.START_MISMATCH and cell.commands == []
    cell = FakeCell(q=BAXTER.q_park)
    cell.now, cell.frozen_since = 5.0, 4.0
    failure = move(fake_workcell(cell, **baxter), there)
    assert failure is not None and failure.kind is K.STALE_STATE and cell.commands == [], (
        "a stale state is refused too"
    )


@pytest.mark.parametrize("said", [Event.PAUSE, Event.ABORT])
def test_pauses_and_aborts_do_not_interrupt_making_the_cell_safe(baxter: dict[str, Any], said: Event) -> None:
    """Only a stop ends this motion."""
    cell = FakeCell(q=BAXTER.q_park + np.r_[0.1, np.zeros(13)])
    workcell = fake_workcell(cell, **baxter)
    cell.at(1.0, lambda: workcell.commands.put(said))
    assert make_safe(workcell, FIRST).event is Event.DONE
    assert cell.now > 1.2 and cell.q == pytest.approx(BAXTER.q_park)


@pytest.mark.parametrize("effect", [prepare, clear])
def test_arms_do_not_go_home_while_a_gripper_is_being_calibrated(effect: Any) -> None:
    """A gripper moves its pads during its calibration."""
    cell = FakeCell(q=np.full(14, 0.5))
    hand = Hand(cell)
    begun = hand.state
    hand.state = lambda: replace(begun(), calibrated=False)  # type: ignore[method-assign]
    result = effect(with_left(cell, hand), FIRST)
    assert result.event is Event.FAILED and result.context.failure.kind is K.GRIPPER_FAULT
    assert "left gripper is not calibrated" in result.context.failure.what
    assert (cell.q == 0.5).all() and np.diff([t for t, _ in cell.commands]).max() < 0.2, (
        "the arms are held meanwhile"
    )
    assert 10.0 < cell.now < 20.0, "the wait for a calibration has a time limit"


def test_a_gripper_that_opens_slowly_is_waited_for() -> None:
    cell = FakeCell()
    hand = Hand(cell, stuck=True)
    cell.openings[Side.LEFT] = 0.0
    still = hand.state
    hand.state = lambda: replace(still(), moving=True)  # type: ignore[method-assign]
    cell.at(2.0, lambda: cell.openings.update({Side.LEFT: 0.04}))
    assert clear(with_left(cell, hand), FIRST).event is Event.DONE


# clearing


CAUSE = Failure(K.SLIPPED, "the left hand lost the cloth")
OUT = BAXTER.q_park + np.r_[0.4, -0.2, np.zeros(5), -0.4, -0.2, np.zeros(5)]


def come_along(cell: FakeCell, workcell: Workcell) -> None:
    """The arms come from the parked posture to OUT."""
    cell.q = BAXTER.q_park.copy()
    assert move(workcell, free_motion(BAXTER.q_park, OUT, BAXTER.planning)) is None
    cell.commands.clear()


def test_clearing_begins_when_the_arms_have_come_to_rest(baxter: dict[str, Any]) -> None:
    """A transient moves the arms for 0.8 s. Until it is over, no set-point is sent and no hand opens."""
    cell = FakeCell(q=OUT)
    cell.openings = dict.fromkeys(Side, 0.002)
    for k in range(80):
        cell.at(0.01 * k, lambda: cell.q.__iadd__(0.001))
    cell.at(0.79, lambda: opened.append(max(cell.openings.values())))
    opened: list[float] = []
    assert clear(fake_workcell(cell, **baxter), RunContext().with_failure(CAUSE)).event is Event.DONE
    assert cell.commands[0][0] > 0.8 and opened == [0.002]
    assert cell.q == pytest.approx(BAXTER.q_park)


def test_a_state_that_was_unknown_for_a_second_does_not_end_a_clearing(baxter: dict[str, Any]) -> None:
    cell = FakeCell(q=OUT)
    cell.now, cell.frozen_since = 5.0, 4.5
    cell.at(6.0, lambda: setattr(cell, "frozen_since", None))
    result = clear(fake_workcell(cell, **baxter), RunContext().with_failure(CAUSE))
    assert result.event is Event.DONE and result.context.failure is CAUSE
    assert cell.commands[0][0] > 6.0 and cell.q == pytest.approx(BAXTER.q_park)


@pytest.mark.parametrize("blocked", [0, 1, 2, 3])
def test_the_ways_out_are_tried_in_turn(
    blocked: int, baxter: dict[str, Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Directly, straight up, and back along the path that the arms came."""
    cell = FakeCell()
    workcell = fake_workcell(cell, **baxter)
    come_along(cell, workcell)
    for plan in ("plan_free_motion", "plan_retreat", "plan_along")[:blocked]:
        no_way = Outcome[Any](failure=Failure(K.IN_COLLISION, f"{plan} found nothing", "move the arms by hand"))
        monkeypatch.setattr(ways_out, plan, lambda *_, no_way=no_way, **__: no_way)
    result = clear(workcell, RunContext().with_failure(CAUSE))
    if blocked < 3:
        assert result.event is Event.DONE and cell.q == pytest.approx(BAXTER.q_park, abs=0.011)
        return
    assert result.event is Event.FAILED and cell.q == pytest.approx(OUT)
    assert result.context.failure.kind is K.IN_COLLISION and "plan_along" in result.context.failure.what


def test_the_way_back_follows_the_path_that_was_checked(
    baxter: dict[str, Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    cell = FakeCell()
    workcell = fake_workcell(cell, **baxter)
    come_along(cell, workcell)
    no_way = Outcome[Any](failure=Failure(K.IN_COLLISION, "something stands there"))
    monkeypatch.setattr(ways_out, "plan_free_motion", lambda *_, **__: no_way)
    monkeypatch.setattr(ways_out, "plan_retreat", lambda *_, **__: no_way)
    assert clear(workcell, RunContext().with_failure(CAUSE)).event is Event.DONE
    path = free_motion(BAXTER.q_park, OUT, BAXTER.planning).q
    assert max(np.abs(path - q).max(axis=1).min() for _, q in cell.commands) < 0.012
    assert len(workcell.path.back()) <= 1, "the arms stand parked, so the path is forgotten"


def test_a_motion_that_fails_on_one_way_out_is_followed_by_another(baxter: dict[str, Any]) -> None:
    """The arms hang on the straight way. They come to rest, and the next way leads up first."""
    cell = FakeCell(q=OUT)
    workcell = fake_workcell(cell, **baxter)
    cell.at(1.5, lambda: setattr(cell, "follows", False))
    cell.at(2.0, lambda: setattr(cell, "follows", True))
    assert clear(workcell, RunContext().with_failure(CAUSE)).event is Event.DONE
    assert cell.q == pytest.approx(BAXTER.q_park)
    times = np.array([t for t, _ in cell.commands])
    rest = int(np.diff(times).argmax())
    assert 1.5 < times[rest] < 2.0 and times[rest + 1] - times[rest] > 0.2
    height = [workcell.hands.height(Side.LEFT, q) for _, q in cell.commands[rest:]]
    assert max(height) > height[0] + 0.05, "the straight way leads down"


@pytest.mark.parametrize(("said", "kind"), [("abort", K.ABORTED), ("stop", K.STOPPED)])
@pytest.mark.parametrize("hangs", [False, True])
def test_after_a_stop_or_an_abort_no_other_way_out_is_tried(
    said: str, kind: FailureKind, hangs: bool, baxter: dict[str, Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    """It comes during a motion, or while the arms come to rest after a motion that failed."""
    cell, planned = FakeCell(q=OUT), []
    workcell, plan = fake_workcell(cell, **baxter), ways_out.plan_retreat
    monkeypatch.setattr(ways_out, "plan_retreat", lambda *a, **k: planned.append(cell.now) or plan(*a, **k))
    if hangs:
        cell.at(1.5, lambda: setattr(cell, "follows", False))
        cell.at(1.7, lambda: setattr(cell, "follows", True))
    commands, stop = workcell.commands, workcell.ports.stop
    interrupt = {"abort": lambda: commands.put(Event.ABORT), "stop": lambda: stop.trigger("button")}
    cell.at(1.8 if hangs else 1.25, interrupt[said])
    result = clear(workcell, RunContext().with_failure(CAUSE))
    assert (result.event, result.context.failure.kind) == (Event.FAILED, kind)
    assert len(planned) == (hangs and said == "abort"), "an abort is heard by the next motion"
    assert np.abs(cell.q - BAXTER.q_park).max() > 0.1, "the arms do not get home"


def test_a_failed_clearing_keeps_the_failure_that_led_to_it(baxter: dict[str, Any]) -> None:
    """The recovery is chosen, and counted, for the failure of the fold."""
    cell = FakeCell(q=OUT)
    cell.follows = cell.same_positions = False
    workcell, before = fake_workcell(cell, **baxter), RunContext().with_failure(CAUSE)
    failed = clear(workcell, before)
    assert (failed.event, failed.context.failure.kind) == (Event.FAILED, K.TRACKING_ERROR)
    assert failed.context.cause is CAUSE and failed.context.attempts == before.attempts
    ended, cell.follows = cell.now, True
    again = clear_again(workcell, failed.context)
    assert again.event is Event.DONE and again.context.failure is CAUSE and again.context.cause is None
    first = next(t for t, _ in cell.commands if t > ended)
    assert first - ended >= CLEARING_DWELL_S, "the transient gets time to pass"


def test_a_driver_that_fails_during_a_clearing_does_not_replace_the_cause(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def refuse(*_: Any) -> None:
        raise DriverError(K.STALE_STATE, "the positions of the arms are unknown")

    monkeypatch.setattr(parking, "wait", refuse)
    result = clear(fake_workcell(FakeCell()), RunContext().with_failure(CAUSE))
    assert (result.event, result.context.failure.kind) == (Event.FAILED, K.STALE_STATE)
    assert result.context.cause is CAUSE


@pytest.mark.parametrize("stopped", [False, True])
def test_a_run_ends_when_the_arms_rest(stopped: bool) -> None:
    """They brake for 0.4 s after the stop, or after the command to hold."""
    cell = FakeCell(q=np.full(14, 0.3))
    cell.follows = False
    for k in range(40):
        cell.at(0.01 * k, lambda: cell.q.__iadd__(0.004))
    workcell = fake_workcell(cell)
    if stopped:
        workcell.ports.stop.trigger("button")
    result = hold_still(workcell, FIRST)
    assert result.event is Event.DONE and "kind" not in result.record
    at_end = cell.q.copy()
    workcell.ports.clock.sleep_until(cell.now + 1.0)
    assert cell.q == pytest.approx(at_end, abs=0.01)
    assert len(cell.commands) == (0 if stopped else 1)
