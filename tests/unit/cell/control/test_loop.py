"""The control loop applies the same rules on every tick to every kind of motion."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from foldcell.cell.control.loop import ControlLoop
from foldcell.cell.control.motion import Feedback, Motion, Order, SetPoint, Tick
from foldcell.cell.control.motions.guarded_motions import (
    FingertipForceMonitor,
    GuardedHand,
    Lowering,
    guarded_descent,
    push_down,
)
from foldcell.cell.control.motions.hands import Hands, each_hand
from foldcell.cell.control.motions.hold_position import wait
from foldcell.cell.control.motions.trajectory import stream
from foldcell.cell.control.path_clock import PathControl
from foldcell.cell.control.set_points import LastCommand
from foldcell.cell.control.ticks import LOST_S, TICK_S
from foldcell.cell.states.commands import CommandQueue
from foldcell.cell.states.transition_table import Event
from foldcell.cell.support.forwarding import forwarding
from foldcell.robots.errors import Failure, FailureKind
from foldcell.robots.model import JointLimits
from foldcell.robots.ports import ArmTrajectory, Array, JointSetpoint, JointState, Ports, Side, arm_slice
from foldcell.skills.grasping.descend import DescentGoal, start_descent
from foldcell.skills.grasping.hand_reading import validate_reading
from foldcell.skills.grasping.tare import TactileBias
from foldcell.skills.motion.moves.grasp import Descent
from foldcell.skills.motion.timing.jerk_limiter import JerkLimiter
from foldcell.skills.vocabulary import Outcome
from tests.builders.shipped_settings import GRASP, LIMITS
from tests.fakes import FakeCell

K = FailureKind
ONE = np.ones(14)
JOINTS = JointLimits(-3.0 * ONE, 3.0 * ONE, 1.5 * ONE, 6.0 * ONE, 120.0 * ONE)
KINDS = ("trajectory", "hold", "hands", "descent", "press")
AT = 0.2
"""Time at which a fault occurs [s]: during the motion, for each kind of motion."""
TOP = 0.05
WAY = Descent(np.linspace(0.0, 0.3, 61)[:, None] * np.ones(7), np.linspace(0.0, 0.06, 61), 0.05)
"""Each joint turns by 5 rad per metre of the hand's path."""
AIR = TactileBias(0.0, np.zeros((2, 4, 3)), np.zeros(2), 0.01)


class Recorded:
    """Telemetry that records nothing."""

    def joints(self, state: JointState) -> None: ...

    def tactile(self, reading: Any) -> None: ...

    def gripper(self, state: Any) -> None: ...


class OverTable(Hands):
    """Hands whose height is the position of the first joint of each arm."""

    def height(self, side: Side, q: Array) -> float:
        return TOP - float(np.interp(q[arm_slice(side, 14)][0], WAY.q[:, 0], WAY.depth))


@dataclass
class Bench:
    """A fake cell and the loop that runs a motion in it."""

    cell: FakeCell
    ports: Ports
    loop: ControlLoop

    def run(
        self, kind: str, commands: CommandQueue | None = None, control: PathControl | None = None
    ) -> Outcome[Any]:
        """Run one motion of this kind, which takes at least 0.4 s. Tactile readings that are not numbers end every
        kind."""
        robot: Any = None
        table: Any = None
        hands = OverTable(self.ports, robot, table, Recorded())

        def watch(tick: Tick) -> Failure | None:
            return validate_reading(hands.read(Side.LEFT, tick.state))

        if kind == "trajectory":
            return stream(self.loop, sweep(), watch, control or PathControl(commands, JOINTS, JOINTS))
        if kind == "hold":
            failure = wait(self.loop, 0.6, watch)
            return Outcome(failure=failure) if failure else Outcome("held")
        if kind == "hands":
            return each_hand(self.loop, hands, {Side.LEFT: 0}, counted)
        if kind == "press":
            lowering = {Side.LEFT: Lowering(WAY, TOP, JerkLimiter(0.01))}
            pushes = FingertipForceMonitor(hands, {Side.LEFT: AIR})
            strokes = {Side.LEFT: (0.01, 0.02)}
            return self.loop.run(
                lambda start: push_down(hands, self.loop.last_command, start, lowering, strokes, pushes, 25.0)
            )

        def begin(start: JointState) -> Motion[Any]:
            state = start_descent(GRASP, DescentGoal(0.0, -0.005), AIR, hands.read(Side.LEFT, start))
            hand = GuardedHand(Lowering(WAY, TOP), state)
            return guarded_descent(hands, self.loop.last_command, start, {Side.LEFT: hand})

        return self.loop.run(begin)


