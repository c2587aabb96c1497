"""Pressing, folding, lifting and releasing."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from foldcell.cell.control.motion import Tick
from foldcell.cell.control.motions.guarded_motions import Lowering
from foldcell.cell.control.motions.hands import Hands
from foldcell.cell.executive.effects import EFFECTS, checked_motion, folding, grasping, moving
from foldcell.cell.executive.effects.recovery import freeing, parking, ways_out
from foldcell.cell.executive.effects.recovery.ways_out import FREEING_TRIES
from foldcell.cell.hardware.workcell import Workcell
from foldcell.cell.states.run_context import RunContext
from foldcell.cell.states.transition_table import Effect, Event
from foldcell.robots.errors import DriverError, Failure, FailureKind
from foldcell.robots.model import JointLimits
from foldcell.robots.ports import ArmTrajectory, Side, arm_slice
from foldcell.skills.fold_plan import pressing
from foldcell.skills.grasping.confirm import Held, LayerCount
from foldcell.skills.grasping.stuck_on_finger import StuckCheck
from foldcell.skills.grasping.tare import TactileBias
from foldcell.skills.motion.moves.grasp import Descent
from foldcell.skills.motion.timing.jerk_limiter import JerkLimiter
from foldcell.skills.vocabulary import Outcome
from tests.builders.contexts import context_with
from tests.fakes import FakeCell
from tests.workcells import fake_workcell

TOUCHED = 0.03
"""Distance that the left hand has descended on its path [m]."""
STROKE = 0.005
"""Distance by which it is pushed down after the contact [m]."""
WAY = Descent(np.linspace(0.0, 0.5, 51)[:, None] * np.ones(7), np.linspace(0.0, 0.05, 51), TOUCHED)


def pressed(
    monkeypatch: pytest.MonkeyPatch, newtons_a_metre: float, stroke: float = STROKE
) -> tuple[FakeCell, Failure | None, Any]:
    """The left hand presses from the contact on, against a surface of this stiffness [N/m]."""
    monkeypatch.setattr(Hands, "depth", lambda *_: TOUCHED)
    cell = FakeCell(q=np.r_[WAY.at(TOUCHED), np.zeros(7)])
    workcell = fake_workcell(cell)
    depth = lambda: float(np.interp(cell.q[0], WAY.q[:, 0], WAY.depth))  # noqa: E731
    pushes = SimpleNamespace(now={Side.LEFT: 0.0}, strongest=0.0)

    def look(_: Any) -> Failure | None:
        pushes.now[Side.LEFT] = newtons_a_metre * (depth() - TOUCHED)
        pushes.strongest = max(pushes.strongest, pushes.now[Side.LEFT])
        return Failure(FailureKind.STALE_STATE, "no tips") if np.isnan(newtons_a_metre) else None

    pushes.look = look
    lowering = {Side.LEFT: Lowering(WAY, 0.05, JerkLimiter(TOUCHED))}
    monkeypatch.setattr(Hands, "height", lambda *_: 0.01)
    failure = grasping._push(workcell, lambda _, height: height - stroke, lowering, pushes)
    return cell, failure, pushes


@pytest.mark.parametrize("stroke", [STROKE, 0.016])
def test_a_hand_presses_into_soft_cloth(stroke: float, monkeypatch: pytest.MonkeyPatch) -> None:
    """Its limits delay a long stroke, which is waited for."""
    cell, failure, _ = pressed(monkeypatch, 1000.0, stroke)
    deepest = float(np.interp(cell.q[0], WAY.q[:, 0], WAY.depth))
    assert failure is None and deepest - TOUCHED == pytest.approx(stroke, abs=2e-4)


def test_a_hand_stops_on_a_hard_surface(monkeypatch: pytest.MonkeyPatch) -> None:
    """The hand comes to rest smoothly where the force on its tip reaches the limit."""
    cell, failure, pushes = pressed(monkeypatch, 8_000.0)
    most = fake_workcell(FakeCell()).settings.grasp.press_force
    assert failure is None and most < pushes.strongest < 1.5 * most
    q = np.array([q for _, q in cell.commands])[:, arm_slice(Side.LEFT, 14)]
    depth = np.interp(q[:, 0], WAY.q[:, 0], WAY.depth)
    assert abs(depth[-1] - depth[-5]) < 1e-5 and depth.max() - depth[-1] < 5e-5
    assert np.abs(np.diff(depth, n=2)).max() < 0.6 * 0.01**2 * 1.01, "the hand's acceleration limit is kept"


def test_a_hand_with_unreadable_fingertips_does_not_press(monkeypatch: pytest.MonkeyPatch) -> None:
    cell, failure, _ = pressed(monkeypatch, float("nan"))
    assert failure is not None and failure.kind is FailureKind.STALE_STATE
    assert len(cell.commands) == 1


# hands that hold cloth

ONE = np.ones(14)
LIMITS = JointLimits(-3.0 * ONE, 3.0 * ONE, 1.5 * ONE, 6.0 * ONE, 120.0 * ONE)
GRIP, THICK = 12.0, 0.004
"""Force of each grip [N], and thickness of the cloth between the pads [m]."""


@dataclass(frozen=True)
class Motion:
    """A motion without postures."""

    postures: Any = field(default_factory=dict)
    fold: Any = None


def way(distance: float, seconds: float = 2.0) -> ArmTrajectory:
    """All joints move by `distance` [rad] with minimum jerk."""
    t = np.linspace(0.0, seconds, round(100 * seconds) + 1)
    u = (t / seconds)[:, None]
    q = distance * u**3 * (10 - 15 * u + 6 * u**2) * ONE
    qd = distance / seconds * 30 * u**2 * (1 - u) ** 2 * ONE
    return ArmTrajectory(t, q, qd, np.zeros_like(q))


def holding(monkeypatch: pytest.MonkeyPatch) -> tuple[FakeCell, Workcell, RunContext]:
    """Both hands hold cloth, with the tips 20 cm over the table."""
    cell = FakeCell()
    cell.openings, cell.pads = dict.fromkeys(Side, THICK), dict.fromkeys(Side, GRIP)
    monkeypatch.setattr(Hands, "height", lambda *_: 0.2)
    robot = SimpleNamespace(q_park=np.zeros(14), protective=LIMITS)
    unloaded = TactileBias(0.0, np.zeros((2, 4, 3)), np.zeros(2), 0.01)
    held = Held(0.0, GRIP, THICK, LayerCount((0.0, 1.0), 1.0, 0.1))
    motion: Any = Motion()
    context = context_with(motion=motion, biases=dict.fromkeys(Side, unloaded), held=dict.fromkeys(Side, held))
    return cell, fake_workcell(cell, robot=robot, limits=LIMITS), context


def lose(cell: FakeCell, side: Side) -> None:
    """The hand loses the cloth, and its pads close on each other."""
    cell.openings[side], cell.pads[side] = 0.0, 0.0


def test_a_fold_is_completed_while_both_hands_hold(monkeypatch: pytest.MonkeyPatch) -> None:
    cell, workcell, context = holding(monkeypatch)
    monkeypatch.setattr(folding, "plan_arc", lambda *_, **__: Outcome(SimpleNamespace(fold=way(0.5))))
    result = EFFECTS[Effect.FOLD](workcell, context)
    assert result.event is Event.DONE and cell.q == pytest.approx(0.5)
    taken = [frame.stamp for frame in result.context.fold.attempt.pictures]
    assert taken == pytest.approx(np.linspace(0.0, 2.0, len(taken)), abs=0.05)
    assert len(taken) == workcell.settings.recorder.key_frames


@pytest.mark.parametrize("side", list(Side))
def test_a_loss_of_cloth_by_either_hand_ends_the_fold_at_rest_on_its_path(
    side: Side, monkeypatch: pytest.MonkeyPatch
) -> None:
    cell, workcell, context = holding(monkeypatch)
    monkeypatch.setattr(folding, "plan_arc", lambda *_, **__: Outcome(SimpleNamespace(fold=way(0.5))))
    cell.at(0.8, lambda: lose(cell, side))
    result = EFFECTS[Effect.FOLD](workcell, context)
    assert result.event is Event.FAILED and result.context.failure.kind is FailureKind.SLIPPED
    assert f"the {side} hand" in result.context.failure.what
    q = np.array([q[0] for _, q in cell.commands])
    assert 0.05 < q[-1] < 0.45 and q[-1] - q[-2] < 1e-4, "the arms rest on the path"
    assert cell.now < 0.8 + 0.1 + 0.7, "the loss is detected within 100 ms, and the arms rest 0.6 s later"


def test_a_loss_of_cloth_in_a_pause_moves_no_arm_and_opens_no_hand_before_the_person_resumes(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    cell, workcell, context = holding(monkeypatch)
    monkeypatch.setattr(folding, "plan_arc", lambda *_, **__: Outcome(SimpleNamespace(fold=way(0.5))))
    cell.at(0.6, lambda: workcell.commands.put(Event.PAUSE))
    cell.at(2.0, lambda: lose(cell, Side.LEFT))
    cell.at(6.0, lambda: workcell.commands.put(Event.RESUME))
    result = EFFECTS[Effect.FOLD](workcell, context)
    assert result.context.failure.kind is FailureKind.SLIPPED and cell.now == pytest.approx(6.0, abs=0.05)
    resting = np.array([q[0] for t, q in cell.commands if t > 1.5])
    assert len(resting) > 400 and np.ptp(resting) == 0.0
    assert cell.openings[Side.RIGHT] == THICK and set(result.context.fold.held) == set(Side)


def test_nothing_is_folded_if_the_arc_is_in_collision(monkeypatch: pytest.MonkeyPatch) -> None:
    """The arc is planned again from the hands' real positions, so it may differ from the first plan."""
    cell, workcell, context = holding(monkeypatch)
    blocked = Failure(FailureKind.IN_COLLISION, "the hands would meet")
    monkeypatch.setattr(folding, "plan_arc", lambda *_, **__: Outcome(failure=blocked))
    result = EFFECTS[Effect.FOLD](workcell, context)
    assert result.event is Event.FAILED and result.context.failure is blocked and not cell.commands


