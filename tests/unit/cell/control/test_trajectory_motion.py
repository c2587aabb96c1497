"""Streaming a motion: the arms get the planned set-points, and every fault ends in a typed failure."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from foldcell.cell.control.checks import SETTLE_S, come_to_rest, hold
from foldcell.cell.control.loop import ControlLoop
from foldcell.cell.control.motion import Tick
from foldcell.cell.control.motions.hold_position import wait
from foldcell.cell.control.motions.trajectory import OFF_PATH, stream
from foldcell.cell.control.path_clock import PathControl
from foldcell.cell.control.set_points import LastCommand
from foldcell.cell.control.ticks import TICK_S
from foldcell.cell.states.commands import CommandQueue
from foldcell.cell.states.transition_table import Event
from foldcell.robots.errors import Failure, FailureKind
from foldcell.robots.model import JointLimits
from foldcell.robots.ports import ArmTrajectory, JointSetpoint, Ports
from tests.builders.shipped_settings import LIMITS
from tests.fakes import FakeCell

ONE = np.ones(14)
PLANNING = JointLimits(-3.0 * ONE, 3.0 * ONE, 1.2 * ONE, 3.0 * ONE, 30.0 * ONE)
PROTECTIVE = JointLimits(-3.0 * ONE, 3.0 * ONE, 1.5 * ONE, 6.0 * ONE, 120.0 * ONE)


def loop(ports: Ports, last_command: LastCommand | None = None) -> ControlLoop:
    return ControlLoop(ports, LIMITS, last_command or LastCommand())


def control(commands: CommandQueue | None = None) -> PathControl:
    return PathControl(commands, PROTECTIVE, PLANNING)


def derivatives(cell: FakeCell) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Commanded position of joint 0, and its first and second differences over time."""
    q = np.array([q[0] for _, q in cell.commands])
    return q, np.diff(q) / TICK_S, np.diff(q, 2) / TICK_S**2


def ramp(distance: float = 0.5, duration: float = 1.0) -> ArmTrajectory:
    """A minimum-jerk motion of all joints."""
    t = np.linspace(0.0, duration, 101)
    s = t / duration
    shape = s**3 * (10 - 15 * s + 6 * s**2)
    speed = 30 * s**2 * (1 - s) ** 2 / duration
    one = np.ones(14) * distance
    return ArmTrajectory(t, np.outer(shape, one), np.outer(speed, one), np.zeros((101, 14)))


def test_the_arms_receive_every_set_point_and_arrive() -> None:
    cell = FakeCell()
    outcome = stream(loop(cell.ports()), ramp(), None, control())
    assert outcome.ok
    np.testing.assert_allclose(cell.q, 0.5)
    times = np.diff([t for t, _ in cell.commands])
    np.testing.assert_allclose(times, TICK_S, atol=1e-9)
    last_command = np.array([q[0] for _, q in cell.commands])
    np.testing.assert_allclose(last_command, [ramp().at(t)[0][0] for t, _ in cell.commands], atol=1e-12)


def test_the_interpolant_is_the_closed_form() -> None:
    """Between its samples the trajectory follows the minimum-jerk polynomial from which it was sampled."""
    for t in np.linspace(0.0, 1.0, 333):
        q, qd = ramp().at(float(t))
        assert q[0] == pytest.approx(0.5 * t**3 * (10 - 15 * t + 6 * t**2), abs=1e-6)
        assert qd[0] == pytest.approx(0.5 * 30 * t**2 * (1 - t) ** 2, abs=1e-3)


def hang(cell: FakeCell) -> None:
    """The arms stand still whatever they are told. Their encoders are read as usual."""
    cell.follows, cell.same_positions = False, False


@pytest.mark.parametrize(
    ("spoil", "kind"),
    [
        (lambda c: setattr(c, "stop_reason", "button"), FailureKind.STOPPED),
        (lambda c: setattr(c, "frozen_since", c.now), FailureKind.STALE_STATE),
        (hang, FailureKind.TRACKING_ERROR),
    ],
)
def test_a_fault_during_a_motion_is_reported_by_its_kind(spoil, kind) -> None:
    cell = FakeCell()
    cell.at(0.3, lambda: spoil(cell))
    outcome = stream(loop(cell.ports()), ramp(duration=2.0), None, control())
    assert outcome.failure is not None
    assert outcome.failure.kind is kind
    assert cell.now < 1.2, "the motion ends before its last set-point"