def counted(side: Side, reading: Any, ticks: int) -> int | Outcome[int]:
    """A hand controller that works for 0.6 s."""
    bad = validate_reading(reading)
    if bad:
        return Outcome(failure=bad)
    return ticks + 1 if ticks < 60 else Outcome(ticks)


def sweep(seconds: float = 2.0) -> ArmTrajectory:
    """All joints turn by 0.3 rad with minimum jerk."""
    t = np.linspace(0.0, seconds, 201)
    u = (t / seconds)[:, None]
    q = 0.3 * u**3 * (10 - 15 * u + 6 * u**2) * ONE
    qd = 0.3 / seconds * 30 * u**2 * (1 - u) ** 2 * ONE
    return ArmTrajectory(t, q, qd, np.zeros_like(q))


def bench(kind: str, clock: Callable[[Any], Any] = lambda clock: clock) -> Bench:
    cell = FakeCell(q=np.r_[WAY.at(0.01), np.zeros(7)] if kind == "press" else None)
    ports = cell.ports()
    ports = replace(ports, clock=clock(ports.clock))
    return Bench(cell, ports, ControlLoop(ports, LIMITS, LastCommand()))


def spoil_tactile(cell: FakeCell) -> None:
    cell.pads = dict.fromkeys(Side, float("nan"))


def push_arms(cell: FakeCell) -> None:
    """A person pushes both arms."""
    cell.follows, cell.q = False, cell.q + 0.2


# every kind of motion


@pytest.mark.parametrize("kind", KINDS)
def test_a_stop_ends_a_motion_within_a_tick(kind: str) -> None:
    """The fake raises an error on a set-point to a stopped robot."""
    b = bench(kind)
    b.cell.at(AT, lambda: b.ports.stop.trigger("button"))
    failure = b.run(kind).failure
    assert failure is not None and failure.kind is K.STOPPED and "button" in failure.what
    assert b.cell.now == pytest.approx(AT) and b.loop.last_command.q is None


@pytest.mark.parametrize("kind", KINDS)
def test_straying_arms_are_commanded_to_hold_where_they_are(kind: str) -> None:
    b = bench(kind)
    b.cell.at(AT, lambda: push_arms(b.cell))
    failure = b.run(kind).failure
    assert failure is not None and failure.kind is K.TRACKING_ERROR and failure.values["off_rad"] > 0.19
    assert b.cell.now == pytest.approx(AT) and b.cell.commands[-1][1] == pytest.approx(b.cell.q)
    assert b.loop.last_command.q is None, "the next motion begins at the arms' position"


@pytest.mark.parametrize(
    ("latency", "pushed", "found"),
    [(0.0, False, True), (0.1, False, False), (0.1, True, True)],
    ids=["not stated", "stated", "stated, and the arms stray"],
)
def test_readings_over_a_slow_network_are_compared_with_the_set_points_of_their_time(
    latency: float, pushed: bool, found: bool
) -> None:
    """The joints turn by 0.28 rad/s, and a reading shows where they were 0.1 s before."""
    b = bench("trajectory")
    past = [b.cell.q] * 10

    def state() -> JointState:
        past.append(b.cell.q)
        return replace(b.ports.arms.state(), q=past[-11] + 1e-6 * len(past))

    if pushed:
        b.cell.at(AT, lambda: push_arms(b.cell))
    ports = replace(b.ports, arms=forwarding(b.ports.arms, state=state))
    loop = ControlLoop(ports, replace(LIMITS, tracking=0.02, latency_s=latency), LastCommand())
    failure = stream(loop, sweep(), None, PathControl(None, JOINTS, JOINTS)).failure
    assert (failure is not None and failure.kind is K.TRACKING_ERROR) == found


@pytest.mark.parametrize("kind", KINDS)
def test_an_altered_set_point_is_followed_by_a_hold(kind: str, monkeypatch: pytest.MonkeyPatch) -> None:
    b = bench(kind)
    through = b.ports.arms.command

    def altered(q: Array, qd: Array) -> JointSetpoint:
        off = 0.003 if AT - TICK_S / 2 < b.cell.now < AT + TICK_S / 2 else 0.0
        return JointSetpoint(b.cell.now, through(q, qd).q + off, qd, off > 0.0)

    monkeypatch.setattr(b.ports.arms, "command", altered)
    failure = b.run(kind).failure
    assert failure is not None and failure.kind is K.LIMIT_EXCEEDED and failure.values["clipped"]
    assert b.cell.now == pytest.approx(AT + TICK_S) and b.cell.commands[-1][0] == b.cell.now
    assert b.loop.last_command.q is None


