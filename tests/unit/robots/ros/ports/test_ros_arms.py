"""The arms' driver: joint states in, joint commands out."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from puppet import ENABLE, JOINTS, LIMB, NAMES, STATE, STOP, Connect, HandClock, Puppet, wait

from foldcell.robots.baxter.names import JOINT_NAMES
from foldcell.robots.baxter.ros.messages import POSITION, RAW_POSITION
from foldcell.robots.baxter.ros.ports import arms as arms_module
from foldcell.robots.baxter.ros.ports.arms import RosArms
from foldcell.robots.baxter.ros.ports.stop import RosStop
from foldcell.robots.errors import DriverError, FailureKind
from foldcell.robots.model import JointLimits
from foldcell.robots.ports import Array, Ports, Side, arm_slice
from foldcell.robots.ros.node import Node
from foldcell.robots.setpoint import JUMP_TIME

pytestmark = pytest.mark.filterwarnings("ignore:notifyAll")  # a warning of rospy
ZERO = np.zeros(14)


class Arms:
    """The arms of an enabled robot, with a clock that a test sets."""

    def __init__(self, puppet: Puppet, node: Node, limits: JointLimits, raw: bool) -> None:
        self.puppet, self.clock = puppet, HandClock()
        puppet.enabled = True
        self.stop = RosStop(node, self.clock)
        self.port = RosArms(node, self.clock, self.stop, limits, raw)
        names = ("joint_command", "inverse_dynamics_command")
        self._topics = [LIMB[s] + name for s in Side for name in names]
        self._told = [LIMB[s] + name for s in Side for name in names[: 1 + raw]]
        wait(lambda: all(puppet.hears(topic) for topic in self._topics), "somebody commands")
        self.pass_time(0.0)

    def pass_time(self, seconds: float) -> None:
        """Advance the clock and wait for the robot's next messages."""
        self.clock.time += seconds
        wait(lambda: self.port.state().stamp == self.clock.time, "joint states")
        wait(lambda: self.stop.robot.newest and self.stop.robot.newest.stamp == self.clock.time, "its state")

    def heard(self, side: Side, name: str = "joint_command") -> list:
        return self.puppet.heard[LIMB[side] + name]

    def dynamics(self) -> int:
        """Number of messages that each arm has received; 0 while the numbers differ."""
        heard = {len(self.heard(side, "inverse_dynamics_command")) for side in Side}
        return heard.pop() if len(heard) == 1 else 0

    def command(self, q: Array, qd: Array = ZERO):
        """Send a command and wait until the robot has received it. Returns the set-point."""
        before = [len(self.puppet.heard[topic]) for topic in self._told]
        sent = self.port.command(q, qd)
        wait(
            lambda: [len(self.puppet.heard[topic]) for topic in self._told] == [n + 1 for n in before],
            "one command for each arm",
        )
        return sent


@pytest.fixture
def make(puppet: Puppet, node: Node, limits: JointLimits):
    made: list[Arms] = []

    def begin(raw: bool = False) -> Arms:
        made.append(Arms(puppet, node, limits, raw))
        return made[-1]

    yield begin
    for arms in made:
        arms.stop.close()


@pytest.fixture
def arms(make: Callable[..., Arms]) -> Arms:
    return make()


def refused(arms: RosArms, q: Array, qd: Array = ZERO) -> FailureKind:
    with pytest.raises(DriverError) as caught:
        arms.command(q, qd)
    return caught.value.kind


# joint states ------------------------------------------------------------------------------------------


def test_the_joint_state_is_read_by_joint_name(puppet: Puppet, ports: Ports) -> None:
    assert NAMES[2:16] != list(JOINT_NAMES)
    for _ in range(20):  # messages of other joints arrive too
        state = ports.arms.state()
        np.testing.assert_array_equal(state.q, puppet.q)
        np.testing.assert_array_equal(state.qd, puppet.qd)
        np.testing.assert_array_equal(state.effort, puppet.effort)
        assert state.head_pan == 0.125
        puppet.let(1)