def test_nothing_is_sent_after_a_stop() -> None:
    """The fake raises an error on a set-point to a stopped robot, so the stream must detect the stop within a
    tick."""
    cell = FakeCell()
    cell.at(0.5, lambda: setattr(cell, "stop_reason", "button"))
    assert stream(loop(cell.ports()), ramp(), None, control()).failure is not None
    assert max(t for t, _ in cell.commands) < 0.5 + 1e-9


@pytest.mark.parametrize("off", [2.0, -2.0])
def test_a_start_two_degrees_off_is_refused_before_anything_is_sent(off: float) -> None:
    q = np.zeros(14)
    q[3] = np.deg2rad(off)
    cell = FakeCell(q)
    failure = stream(loop(cell.ports()), ramp(), None, control()).failure
    assert failure is not None
    assert failure.kind is FailureKind.START_MISMATCH
    assert failure.values["joint"] == 3
    assert not cell.commands


@pytest.mark.parametrize("spoil", [lambda c: setattr(c, "frozen_since", 4.0), lambda c: c.q.fill(np.nan)])
def test_arms_without_a_valid_state_are_not_moved(spoil) -> None:
    """The arms' state is stale or not finite, so the start of a motion is unknown."""
    cell = FakeCell()
    cell.now = 5.0
    spoil(cell)
    failure = stream(loop(cell.ports()), ramp(), None, control()).failure
    assert failure is not None and failure.kind is FailureKind.STALE_STATE
    hold(cell.ports(), LIMITS)
    assert wait(loop(cell.ports(), LastCommand(np.zeros(14))), 0.3) is None
    assert not cell.commands, "the arms get no command to hold and no repetition of an earlier command"


def test_a_state_that_is_not_a_number_ends_a_motion() -> None:
    cell = FakeCell()
    cell.at(0.3, lambda: setattr(cell, "follows", False))
    cell.at(0.3, lambda: cell.q.fill(np.nan))
    failure = stream(loop(cell.ports()), ramp(duration=2.0), None, control()).failure
    assert failure is not None and failure.kind is FailureKind.STALE_STATE and cell.now < 1.0


@pytest.mark.parametrize(("sag", "seconds"), [(0.005, 1.0), (0.02, 1.0 + SETTLE_S)])
def test_a_motion_ends_when_the_arms_have_arrived_or_have_come_to_rest(sag: float, seconds: float) -> None:
    """Arms that sag a little below their last set-point have arrived as far as possible."""
    cell = FakeCell()
    cell.at(0.9, lambda: setattr(cell, "follows", False))
    cell.at(0.95, lambda: setattr(cell, "q", np.full(14, 0.5 - sag)))
    outcome = stream(loop(cell.ports()), ramp(), None, control())
    assert outcome.ok and cell.now == pytest.approx(seconds, abs=3 * TICK_S)
    np.testing.assert_allclose(cell.commands[-1][1], 0.5)


def test_arms_with_a_state_of_the_maximum_age_are_commanded_to_hold() -> None:
    cell = FakeCell()
    cell.now, cell.frozen_since = 5.0, 4.85
    hold(cell.ports(), LIMITS)
    assert not cell.commands
    hold(cell.ports(), replace(LIMITS, stale_s=0.3))
    assert len(cell.commands) == 1


def test_waiting_keeps_the_arms_commanded() -> None:
    """The driver holds the arms after 0.2 s without a command. A wait must not rely on this."""
    cell = FakeCell()
    assert wait(loop(cell.ports()), 0.5) is None
    assert np.diff([t for t, _ in cell.commands]).max() < 0.2


def test_a_wait_ends_with_a_watched_failure() -> None:
    cell, times = FakeCell(), []
    slipped = Failure(FailureKind.SLIPPED, "gone")

    def watch(tick: Tick) -> Failure | None:
        times.append(tick.t)
        return slipped if cell.now >= 0.3 else None

    assert wait(loop(cell.ports()), 0.5, watch) is slipped
    assert cell.now == pytest.approx(0.3) and times == pytest.approx(np.arange(1, 31) * TICK_S)


# --- on the path: pause, resume, early end --------------------------------------------------------------