@pytest.mark.parametrize("kind", KINDS)
def test_arms_with_a_stale_state_are_not_commanded_to_it(kind: str) -> None:
    b = bench(kind)
    b.cell.at(AT, lambda: setattr(b.cell, "frozen_since", b.cell.now))
    failure = b.run(kind).failure
    assert failure is not None and failure.kind is K.STALE_STATE
    known = AT + LIMITS.stale_s + 2 * TICK_S
    assert b.cell.now <= (known + 0.65 if kind == "trajectory" else known), (
        "only a motion on a path comes to rest first"
    )
    assert b.loop.last_command.q is not None and b.loop.last_command.q == pytest.approx(b.cell.commands[-1][1])


@pytest.mark.parametrize("kind", KINDS)
def test_a_failure_watched_by_the_motion_ends_it(kind: str) -> None:
    b = bench(kind)
    b.cell.at(AT, lambda: spoil_tactile(b.cell))
    failure = b.run(kind).failure
    assert failure is not None and failure.kind is K.TACTILE_FAULT and "left" in failure.what
    assert b.cell.now <= AT + (0.65 if kind == "trajectory" else TICK_S)
    assert b.loop.last_command.q == pytest.approx(b.cell.commands[-1][1]), "the arms stay at the last set-point"


class Late:
    """A clock whose program stalls once, at AT."""

    def __init__(self, clock: Any, seconds: float) -> None:
        self._clock, self._seconds = clock, seconds

    def now(self) -> float:
        return float(self._clock.now())

    def sleep_until(self, t: float) -> None:
        late = self._seconds if t > AT + 1e-9 else 0.0
        self._seconds -= late
        self._clock.sleep_until(t + late)


@pytest.mark.parametrize("kind", KINDS)
def test_after_a_late_tick_there_is_still_one_set_point_a_tick(kind: str) -> None:
    """The fake raises an error on a set-point that jumps."""
    in_time, late = bench(kind), bench(kind, lambda clock: Late(clock, 0.15))
    ended = in_time.run(kind), late.run(kind)
    assert [e.failure and e.failure.kind for e in ended] == [K.NO_CONTACT if kind == "descent" else None] * 2
    gaps = np.diff([t for t, _ in late.cell.commands])
    held_up = np.flatnonzero(gaps > 0.05)
    assert len(held_up) == 1 and gaps[held_up[0]] == pytest.approx(0.15 + TICK_S)
    assert np.delete(gaps, held_up) == pytest.approx(TICK_S)
    assert late.cell.q == pytest.approx(in_time.cell.q, abs=1e-3)
    q = np.array([q[0] for _, q in late.cell.commands])
    if kind == "trajectory":
        assert abs(q[held_up[0] + 2] - q[held_up[0] + 1]) < 1e-4, "the motion starts from rest"


@pytest.mark.parametrize("kind", KINDS)
def test_a_suspended_program_does_not_continue_the_motion(kind: str) -> None:
    b = bench(kind, lambda clock: Late(clock, LOST_S + 0.5))
    failure = b.run(kind).failure
    assert failure is not None and failure.kind is K.STOPPED and "delayed" in failure.what


@pytest.mark.parametrize("kind", KINDS)
def test_nothing_is_sent_to_a_stopped_robot(kind: str) -> None:
    b = bench(kind)
    b.ports.stop.trigger("button")
    failure = b.run(kind).failure
    assert failure is not None and failure.kind is K.STOPPED and b.cell.commands == []


@pytest.mark.parametrize("kind", KINDS)
def test_silent_arms_do_not_begin_a_motion(kind: str) -> None:
    b = bench(kind)
    b.cell.now, b.cell.frozen_since = 5.0, 4.0
    failure = b.run(kind).failure
    assert b.cell.commands == []
    if kind == "hold":
        assert failure is None and b.cell.now == pytest.approx(5.6), "this motion only waits, so it has no start"
    else:
        assert failure is not None and failure.kind is K.STALE_STATE and b.cell.now == 5.0


def test_a_stop_ends_waiting_for_silent_arms() -> None:
    b = bench("hold")
    b.cell.now, b.cell.frozen_since = 5.0, 4.0
    b.cell.at(5.2, lambda: b.ports.stop.trigger("button"))
    failure = b.run("hold").failure
    assert failure is not None and failure.kind is K.STOPPED and b.cell.now == pytest.approx(5.2)