def test_a_message_without_a_joint_or_a_value_is_ignored(puppet: Puppet, arms: Arms) -> None:
    before = puppet.q.copy()
    puppet.hush(JOINTS)
    arms.clock.time += 1.0
    puppet.q = before + 1.0
    lacking = puppet.joints()
    lacking.name[5] = "somebody_else"
    short = puppet.joints()
    short.velocity = short.velocity[:-1]
    for message in (lacking, short):
        puppet._publishers[JOINTS].publish(message)
    puppet.let(10)
    np.testing.assert_array_equal(arms.port.state().q, before)
    assert arms.port.state().stamp == arms.clock.now() - 1.0
    puppet._publishers[JOINTS].publish(puppet.joints())
    wait(lambda: np.array_equal(arms.port.state().q, puppet.q), "a whole message")


def spoiled(message: Any, field: str, name: str, wrong: float) -> Any:
    values = list(getattr(message, field))
    values[message.name.index(name)] = wrong
    setattr(message, field, values)
    return message


@pytest.mark.parametrize("wrong", [np.nan, np.inf])
def test_a_message_with_values_that_are_not_finite_is_ignored(puppet: Puppet, arms: Arms, wrong: float) -> None:
    puppet.hush(JOINTS)
    before = arms.port.state()
    arms.clock.time += 1.0
    places = [("position", "left_s0"), ("velocity", "right_w2"), ("effort", "left_e1"), ("position", "head_pan")]
    for field, name in places:
        puppet._publishers[JOINTS].publish(spoiled(puppet.joints(), field, name, wrong))
        puppet.let(5)
    assert arms.port.state() is before
    for field in ("position", "velocity", "effort"):  # a joint that the driver does not use
        puppet._publishers[JOINTS].publish(spoiled(puppet.joints(), field, "torso_t0", wrong))
        wait(lambda: arms.port.state().stamp == arms.clock.now(), "it is heard")
        arms.clock.time += 1.0


def test_the_stamp_of_a_state_is_its_time_of_arrival(puppet: Puppet, arms: Arms) -> None:
    arms.pass_time(0.5)
    assert arms.port.state().stamp == arms.clock.now() == 100.5
    puppet.hush(JOINTS)
    arms.clock.time += 3.0
    puppet.let(5)
    assert arms.port.state().stamp == 100.5


def test_the_state_before_the_first_message_has_no_valid_time(
    puppet: Puppet, node: Node, limits: JointLimits
) -> None:
    puppet.hush(JOINTS)
    clock = HandClock()
    stop = RosStop(node, clock)
    try:
        state = RosArms(node, clock, stop, limits).state()
    finally:
        stop.close()
    assert state.stamp == -np.inf and np.isnan(state.q).all() and state.q.shape == (14,)


# enabling ----------------------------------------------------------------------------------------------


def test_enabling_is_repeated_until_the_robot_agrees(puppet: Puppet, ports: Ports, monkeypatch) -> None:
    monkeypatch.setattr(arms_module, "ENABLE_S", 60.0)
    puppet.deaf.add(ENABLE)
    heard = puppet.heard[ENABLE]

    def relent() -> tuple:
        if len(heard) >= 4:
            puppet.deaf.discard(ENABLE)
        return ()

    puppet.film = relent
    ports.arms.enable()
    assert puppet.enabled and len(heard) >= 5 and all(message.data for message in heard)
    puppet.stays(lambda: len(heard))


def test_a_robot_that_does_not_enable_is_a_driver_error(puppet: Puppet, ports: Ports, monkeypatch) -> None:
    monkeypatch.setattr(arms_module, "ENABLE_S", 0.5)
    puppet.deaf.add(ENABLE)
    with pytest.raises(DriverError, match="motors") as caught:
        ports.arms.enable()
    assert caught.value.kind is FailureKind.HARDWARE_FAULT


def test_an_old_state_of_a_silent_robot_does_not_enable_it(puppet: Puppet, ports: Ports, monkeypatch) -> None:
    monkeypatch.setattr(arms_module, "ENABLE_S", 0.5)
    ports.arms.enable()
    puppet.hush(STATE)
    with pytest.raises(DriverError) as caught:
        ports.arms.enable()
    assert caught.value.kind is FailureKind.HARDWARE_FAULT


def test_a_stopped_robot_is_not_enabled(puppet: Puppet, ports: Ports) -> None:
    ports.stop.trigger("a test")
    with pytest.raises(DriverError, match="a test") as caught:
        ports.arms.enable()
    assert caught.value.kind is FailureKind.STOPPED
    puppet.let(10)
    assert puppet.heard[ENABLE] == []