def paused(pause: float, resume: float) -> tuple[FakeCell, object, PathControl]:
    cell, commands = FakeCell(), CommandQueue()
    cell.at(pause, lambda: commands.put(Event.PAUSE))
    cell.at(resume, lambda: commands.put(Event.RESUME))
    held = control(commands)
    return cell, stream(loop(cell.ports()), ramp(duration=1.5), None, held), held


def test_an_unused_control_changes_no_set_point() -> None:
    plain, controlled = FakeCell(), FakeCell()
    stream(loop(plain.ports()), ramp(), None, control())
    stream(loop(controlled.ports()), ramp(), None, control(CommandQueue()))
    assert len(plain.commands) == len(controlled.commands)
    assert all(np.array_equal(a[1], b[1]) for a, b in zip(plain.commands, controlled.commands, strict=True))


@pytest.mark.parametrize("pause", [0.05, 0.4, 0.75, 1.1])
def test_a_pause_rests_within_600_ms_and_resumes_where_it_stopped(pause: float) -> None:
    cell, outcome, held = paused(pause, pause + 1.0)
    assert outcome.ok
    assert cell.q == pytest.approx(0.5)
    q, v, a = derivatives(cell)
    resting = np.flatnonzero((np.abs(v) < 1e-9) & (q[1:] > 1e-6) & (q[1:] < 0.5 - 1e-6))
    assert resting[0] * TICK_S <= pause + 0.6 + 2 * TICK_S
    assert held.waited_s == pytest.approx(0.4, abs=0.05), "only the time at rest counts as waiting"
    assert np.diff(q).min() > -1e-12, "the motion never goes backwards"
    assert np.abs(v).max() <= PLANNING.velocity[0]
    assert np.abs(a).max() <= PROTECTIVE.acceleration[0]
    assert np.abs(np.diff(a)).max() / TICK_S <= PROTECTIVE.jerk[0]


def test_a_pause_during_a_restart_is_smooth() -> None:
    cell, commands = FakeCell(), CommandQueue()
    for t, said in ((0.5, Event.PAUSE), (1.5, Event.RESUME), (1.7, Event.PAUSE), (3.0, Event.RESUME)):
        cell.at(t, lambda said=said: commands.put(said))
    assert stream(loop(cell.ports()), ramp(duration=1.5), None, control(commands)).ok
    q, v, a = derivatives(cell)
    assert cell.q == pytest.approx(0.5) and np.diff(q).min() > -1e-12
    assert np.abs(a).max() <= PROTECTIVE.acceleration[0]
    assert np.abs(v[240:300]).max() < 1e-9, "the arms rest 0.6 s after the second pause"


@pytest.mark.parametrize("off", [2.0, -2.0])
def test_arms_moved_during_a_pause_do_not_continue(off: float) -> None:
    cell, commands = FakeCell(), CommandQueue()
    cell.at(0.5, lambda: commands.put(Event.PAUSE))
    cell.at(1.5, lambda: setattr(cell, "follows", False))
    cell.at(1.5, lambda: setattr(cell, "q", cell.q + np.deg2rad(off)))
    cell.at(1.6, lambda: commands.put(Event.RESUME))
    failure = stream(loop(cell.ports()), ramp(), None, control(commands)).failure
    assert failure is not None and failure.kind is FailureKind.START_MISMATCH


@pytest.mark.parametrize("pause", [None, 0.5])
def test_commanded_velocities_are_the_derivative_of_the_set_points(
    pause: float | None, monkeypatch: pytest.MonkeyPatch
) -> None:
    """This also holds while the path clock slows down and speeds up. A robot that uses them as feed-forward would
    jump otherwise."""
    cell, commands, told = FakeCell(), CommandQueue(), []
    if pause is not None:
        cell.at(pause, lambda: commands.put(Event.PAUSE))
        cell.at(pause + 0.8, lambda: commands.put(Event.RESUME))
    ports = cell.ports()
    command = ports.arms.command
    monkeypatch.setattr(ports.arms, "command", lambda q, qd: (told.append(qd[0]), command(q, qd))[1])
    assert stream(loop(ports), ramp(duration=1.5), None, control(commands)).ok
    q = derivatives(cell)[0]
    assert told[1:-1] == pytest.approx((q[2:] - q[:-2]) / (2 * TICK_S), abs=0.01)
    assert max(told) > 0.5