@pytest.mark.parametrize("kind", [kind for kind in KINDS if kind != "trajectory"])
def test_a_motion_without_a_path_defers_a_pause(kind: str) -> None:
    """The command stays in the queue until a motion or a state takes it."""
    b, commands = bench(kind), CommandQueue()
    b.cell.at(AT, lambda: commands.put(Event.PAUSE))
    b.run(kind, commands)
    assert commands.take(frozenset({Event.PAUSE})) is Event.PAUSE
    assert np.diff([t for t, _ in b.cell.commands]) == pytest.approx(TICK_S)


# a paused motion


def rested(b: Bench, spoil: Callable[[], None], at: float = 1.4) -> Outcome[Any]:
    """A trajectory is paused at AT, and `spoil` is called at time `at` [s], while the arms rest."""
    commands = CommandQueue()
    b.cell.at(AT, lambda: commands.put(Event.PAUSE))
    b.cell.at(at, spoil)
    b.cell.at(at + 0.5, lambda: commands.put(Event.RESUME))
    return b.run("trajectory", commands)


def test_a_pause_slows_the_path_clock_to_zero_on_the_path() -> None:
    b = bench("trajectory")
    assert rested(b, lambda: None).ok
    q = np.array([q[0] for _, q in b.cell.commands])
    assert np.diff(q).min() >= -1e-12, "it never goes back"
    times = np.array([t for t, _ in b.cell.commands])
    assert np.ptp(q[(times > AT + 0.65) & (times < 1.9)]) == 0.0, "the arms rest 0.6 s after the pause command"
    assert b.cell.q == pytest.approx(0.3)


def test_a_stop_ends_a_pause_at_once() -> None:
    b = bench("trajectory")
    failure = rested(b, lambda: b.ports.stop.trigger("button")).failure
    assert failure is not None and failure.kind is K.STOPPED
    assert b.cell.now == pytest.approx(1.4, abs=2 * TICK_S)


@pytest.mark.parametrize("end", [Event.RESUME, Event.ABORT])
@pytest.mark.parametrize("at", [AT + 0.3, 1.4], ids=["coming to rest", "at rest"])
@pytest.mark.parametrize(
    ("spoil", "kind"),
    [
        (lambda b: setattr(b.cell, "frozen_since", b.cell.now), K.STALE_STATE),
        (lambda b: push_arms(b.cell), K.TRACKING_ERROR),
        (lambda b: spoil_tactile(b.cell), K.TACTILE_FAULT),
    ],
)
def test_a_failure_in_a_pause_waits_for_the_person(
    spoil: Callable[[Bench], None], kind: FailureKind, at: float, end: Event
) -> None:
    """A motion that failed is followed by others, for example by laying the cloth back. A person who has ordered a
    pause may be near the arms, so none of them begins before the person says so."""
    b, commands, told = bench("trajectory"), CommandQueue(), []
    b.cell.at(AT, lambda: commands.put(Event.PAUSE))
    b.cell.at(at, lambda: spoil(b))
    b.cell.at(5.0, lambda: commands.put(end))
    control = PathControl(commands, JOINTS, JOINTS, tell=told.append)
    failure = b.run("trajectory", control=control).failure
    assert failure is not None and failure.kind is (kind if end is Event.RESUME else K.ABORTED)
    assert b.cell.now == pytest.approx(5.0, abs=2 * TICK_S)
    assert sum("nothing moves until you resume" in line for line in told) == 1
    late = [q for t, q in b.cell.commands if t > at + 0.65]
    assert kind is K.TACTILE_FAULT or not late, "arms of unknown or wrong position get no set-points"
    assert not late or np.ptp(np.array(late), axis=0).max() == 0.0, "nothing moves"


def test_the_first_failure_is_reported() -> None:
    """The tactile cells fall silent. While the arms come to rest, their state is lost too."""
    b = bench("trajectory")
    b.cell.at(AT, lambda: spoil_tactile(b.cell))
    b.cell.at(AT + 0.1, lambda: setattr(b.cell, "frozen_since", b.cell.now))
    failure = b.run("trajectory").failure
    assert failure is not None and failure.kind is K.TACTILE_FAULT


# the interface between loop and motion


class Script:
    """A motion that stands still, rests when ordered to, and notes its feedback."""

    def __init__(self, begins: Array | None = None, ticks: int = 5) -> None:
        self.heard: list[Feedback] = []
        self.closed = False
        self._begins, self._ticks = begins, ticks

    def begin(self, start: JointState) -> Motion[str]:
        resting = False
        try:
            while len(self.heard) < self._ticks:
                fed = yield SetPoint(start.q, np.zeros(14), self._begins, 0.0, resting)
                self.heard.append(fed)
                resting = (resting or fed.order is Order.REST) and fed.order is not Order.GO
        finally:
            self.closed = True
        return Outcome("done")