def test_a_stop_ends_enabling(puppet: Puppet, ports: Ports, monkeypatch) -> None:
    monkeypatch.setattr(arms_module, "ENABLE_S", 60.0)
    puppet.deaf.add(ENABLE)

    def press() -> tuple:
        if puppet.heard[ENABLE]:
            puppet.stopped, puppet.button, puppet.source = True, 1, 1
        return ()

    puppet.film = press
    with pytest.raises(DriverError, match="button") as caught:
        ports.arms.enable()
    assert caught.value.kind is FailureKind.STOPPED


# commanding --------------------------------------------------------------------------------------------


def test_both_arms_are_commanded_by_name(puppet: Puppet, arms: Arms) -> None:
    q = puppet.q + 0.01
    sent = arms.command(q, np.full(14, 0.1))
    for side in Side:
        message = arms.heard(side)[-1]
        assert message.mode == POSITION == 1
        assert list(message.names) == [f"{side}_{joint}" for joint in ("s0", "s1", "e0", "e1", "w0", "w1", "w2")]
        np.testing.assert_array_equal(message.command, q[arm_slice(side, 14)])
        assert arms.heard(side, "inverse_dynamics_command") == []
    np.testing.assert_array_equal(sent.q, q)
    np.testing.assert_array_equal(sent.qd, np.full(14, 0.1))
    assert not sent.clipped and sent.stamp == arms.clock.now()


def test_the_robot_receives_the_returned_set_point(puppet: Puppet, arms: Arms, limits: JointLimits) -> None:
    rng = np.random.default_rng(5)
    clipped = 0
    for _ in range(30):
        arms.pass_time(0.01)
        sent = arms.command(arms.port.state().q + rng.normal(0.0, 0.03, 14), rng.normal(0.0, 1.0, 14))
        heard = np.concatenate([arms.heard(side)[-1].command for side in Side])
        np.testing.assert_array_equal(heard, sent.q)
        assert np.all((sent.q >= limits.lower) & (sent.q <= limits.upper))
        clipped += sent.clipped
    assert clipped > 0


def test_set_points_keep_the_joint_velocity_limits(puppet: Puppet, arms: Arms, limits: JointLimits) -> None:
    puppet.deaf = {LIMB[side] + "joint_command" for side in Side}
    reach = limits.velocity * JUMP_TIME
    stood = puppet.q.copy()
    for k in range(1, 4):
        sent = arms.command(stood + 5.0)
        np.testing.assert_allclose(sent.q, np.minimum(stood + k * reach, limits.upper), rtol=0, atol=1e-12)
        assert sent.clipped
        arms.pass_time(0.01)
    arms.pass_time(0.3)  # after a pause in commands, the set-point starts at the arms' position
    np.testing.assert_allclose(arms.command(stood + 5.0).q, np.minimum(stood + reach, limits.upper), atol=1e-12)


def test_the_first_set_point_after_enabling_starts_at_the_arms_position(
    puppet: Puppet, ports: Ports, limits: JointLimits
) -> None:
    ports.arms.enable()
    puppet.deaf = {LIMB[side] + "joint_command" for side in Side}
    for _ in range(3):
        ports.arms.command(puppet.q + 1.0, ZERO)
    ports.arms.enable()
    sent = ports.arms.command(puppet.q + 1.0, ZERO)
    expected = np.minimum(puppet.q + limits.velocity * JUMP_TIME, limits.upper)
    np.testing.assert_allclose(sent.q, expected, atol=1e-12)


@pytest.mark.parametrize(
    ("spoil", "kind"),
    [
        (lambda puppet: puppet.__setattr__("enabled", False), FailureKind.HARDWARE_FAULT),
        (lambda puppet: puppet.__setattr__("stopped", True), FailureKind.STOPPED),
        (lambda puppet: puppet.silent.add(STATE), FailureKind.HARDWARE_FAULT),
        (lambda puppet: puppet.silent.add(JOINTS), FailureKind.STALE_STATE),
    ],
    ids=["disabled", "stopped", "no state", "no joint states"],
)
def test_commands_are_refused_if_the_robot_is_off_stopped_or_silent(
    puppet: Puppet, arms: Arms, spoil: Callable, kind: FailureKind
) -> None:
    arms.command(puppet.q)
    spoil(puppet)
    puppet.let(10)
    arms.clock.time += 1.5
    puppet.let(10)
    assert refused(arms.port, puppet.q) is kind
    puppet.stays(lambda: [len(arms.heard(side)) for side in Side])
    assert len(arms.heard(Side.LEFT)) == len(arms.heard(Side.RIGHT)) == 1