def test_a_pause_is_recorded_with_its_times() -> None:
    cell, commands, kept = FakeCell(), CommandQueue(), []
    held = control(commands)
    held.note = lambda name, values: kept.append((name, cell.now, dict(values), abs(derivatives(cell)[1][-1])))
    cell.at(0.5, lambda: commands.put(Event.PAUSE))
    cell.at(1.5, lambda: commands.put(Event.RESUME))
    assert stream(loop(cell.ports()), ramp(duration=1.5), None, held).ok
    (paused, rested, told, speed), (resumed, went_on, from_there, still) = kept
    assert (paused, resumed) == ("paused", "resumed")
    assert speed < 2e-3 and still < 1e-9, (
        "a pause is recorded in its last tick before rest, a resume in its first tick after rest"
    )
    assert told["asked_s"] == pytest.approx(0.5, abs=2 * TICK_S) and 1.0 <= rested <= 1.2
    assert went_on == pytest.approx(1.5, abs=2 * TICK_S) and from_there["path_s"] == told["path_s"]


def test_a_resume_before_the_pause_does_not_end_it() -> None:
    cell, commands = FakeCell(), CommandQueue()
    for t, said in ((0.2, Event.RESUME), (0.3, Event.PAUSE), (2.5, Event.RESUME)):
        cell.at(t, lambda said=said: commands.put(said))
    assert stream(loop(cell.ports()), ramp(), None, control(commands)).ok
    assert cell.now > 2.5


@pytest.mark.parametrize("act", [lambda ports: hold(ports, LIMITS), lambda ports: wait(loop(ports), 0.3)])
def test_arms_without_a_recent_state_get_no_command(act) -> None:
    cell = FakeCell()
    cell.now, cell.frozen_since = 5.0, 4.0
    act(cell.ports())
    assert not cell.commands


@pytest.mark.parametrize("rested", [False, True])
def test_an_abort_brings_the_motion_to_rest_on_its_path(rested: bool) -> None:
    cell, commands = FakeCell(), CommandQueue()
    if rested:
        cell.at(0.3, lambda: commands.put(Event.PAUSE))
    cell.at(1.0 if rested else 0.3, lambda: commands.put(Event.ABORT))
    failure = stream(loop(cell.ports()), ramp(), None, control(commands)).failure
    assert failure is not None and failure.kind is FailureKind.ABORTED
    q, v, a = derivatives(cell)
    assert 0.0 < q[-1] < 0.5 and abs(v[-1]) < 0.02
    assert np.abs(a).max() <= PROTECTIVE.acceleration[0]


def test_a_watched_failure_ends_softly_on_the_path() -> None:
    cell = FakeCell()
    slipped = Failure(FailureKind.SLIPPED, "gone")
    outcome = stream(loop(cell.ports()), ramp(), lambda tick: slipped if tick.t >= 0.4 else None, control())
    assert outcome.failure is slipped
    assert cell.now == pytest.approx(1.0, abs=0.03)
    _, v, a = derivatives(cell)
    assert abs(v[-1]) < 0.02 and np.abs(a).max() <= PROTECTIVE.acceleration[0]


def test_arms_with_a_stale_state_are_not_commanded_to_it() -> None:
    """A hold at a state that is 0.1 s old would pull the arms back by the distance moved since."""
    cell = FakeCell()
    cell.at(0.5, lambda: setattr(cell, "frozen_since", cell.now))
    failure = stream(loop(cell.ports()), ramp(), None, control()).failure
    assert failure is not None and failure.kind is FailureKind.STALE_STATE
    q, _, a = derivatives(cell)
    assert np.diff(q).min() > -1e-12 and np.abs(a).max() <= PROTECTIVE.acceleration[0]


def test_a_stop_in_a_pause_ends_it() -> None:
    cell, commands = FakeCell(), CommandQueue()
    cell.at(0.3, lambda: commands.put(Event.PAUSE))
    cell.at(1.3, lambda: setattr(cell, "stop_reason", "button"))
    failure = stream(loop(cell.ports()), ramp(), None, control(commands)).failure
    assert failure is not None and failure.kind is FailureKind.STOPPED