def test_a_motion_receives_the_reading_after_each_set_point() -> None:
    b, script = bench("hold"), Script()
    assert b.loop.run(script.begin).value == "done"
    assert [fed.state.stamp for fed in script.heard] == pytest.approx(TICK_S * np.arange(1, 6))
    assert all(fed.fresh and not fed.late and fed.order is None for fed in script.heard)
    assert len(b.cell.commands) == 5


def test_each_order_reaches_the_motion_once() -> None:
    b, script, commands, said = bench("hold"), Script(ticks=9), CommandQueue(), []
    control = PathControl(commands, JOINTS, JOINTS, note=lambda name, _: said.append((name, len(script.heard))))
    b.cell.at(2 * TICK_S, lambda: commands.put(Event.PAUSE))
    b.cell.at(6 * TICK_S, lambda: commands.put(Event.RESUME))
    assert b.loop.run(script.begin, control).ok
    assert [fed.order for fed in script.heard] == [None] * 2 + [Order.REST] + [None] * 3 + [Order.GO] + [None] * 2
    assert said == [("paused", 3), ("resumed", 6)]
    assert control.waited_s == pytest.approx(4 * TICK_S)


@pytest.mark.parametrize("off", [0.03, -0.03])
def test_a_motion_that_starts_at_another_position_is_not_begun(off: float) -> None:
    b, script = bench("hold"), Script(begins=np.full(14, off))
    failure = b.loop.run(script.begin).failure
    assert failure is not None and failure.kind is K.START_MISMATCH
    assert b.cell.commands == [] and script.closed


def test_a_motion_that_the_loop_ends_is_closed() -> None:
    b, script = bench("hold"), Script()
    b.cell.at(2 * TICK_S, lambda: b.ports.stop.trigger("button"))
    assert b.loop.run(script.begin).failure is not None
    assert script.closed and len(script.heard) == 1


def test_a_motion_that_may_end_at_any_time_gets_no_stale_state() -> None:
    """A hand controller would close its gripper because of this state."""
    b, heard = bench("hold"), list[Feedback]()
    b.cell.at(2 * TICK_S, lambda: setattr(b.cell, "frozen_since", b.cell.now))

    def hands(start: JointState) -> Motion[str]:
        while len(heard) < 50:
            heard.append((yield SetPoint(start.q, np.zeros(14))))
        return Outcome("done")

    failure = b.loop.run(hands).failure
    assert failure is not None and failure.kind is K.STALE_STATE
    assert len(heard) > 5 and all(fed.fresh for fed in heard)


def test_a_motion_that_must_come_to_rest_learns_of_a_stale_state() -> None:
    b, script = bench("hold"), Script(ticks=50)
    b.cell.at(2 * TICK_S, lambda: setattr(b.cell, "frozen_since", b.cell.now))
    failure = b.loop.run(script.begin).failure
    assert failure is not None and failure.kind is K.STALE_STATE
    old, resting = script.heard[-2:]
    assert all(fed.fresh for fed in script.heard[:-2])
    assert not old.fresh and not resting.fresh and (old.order, resting.order) == (None, Order.REST)


def test_a_motion_may_end_before_its_first_set_point() -> None:
    b = bench("hold")
    assert b.loop.run(Script(ticks=0).begin).value == "done" and b.cell.commands == [] and b.cell.now == 0.0


def test_an_exception_in_a_motion_propagates() -> None:
    """An error of the driver or a bug is not turned into a failure of the motion."""
    b = bench("hold")

    def broken(start: JointState) -> Motion[str]:
        yield SetPoint(start.q, np.zeros(14))
        raise ZeroDivisionError("a bug")

    with pytest.raises(ZeroDivisionError):
        b.loop.run(broken)


def test_the_driver_is_called_in_the_same_order_on_every_tick() -> None:
    """The order is command, tick, stop, state. Replay compares transcripts by this order."""
    b, asked = bench("hold"), list[str]()

    def noting(part: Any, name: str, *methods: str) -> Any:
        def noted(method: str) -> Callable[..., Any]:
            return lambda *given: (asked.append(f"{name}.{method}"), getattr(part, method)(*given))[1]

        return SimpleNamespace(**{method: noted(method) for method in methods})

    ports = replace(
        b.ports,
        arms=noting(b.ports.arms, "arms", "command", "state"),
        stop=noting(b.ports.stop, "stop", "state", "trigger"),
    )
    assert ControlLoop(ports, LIMITS, LastCommand()).run(Script(ticks=2).begin).ok
    assert asked == ["arms.state", "stop.state"] + 2 * ["arms.command", "stop.state", "arms.state"]