@pytest.mark.parametrize("stopped", [False, True])
def test_a_camera_failure_does_not_end_a_fold_but_a_stop_does(
    stopped: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    _, workcell, context = holding(monkeypatch)
    monkeypatch.setattr(folding, "plan_arc", lambda *_, **__: Outcome(SimpleNamespace(fold=way(0.5))))

    def glimpse() -> None:
        raise DriverError(FailureKind.STOPPED if stopped else FailureKind.CAMERA_FAULT, "no picture")

    monkeypatch.setattr(workcell.ports.camera, "glimpse", glimpse)
    if stopped:
        with pytest.raises(DriverError):
            EFFECTS[Effect.FOLD](workcell, context)
        return
    result = EFFECTS[Effect.FOLD](workcell, context)
    assert result.event is Event.DONE and result.context.fold.attempt.pictures == ()


@pytest.mark.parametrize("side", list(Side))
def test_a_loss_of_cloth_during_the_lift_is_a_missed_grasp(side: Side, monkeypatch: pytest.MonkeyPatch) -> None:
    cell, workcell, context = holding(monkeypatch)
    monkeypatch.setattr(folding, "plan_lift", lambda *_, **__: Outcome(way(0.1)))
    monkeypatch.setattr(checked_motion, "check_trajectory", lambda *_, **__: Outcome("checked"))
    assert folding.lift(workcell, context).event is Event.DONE
    cell.q = np.zeros(14)
    workcell.last_command.q = None
    lose(cell, side)
    result = folding.lift(workcell, context)
    assert result.event is Event.FAILED and result.context.failure.kind is FailureKind.MISSED_GRASP
    assert f"the {side} hand" in result.context.failure.what


def test_a_fold_counts_as_carried_if_the_hands_do_not_open(monkeypatch: pytest.MonkeyPatch) -> None:
    """The fold was made, so it is inspected and not repeated."""
    _, workcell, context = holding(monkeypatch)
    for gripper in workcell.ports.grippers.values():
        monkeypatch.setattr(gripper, "command", lambda opening, force: None)
    result = EFFECTS[Effect.RELEASE](workcell, context)
    assert result.event is Event.FAILED and result.context.failure.kind is FailureKind.GRIPPER_FAULT
    assert result.context.fold.carried and result.context.fold.held, "the cloth may still be held"


def test_a_hand_opens_only_to_the_release_width(monkeypatch: pytest.MonkeyPatch) -> None:
    """Pads that open wide would push the stack away."""
    cell, workcell, context = holding(monkeypatch)
    result = EFFECTS[Effect.RELEASE](workcell, context)
    assert result.event is Event.DONE and result.context.fold.carried and not result.context.fold.held
    assert all(0.01 < opening < 0.025 for opening in cell.openings.values())


@pytest.mark.parametrize("repaired", [False, True])
def test_a_repair_counts_once_the_hands_have_released_its_cloth(
    repaired: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    _, workcell, context = holding(monkeypatch)
    repair: Any = SimpleNamespace(name="undo", in_words=lambda: "the hands carry it back")
    context = replace(context, fold=replace(context.fold, repair=repair if repaired else None))
    released = EFFECTS[Effect.RELEASE](workcell, context).context
    assert released.repairs == ((context.fold.index, "undo: the hands carry it back"),) * repaired


def retreating(
    monkeypatch: pytest.MonkeyPatch, clings: dict[Side, int], light: bool = False
) -> tuple[FakeCell, Workcell, RunContext, list[str]]:
    """The hands have released the cloth. clings: for each hand on which cloth clings, how often it has to close
    until the cloth comes off. light: the cloth is felt only when it drags the garment along. Also returns the list
    of what was done."""
    cell, workcell, context = holding(monkeypatch)
    cell.openings, cell.pads = (
        dict.fromkeys(Side, 0.02),
        {s: 0.5 if s in clings and not light else 0.0 for s in Side},
    )
    done: list[str] = []
    rise = np.array([np.zeros(14), np.full(14, 0.1)])
    up, home = SimpleNamespace(q=rise, name="up"), SimpleNamespace(q=rise + 0.1, name="home")
    away: Any = SimpleNamespace(retreat=up, park=home)
    monkeypatch.setattr(ways_out, "plan_retreat", lambda *_, **__: Outcome(away))

    def along(robot: Any, checker: Any, q: Any, path: Any, limits: Any, tool_speed: float) -> Outcome[Any]:
        way = "home" if path[-1, 0] > 0.15 else "up" if path[-1, 0] > path[0, 0] else "down"
        return Outcome(SimpleNamespace(name=way, q=path))

    def move(
        cell: Workcell, motion: Any, fingertips: bool = False, control: Any = None, watch: Any = None
    ) -> Failure | None:
        assert fingertips is (motion.name != "home"), (
            "the hands are near the cloth only while they rise or descend"
        )
        done.append(motion.name)
        assert (watch is not None) == (motion.name != "down")
        caught = [side for side, times in clings.items() if times > 0]
        if not (light and caught and motion.name == "home"):
            return None
        return Failure(FailureKind.STUCK_ON_FINGER, "cloth drags", values={"side": caught[0].value})

    for side, gripper in workcell.ports.grippers.items():
        command = gripper.command

        def told(opening: float, force: float, side: Side = side, command: Any = command) -> None:
            done.append(f"{side} {'closes' if opening == 0.0 else 'opens'}")
            command(opening, force)
            if opening == 0.0 and side in clings:
                clings[side] -= 1
                cell.pads[side] = 0.5 if clings[side] > 0 and not light else 0.0

        monkeypatch.setattr(gripper, "command", told)
    monkeypatch.setattr(ways_out, "plan_along", along)
    for module in (freeing, ways_out):
        monkeypatch.setattr(module, "move", move)
    return cell, workcell, context, done


def test_hands_without_cloth_on_a_finger_retreat_at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    _, workcell, context, done = retreating(monkeypatch, {})
    assert moving.retreat(workcell, context).event is Event.DONE
    assert done == ["up", "home"]


@pytest.mark.parametrize("side", Side)
def test_cloth_on_a_finger_is_laid_down_and_freed_by_closing_and_opening_the_hand(
    side: Side, monkeypatch: pytest.MonkeyPatch
) -> None:
    cell, workcell, context, done = retreating(monkeypatch, {side: 1})
    result = moving.retreat(workcell, context)
    assert result.event is Event.DONE
    assert [felt["side"] for felt in result.record["cloth_on_finger"]] == [side.value]
    assert done == ["up", "down", f"{side} closes", f"{side} opens", "up", "home"]
    assert cell.openings[side] == pytest.approx(parking.RELEASE_OPENING)


@pytest.mark.parametrize("side", Side)
def test_light_cloth_that_is_felt_on_the_way_home_is_led_back_before_it_is_freed(
    side: Side, monkeypatch: pytest.MonkeyPatch
) -> None:
    _, workcell, context, done = retreating(monkeypatch, {side: 1}, light=True)
    assert moving.retreat(workcell, context).event is Event.DONE
    assert done == ["up", "home", "down", f"{side} closes", f"{side} opens", "up", "home"]


def test_both_hands_are_freed_one_after_the_other(monkeypatch: pytest.MonkeyPatch) -> None:
    _, workcell, context, done = retreating(monkeypatch, {Side.LEFT: 1, Side.RIGHT: 1})
    assert moving.retreat(workcell, context).event is Event.DONE
    assert done.count("down") == 2 and done[-1] == "home"


@pytest.mark.parametrize("side", Side)
def test_cloth_that_stays_on_a_finger_prevents_the_retreat_home(
    side: Side, monkeypatch: pytest.MonkeyPatch
) -> None:
    _, workcell, context, done = retreating(monkeypatch, {side: 99})
    result = moving.retreat(workcell, context)
    assert result.event is Event.FAILED and "home" not in done
    assert done.count("down") == FREEING_TRIES
    assert result.context.failure.kind is FailureKind.STUCK_ON_FINGER and side in result.context.failure.what


def rising(
    monkeypatch: pytest.MonkeyPatch, between: dict[Side, float], sides: tuple[Side, ...] = tuple(Side)
) -> tuple[FakeCell, Workcell, Any, list[tuple[Side, float, float]]]:
    """The hands of `sides` rise by 10 cm. between: thickness of what stayed between the pads of a hand [m]. Also
    returns the way up, and the commands to the grippers: hand, opening [m], height of the hand [m]."""
    cell, workcell, _ = holding(monkeypatch)

    def along(robot: Any, checker: Any, q: Any, path: Any, limits: Any, tool_speed: float) -> Outcome[Any]:
        run = way(1.0, np.abs(path[-1] - q).max() / tool_speed + 0.3)
        return Outcome(replace(run, q=q + run.q * (path[-1] - q), qd=run.qd * (path[-1] - q)))

    monkeypatch.setattr(ways_out, "plan_along", along)
    cell.openings, cell.pads = dict.fromkeys(Side, 0.02), dict.fromkeys(Side, 0.0)
    height = lambda side, q: float(q[arm_slice(side, 14)][0])  # noqa: E731
    monkeypatch.setattr(Hands, "height", lambda _, side, q: height(side, q))
    monkeypatch.setattr(checked_motion, "check_trajectory", lambda *_, **__: Outcome("checked"))
    commands: list[tuple[Side, float, float]] = []
    for side, gripper in workcell.ports.grippers.items():

        def command(opening: float, force: float, side: Side = side) -> None:
            commands.append((side, opening, height(side, cell.q)))
            cloth = between.get(side, 0.0)
            cell.openings[side] = max(opening, cloth)
            cell.pads[side] = GRIP if opening < cloth else 0.0

        monkeypatch.setattr(gripper, "command", command)
    up = way(0.1, 0.8)
    for side in set(Side) - set(sides):
        up.q[:, arm_slice(side, 14)] = up.qd[:, arm_slice(side, 14)] = 0.0
    return cell, workcell, up, commands


UNLOADED = dict.fromkeys(Side, TactileBias(0.0, np.zeros((2, 4, 3)), np.zeros(2), 0.01))
LAYER = 0.0008


def test_empty_hands_close_and_open_again_on_their_way_up(monkeypatch: pytest.MonkeyPatch) -> None:
    """They close at rest: higher than a crease of an earlier fold, and no further than cloth may be lifted."""
    cell, workcell, up, commands = rising(monkeypatch, {})
    assert freeing._rise(workcell, up, UNLOADED, LAYER, checked_motion.pausable(workcell), {}) is None
    assert {side for side, _, _ in commands} == set(Side)
    assert all(0.033 < height < 0.038 for _, _, height in commands)
    assert cell.openings == dict.fromkeys(Side, parking.RELEASE_OPENING) and cell.q == pytest.approx(0.1)


@pytest.mark.parametrize(
    ("offset", "layer", "misread"),
    [(0.0, LAYER, False), (0.003, LAYER, True), (0.0013, 0.005, False), (0.003, 0.005, True)],
)
def test_a_gripper_that_misreads_its_empty_pads_is_calibrated_and_its_layers_are_forgotten(
    offset: float, layer: float, misread: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its offset was taken for thick fabric, of which the other hand later held too few layers. With layers of
    5 mm, pads count as met before they are closed."""
    _, workcell, up, _ = rising(monkeypatch, {})
    away: Any = SimpleNamespace(retreat=up, park=way(0.0))
    monkeypatch.setattr(moving, "plan_rise", lambda *_: Outcome(away))
    monkeypatch.setattr(moving, "_thinnest_layer", lambda _: layer)
    monkeypatch.setattr(freeing, "move", lambda *_, **__: None)
    calibrated: list[Side] = []
    for side, gripper in workcell.ports.grippers.items():
        monkeypatch.setattr(gripper, "calibrate", lambda side=side: calibrated.append(side))
    left = workcell.ports.grippers[Side.LEFT]
    seen = left.state
    monkeypatch.setattr(left, "state", lambda: replace(seen(), opening=seen().opening + offset))
    result = moving.retreat(workcell, context_with(biases=UNLOADED, layer_thickness=0.002))
    assert result.event is Event.DONE
    assert calibrated == ([Side.LEFT] if misread else [])
    assert result.context.fold.layer_thickness == (None if misread else 0.002)


def test_a_hand_that_does_not_open_again_rises_no_further(monkeypatch: pytest.MonkeyPatch) -> None:
    """It may hold cloth, which it would lift and drag along."""
    cell, workcell, up, _ = rising(monkeypatch, {})
    left = workcell.ports.grippers[Side.LEFT]
    command = left.command

    def jam(opening: float, force: float) -> None:
        if opening == 0.0:
            command(opening, force)

    monkeypatch.setattr(left, "command", jam)
    failure = freeing._rise(workcell, up, UNLOADED, LAYER, checked_motion.pausable(workcell), {})
    assert failure is not None and "left" in failure.what and cell.q.max() < 0.038


def test_a_stop_ends_the_closing_at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    cell, workcell, up, commands = rising(monkeypatch, {})
    left = workcell.ports.grippers[Side.LEFT]
    command, stopped = left.command, [np.inf]

    def pressed(opening: float, force: float) -> None:
        command(opening, force)
        if cell.now < stopped[0]:
            stopped[0] = cell.now
            cell.at(cell.now + 0.015, lambda: workcell.ports.stop.trigger("button"))

    monkeypatch.setattr(left, "command", pressed)
    failure = freeing._rise(workcell, up, UNLOADED, LAYER, checked_motion.pausable(workcell), {})
    assert failure is not None and failure.kind is FailureKind.STOPPED
    assert {opening for _, opening, _ in commands} == {0.0} and cell.q.max() < 0.038


def test_the_other_hand_opens_before_the_hands_go_back_down(monkeypatch: pytest.MonkeyPatch) -> None:
    """It was closing, too, and would take cloth of the released fold."""
    cell, workcell, up, _ = rising(monkeypatch, {Side.LEFT: 0.0008})
    retreat: Any = SimpleNamespace(retreat=up, park=up)
    cell.openings[Side.RIGHT] = 0.004
    monkeypatch.setattr(
        freeing, "_rise", lambda *_: Failure(FailureKind.STUCK_ON_FINGER, "", values={"side": "left"})
    )
    down: list[float] = []
    monkeypatch.setattr(freeing, "_lead", lambda *_: down.append(cell.openings[Side.RIGHT]))
    freeing.leave_freely(workcell, retreat, UNLOADED, LAYER, checked_motion.pausable(workcell))
    assert down[0] == parking.RELEASE_OPENING


@pytest.mark.parametrize("side", Side)
def test_a_hand_that_closes_on_cloth_while_it_rises_keeps_it(side: Side, monkeypatch: pytest.MonkeyPatch) -> None:
    cell, workcell, up, commands = rising(monkeypatch, {side: 0.0008})
    failure = freeing._rise(workcell, up, UNLOADED, LAYER, checked_motion.pausable(workcell), {})
    assert failure is not None and failure.kind is FailureKind.STUCK_ON_FINGER
    assert failure.values["side"] == side.value and cell.q.max() < 0.038
    assert cell.openings[side] == 0.0008 and {opening for s, opening, _ in commands if s is side} == {0.0}


def test_in_a_pause_no_hand_is_judged(monkeypatch: pytest.MonkeyPatch) -> None:
    """A person may touch the hands meanwhile. The clock of the path shows that the arms rest."""
    cell, workcell, _, _ = rising(monkeypatch, {})
    checks = {side: StuckCheck(workcell.grasp, bias) for side, bias in UNLOADED.items()}
    weighing = freeing._Weighing(workcell, checks, dict.fromkeys(Side, 0.04))
    dragging = freeing._dragging(workcell, UNLOADED)

    def tick(t: float) -> Tick:
        cell.now += 0.01
        return Tick(t, workcell.ports.arms.state())

    for k in range(50):  # the pads are unloaded at first
        assert dragging(tick(0.01 * k)) is None
    cell.q[:] = 0.05
    assert weighing.look(tick(0.5)) is None
    cell.pads = dict.fromkeys(Side, GRIP)
    assert dragging(tick(0.48)) is None
    for _ in range(300):
        assert weighing.look(tick(0.5)) is None and dragging(tick(0.48)) is None
    for after in (dragging, weighing.look):
        assert any(after(tick(0.51 + 0.01 * k)) for k in range(50)), "after the pause the load is felt"


@pytest.mark.parametrize("height", [0.03, 0.1])
def test_hands_are_weighed_above_the_garment(height: float, monkeypatch: pytest.MonkeyPatch) -> None:
    """Pads that touch the garment on the way up are loaded, too."""
    cell, workcell, _, _ = rising(monkeypatch, {})
    cell.openings = dict.fromkeys(Side, pressing.OPENING)

    class Touching(dict[Side, float]):
        def __getitem__(self, side: Side) -> float:
            return 0.5 if cell.q.max() < height else 0.0

    cell.pads = Touching(cell.pads)
    failure = freeing._rise(workcell, way(0.1), UNLOADED, LAYER, checked_motion.pausable(workcell), {})
    assert (failure is None) == (height < 0.1)


def test_only_a_hand_that_rises_and_obeys_closes(monkeypatch: pytest.MonkeyPatch) -> None:
    """A gripper that refuses commands is left to the next grasp. A hand that stays low would take cloth."""
    cell, workcell, up, commands = rising(monkeypatch, {}, sides=(Side.LEFT,))

    def refuse(opening: float, force: float) -> None:
        raise DriverError(FailureKind.GRIPPER_FAULT, "it reports an error")

    monkeypatch.setattr(workcell.ports.grippers[Side.LEFT], "command", refuse)
    assert freeing._rise(workcell, up, UNLOADED, LAYER, checked_motion.pausable(workcell), {}) is None
    assert not commands and cell.openings == dict.fromkeys(Side, 0.02)


@pytest.mark.parametrize("state", [{"in_error": True}, {"calibrated": False}])
def test_a_hand_that_is_in_error_or_not_calibrated_gets_no_command_while_it_rises(
    state: dict[str, bool], monkeypatch: pytest.MonkeyPatch
) -> None:
    _, workcell, up, commands = rising(monkeypatch, {})
    left = workcell.ports.grippers[Side.LEFT]
    seen = left.state
    monkeypatch.setattr(left, "state", lambda: replace(seen(), **state))  # type: ignore[arg-type]
    assert freeing._rise(workcell, up, UNLOADED, LAYER, checked_motion.pausable(workcell), {}) is None
    assert {side for side, _, _ in commands} == {Side.RIGHT}


def test_hands_that_have_pressed_a_crease_do_not_close_on_it(monkeypatch: pytest.MonkeyPatch) -> None:
    cell, workcell, up, commands = rising(monkeypatch, {})
    cell.openings = dict.fromkeys(Side, pressing.OPENING)
    assert freeing._rise(workcell, up, UNLOADED, LAYER, checked_motion.pausable(workcell), {}) is None
    assert not commands


@pytest.mark.parametrize("kind", [FailureKind.STOPPED, FailureKind.GRIPPER_FAULT])
def test_a_hand_that_closed_and_does_not_open_may_hold_cloth(
    kind: FailureKind, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A stop is raised as usual."""
    cell, workcell, up, _ = rising(monkeypatch, {})

    def refuse(opening: float, force: float) -> None:
        cell.openings[Side.LEFT] = 0.004
        raise DriverError(kind, "no")

    monkeypatch.setattr(workcell.ports.grippers[Side.LEFT], "command", refuse)
    control = checked_motion.pausable(workcell)
    if kind is FailureKind.STOPPED:
        with pytest.raises(DriverError):
            freeing._rise(workcell, up, UNLOADED, LAYER, control, {})
        return
    failure = freeing._rise(workcell, up, UNLOADED, LAYER, control, {})
    assert failure is not None and "may hold the garment" in failure.what