def test_altered_set_points_are_detected() -> None:
    cell = FakeCell()
    ports = cell.ports()
    told = ports.arms.command

    def clipped(q: np.ndarray, qd: np.ndarray) -> JointSetpoint:
        last_command = told(np.minimum(q, 0.3), qd)
        return JointSetpoint(last_command.stamp, np.minimum(q, 0.3), qd, bool(np.any(q > 0.3)))

    ports.arms.command = clipped  # type: ignore[method-assign]
    failure = stream(loop(ports), ramp(), None, control()).failure
    assert failure is not None and failure.kind is FailureKind.LIMIT_EXCEEDED
    assert failure.values["clipped"] and np.abs(cell.q).max() < 0.31


# arms away from their set-point


def displaced(lasts: float, place: float = 0.0, off: float = 3.0) -> FakeCell:
    """A cell whose joints are `off` degrees away from `place` [rad] for `lasts` seconds."""
    cell = FakeCell(q=np.full(14, place + np.deg2rad(off)))
    cell.at(lasts, lambda: cell.q.fill(place))
    return cell


@pytest.mark.parametrize("place", [0.0, 0.4])
@pytest.mark.parametrize("off", [3.0, -3.0])
def test_dropped_arms_get_time_to_recover(place: float, off: float) -> None:
    """A motion planned while the arms are dropped would begin with a jump once they have recovered."""
    cell = displaced(0.4, place, off)
    assert come_to_rest(cell.ports(), LIMITS, LastCommand(np.full(14, place))) is None
    assert cell.now == pytest.approx(0.4, abs=2 * TICK_S)
    assert cell.commands == [], "the arms are already commanded to this position"


def test_waiting_for_dropped_arms_has_a_time_limit() -> None:
    cell = displaced(1e9)
    assert come_to_rest(cell.ports(), LIMITS, LastCommand(np.zeros(14))) is None
    assert cell.now == pytest.approx(SETTLE_S, abs=2 * TICK_S)


@pytest.mark.parametrize(
    ("spoil", "kind"),
    [
        (lambda c: c.ports().stop.trigger("button"), FailureKind.STOPPED),
        (lambda c: setattr(c, "frozen_since", c.now), FailureKind.STALE_STATE),
    ],
)
def test_a_stop_or_silence_ends_the_wait(spoil, kind: FailureKind) -> None:
    cell = displaced(1e9)
    cell.at(0.3, lambda: spoil(cell))
    failure = come_to_rest(cell.ports(), LIMITS, LastCommand(np.zeros(14)))
    assert failure is not None and failure.kind is kind and cell.now < 0.5


def test_arms_without_a_previous_command_are_not_waited_for() -> None:
    cell = displaced(1e9)
    assert come_to_rest(cell.ports(), LIMITS, LastCommand()) is None and cell.now == 0.0


def stalling(cell: FakeCell, at: float) -> tuple[Ports, list[float]]:
    """Ports whose program stalls for 0.15 s at given times, and the list of stalls still to come."""
    ports, stalls = cell.ports(), [at]

    class Stalling:
        def now(self) -> float:
            return ports.clock.now()

        def sleep_until(self, t: float) -> None:
            late = stalls and t > stalls[0]
            ports.clock.sleep_until(t + (0.15 if late else 0.0))
            if late:
                stalls.pop()

    return replace(ports, clock=Stalling()), stalls


@pytest.mark.parametrize("at", [0.6, 0.9, 1.3])
def test_a_stall_does_not_end_a_pause(at: float) -> None:
    """A stall occurs while the arms come to rest or are at rest. Only a resume lets the arms continue."""
    cell, commands = FakeCell(), CommandQueue()
    cell.at(0.5, lambda: commands.put(Event.PAUSE))
    cell.at(1.8, lambda: commands.put(Event.RESUME))
    ports, stalls = stalling(cell, at)
    assert stream(loop(ports), ramp(duration=1.5), None, control(commands)).ok and not stalls
    rest = [q[0] for t, q in cell.commands if 1.4 < t < 1.8]
    assert len(rest) > 20 and np.ptp(rest) == 0.0 and 0.05 < rest[0] < 0.45


@pytest.mark.parametrize("at", [0.1, 0.5, 0.9])
def test_after_a_stall_a_motion_starts_from_rest(at: float) -> None:
    """The arms come to rest during the stall, so continuing at the path's speed would be a jump."""
    cell = FakeCell()
    ports, stalls = stalling(cell, at)
    outcome = stream(loop(ports), ramp(), None, control())
    assert outcome.ok and cell.q == pytest.approx(0.5) and not stalls
    q = np.array([q[0] for _, q in cell.commands])
    gap = int(np.argmax(np.diff([t for t, _ in cell.commands]) > 0.1)) + 1
    assert 0 < gap < len(q) - 10
    after = np.diff(q[gap - 1 :]) / TICK_S
    assert abs(after[0]) < 0.05, "the restart is as slow as after a pause"
    assert np.abs(np.diff(after)).max() / TICK_S <= PROTECTIVE.acceleration[0]
    assert np.diff(q).min() > -1e-12 and np.abs(after).max() <= PLANNING.velocity[0]