def test_a_short_silence_does_not_refuse_commands(puppet: Puppet, arms: Arms) -> None:
    arms.command(puppet.q)
    puppet.silent = {STATE}
    arms.clock.time += 0.15
    arms.command(puppet.q)


def test_commands_are_refused_immediately_after_a_triggered_stop(puppet: Puppet, arms: Arms) -> None:
    puppet.deaf.add(STOP)
    arms.command(puppet.q)
    arms.stop.trigger("a test")
    assert refused(arms.port, puppet.q) is FailureKind.STOPPED
    puppet.stays(lambda: [len(arms.heard(side)) for side in Side])
    assert len(arms.heard(Side.LEFT)) == 1


@pytest.mark.parametrize("wrong", [np.full(14, np.nan), np.full(14, np.inf), np.zeros(7), np.zeros((14, 1))])
def test_a_command_of_the_wrong_shape_is_refused(puppet: Puppet, arms: Arms, wrong: Array) -> None:
    assert refused(arms.port, wrong) is FailureKind.HARDWARE_FAULT
    assert refused(arms.port, puppet.q, wrong) is FailureKind.HARDWARE_FAULT
    one = puppet.q.copy()
    one[13] = np.nan
    assert refused(arms.port, one) is FailureKind.HARDWARE_FAULT
    puppet.let(10)
    assert arms.heard(Side.LEFT) == [] and arms.heard(Side.RIGHT) == []


def test_command_timeout_and_full_speed_are_published(puppet: Puppet, ports: Ports) -> None:
    for side in Side:
        wait(lambda side=side: puppet.heard[LIMB[side] + "joint_command_timeout"], "the timeout")
        wait(lambda side=side: puppet.heard[LIMB[side] + "set_speed_ratio"], "the speed")
        assert [m.data for m in puppet.heard[LIMB[side] + "joint_command_timeout"]] == [ports.arms.command_timeout]
        assert [m.data for m in puppet.heard[LIMB[side] + "set_speed_ratio"]] == [1.0]


# raw positions -----------------------------------------------------------------------------------------


def test_raw_positions_have_the_velocities_and_accelerations_of_a_sinusoid(
    puppet: Puppet, make: Callable[..., Arms], limits: JointLimits
) -> None:
    arms = make(raw=True)
    q0, amplitude, omega = puppet.q.copy(), np.linspace(0.02, 0.05, 14), 4.0
    begin = arms.clock.now()
    for k in range(40):
        t = 0.01 * k
        arms.clock.time = begin + t
        q, qd = q0 + amplitude * (1 - np.cos(omega * t)), amplitude * omega * np.sin(omega * t)
        arms.command(q, qd)
        wait(lambda n=k + 1: arms.dynamics() == n, "feed-forward")
        half = amplitude * omega**2 * np.cos(omega * (t - 0.005))
        for side in Side:
            part = arm_slice(side, 14)
            assert arms.heard(side)[-1].mode == RAW_POSITION == 4
            point = arms.heard(side, "inverse_dynamics_command")[-1]
            np.testing.assert_array_equal(point.positions, q[part])
            np.testing.assert_array_equal(point.velocities, qd[part])
            if k:
                np.testing.assert_allclose(point.accelerations, half[part], atol=2e-4)


def test_accelerations_stay_within_the_limits(
    puppet: Puppet, make: Callable[..., Arms], limits: JointLimits
) -> None:
    arms = make(raw=True)
    arms.command(puppet.q, ZERO)
    arms.clock.time += 0.01
    arms.command(puppet.q, -limits.velocity)
    for side in Side:
        wait(lambda side=side: len(arms.heard(side, "inverse_dynamics_command")) == 2, "feed-forward")
        first, second = arms.heard(side, "inverse_dynamics_command")
        assert list(first.accelerations) == [0.0] * 7
        np.testing.assert_array_equal(second.accelerations, -limits.acceleration[arm_slice(side, 14)])


def test_the_raw_position_setting_selects_the_command_mode(puppet: Puppet, connect: Connect) -> None:
    with connect(raw_position=True) as ports:
        ports.arms.enable()
        ports.arms.command(puppet.q, ZERO)
        wait(lambda: puppet.heard[LIMB[Side.LEFT] + "joint_command"], "a command")
        assert puppet.heard[LIMB[Side.LEFT] + "joint_command"][0].mode == 4