class Coasting:
    """A clock whose program stalls once while the arms go on along the path, or beside it, and come to rest."""

    def __init__(
        self, cell: FakeCell, at: float, path: ArmTrajectory, ahead_s: float, beside: float = 0.0
    ) -> None:
        self._cell, self._at, self._path = cell, at, path
        self._ahead_s, self._beside = ahead_s, beside

    def now(self) -> float:
        return self._cell.now

    def sleep_until(self, t: float) -> None:
        clock = self._cell.ports().clock
        if t <= self._at:
            clock.sleep_until(t)
            return
        self._at = np.inf
        q, _ = self._path.at(self._cell.now + self._ahead_s)
        self._cell.q = q + self._beside * np.r_[1.0, np.zeros(13)]
        clock.sleep_until(t + 0.4)


@pytest.mark.parametrize("ahead_s", [0.10, -0.05, 0.0])
@pytest.mark.parametrize("at", [0.2, 0.5, 0.8])
def test_after_a_stall_the_path_continues_from_where_the_arms_stand(at: float, ahead_s: float) -> None:
    """Without set-points the arms go on until the command timeout and then brake, up to 0.1 rad further on."""
    cell = FakeCell()
    ports = replace(cell.ports(), clock=Coasting(cell, at, ramp(), ahead_s))
    outcome = stream(loop(ports), ramp(), None, control())
    assert outcome.ok and cell.q == pytest.approx(0.5)
    times, q = np.array([t for t, _ in cell.commands]), np.array([q[0] for _, q in cell.commands])
    k = int(np.argmax(np.diff(times) > 0.1)) + 1
    stood = ramp().at(times[k - 1] + ahead_s)[0][0]
    assert q[k] == pytest.approx(stood, abs=1e-6), "the first set-point is where the arms stand"
    after = np.diff(q[k:]) / TICK_S
    assert after.min() > -1e-9 and after[0] < 0.05, "from there the arms only move on, from rest"
    assert np.abs(np.diff(after)).max() / TICK_S <= PROTECTIVE.acceleration[0]


def test_arms_that_do_not_stand_on_the_path_after_a_stall_get_no_further_set_point() -> None:
    """Somebody pushed an arm in the meantime: the checked path says nothing about its surroundings."""
    cell = FakeCell()
    ports = replace(cell.ports(), clock=Coasting(cell, 0.5, ramp(), 0.0, beside=0.1))
    failure = stream(loop(ports), ramp(), None, control()).failure
    assert failure is not None and failure.kind is FailureKind.START_MISMATCH
    assert failure.values["off_rad"] > OFF_PATH
    assert max(t for t, _ in cell.commands) < 0.55


def test_no_set_point_follows_a_stall_after_which_the_state_is_unknown() -> None:
    cell = FakeCell()
    ports = replace(cell.ports(), clock=Coasting(cell, 0.5, ramp(), 0.1))
    cell.at(0.45, lambda: setattr(cell, "frozen_since", cell.now))
    failure = stream(loop(ports), ramp(), None, control()).failure
    assert failure is not None and failure.kind is FailureKind.STALE_STATE
    assert max(t for t, _ in cell.commands) < 0.55


def test_a_stall_while_a_pause_brings_the_arms_to_rest_leaves_them_where_they_stand() -> None:
    cell, commands = FakeCell(), CommandQueue()
    cell.at(0.4, lambda: commands.put(Event.PAUSE))
    cell.at(2.0, lambda: commands.put(Event.RESUME))
    ports = replace(cell.ports(), clock=Coasting(cell, 0.5, ramp(), 0.08))
    assert stream(loop(ports), ramp(), None, control(commands)).ok and cell.q == pytest.approx(0.5)
    rest = np.array([q[0] for t, q in cell.commands if 0.6 < t < 2.0])
    assert len(rest) > 20 and np.ptp(rest) < 1e-3
