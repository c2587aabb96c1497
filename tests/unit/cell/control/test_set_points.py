"""Transitions between motions: set-points never jump by the offset of the arms' reading."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from foldcell.cell.control.motions.hands import Hands, control_hands, each_hand
from foldcell.cell.control.motions.hold_position import wait
from foldcell.cell.control.motions.trajectory import stream
from foldcell.cell.control.path_clock import PathControl
from foldcell.cell.control.set_points import LastCommand, blend
from foldcell.cell.hardware.workcell import Workcell
from foldcell.robots.errors import FailureKind
from foldcell.robots.ports import ArmTrajectory, Side
from foldcell.skills.vocabulary import Outcome
from tests.fakes import FakeCell
from tests.workcells import fake_workcell

OFF = 0.008
"""Difference between the reading and the last set-point [rad]."""
MOST = 6.0 * OFF / 0.25**2
"""Peak acceleration of a minimum-jerk move over OFF in 0.25 s is 5.77 OFF / 0.25^2 [rad/s2]."""


def accelerations(cell: FakeCell) -> np.ndarray:
    q = np.array([cell.commands[0][1] * 0 + OFF, *(q for _, q in cell.commands)])
    return np.diff(q, n=2, axis=0) / 0.01**2


def standing(seconds: float = 0.5) -> ArmTrajectory:
    t = np.linspace(0.0, seconds, 51)
    zero = np.zeros((51, 14))
    return ArmTrajectory(t, zero, zero, zero)


def still(work: Workcell, control: Any) -> Outcome[Any]:
    """The left hand works while the arms stand still."""
    return each_hand(work.loop, work.hands, {Side.LEFT: None}, control)


def moving(work: Workcell, control: Any, arms: Callable[[], np.ndarray]) -> Outcome[Any]:
    """The left hand works while the arms follow their commands."""
    return work.loop.run(
        lambda start: control_hands(work.hands, work.last_command, start, {Side.LEFT: None}, control, arms)
    )


def test_the_blend_weight_falls_from_one_to_zero() -> None:
    share = np.array([blend(k) for k in range(40)])
    assert share[0] == 1.0 and share[25:] == pytest.approx(0.0) and np.all(np.diff(share) <= 0.0)


@pytest.mark.parametrize("kind", ["stream", "wait", "hands"])
def test_a_motion_begins_at_the_last_set_point(kind: str, monkeypatch: pytest.MonkeyPatch) -> None:
    cell, last_command = FakeCell(), LastCommand(np.full(14, OFF))
    work = fake_workcell(cell, last_command=last_command)
    if kind == "stream":
        assert stream(work.loop, standing(), None, PathControl(None, None, None)).ok
    elif kind == "wait":
        assert wait(work.loop, 0.5) is None
    else:
        monkeypatch.setattr(Hands, "read", lambda hands, side, state: hands.ports.clock.now())
        ended = still(work, lambda side, now, state: Outcome(now) if now >= 0.5 else state)
        assert ended.ok
    assert cell.commands[0][1] == pytest.approx(OFF, abs=1e-6)
    assert cell.commands[-1][1] == pytest.approx(0.0, abs=1e-9)
    assert np.abs(accelerations(cell)).max() <= MOST
    assert last_command.q == pytest.approx(cell.commands[-1][1])


@pytest.mark.parametrize(
    ("spoil", "kind"),
    [
        (lambda c: setattr(c, "stop_reason", "button"), FailureKind.STOPPED),
        (lambda c: setattr(c, "frozen_since", c.now), FailureKind.STALE_STATE),
        (lambda c: setattr(c, "q", c.q + 0.2), FailureKind.TRACKING_ERROR),
    ],
)
@pytest.mark.parametrize("waiting", [False, True])
def test_hands_and_waiting_arms_are_checked_like_a_motion(
    spoil, kind, waiting: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(Hands, "read", lambda *_: None)
    cell = FakeCell()
    cell.follows = False
    cell.at(0.3, lambda: spoil(cell))
    if waiting:
        failure = wait(fake_workcell(cell).loop, 2.0)
    else:
        failure = still(fake_workcell(cell), lambda side, reading, state: state).failure
    assert failure is not None and failure.kind is kind and cell.now < 0.5
    if kind is FailureKind.TRACKING_ERROR:
        assert cell.commands[-1][1] == pytest.approx(cell.q), "the arms hold where they were pushed to"


@pytest.mark.parametrize("off", [0.03, 0.055])
def test_hands_do_not_start_if_the_arms_were_moved(off: float, monkeypatch: pytest.MonkeyPatch) -> None:
    """A person pushed an arm during a pause. A path planned from the old position would begin with a jump."""
    monkeypatch.setattr(Hands, "read", lambda *_: None)
    cell = FakeCell()
    cell.q = cell.q + off
    work = fake_workcell(cell)
    began = moving(work, lambda side, now, state: state, lambda: np.zeros(14))
    assert began.failure is not None and began.failure.kind is FailureKind.START_MISMATCH
    assert cell.commands == []


@pytest.mark.parametrize("sag", [0.009, 0.018])
def test_hands_on_sagging_arms_start_at_the_last_set_point(sag: float, monkeypatch: pytest.MonkeyPatch) -> None:
    """Arms that sag below their set-point have not been moved, so their path begins at the set-point."""
    monkeypatch.setattr(Hands, "read", lambda *_: None)
    cell = FakeCell()
    cell.follows = False
    cell.q = cell.q - sag
    work = fake_workcell(cell, last_command=LastCommand(np.zeros(14)))
    ended = moving(work, lambda side, now, state: Outcome(1), lambda: np.zeros(14))
    assert ended.ok and cell.commands[0][1] == pytest.approx(0.0)


@pytest.mark.parametrize("off", [0.3, -0.3])
def test_arms_do_not_return_to_a_distant_last_set_point(off: float) -> None:
    """A person jogged the arms, so the motion begins at their present position."""
    cell = FakeCell()
    wait(fake_workcell(cell, last_command=LastCommand(np.full(14, off))).loop, 0.1)
    assert np.abs(cell.commands[0][1]).max() == 0.0


def test_hands_do_not_start_without_a_valid_arm_state() -> None:
    cell = FakeCell()
    cell.now, cell.frozen_since = 5.0, 4.0
    ended = still(fake_workcell(cell), lambda side, reading, state: state)
    assert ended.failure is not None and ended.failure.kind is FailureKind.STALE_STATE
    assert cell.commands == []


def test_a_hand_that_never_finishes_is_a_fault_while_the_arms_are_held(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(Hands, "read", lambda *_: None)
    cell = FakeCell()
    ended = still(fake_workcell(cell), lambda side, reading, state: state)
    assert ended.failure is not None and ended.failure.kind is FailureKind.GRIPPER_FAULT
    assert 10.0 < cell.now < 60.0 and np.diff([t for t, _ in cell.commands]).max() < 0.2


@pytest.mark.parametrize("sag", [0.0, OFF])
def test_hand_velocities_are_the_derivative_of_the_set_points(sag: float, monkeypatch: pytest.MonkeyPatch) -> None:
    """A robot that uses the velocities as feed-forward would jump otherwise."""
    monkeypatch.setattr(Hands, "read", lambda hands, side, state: hands.ports.clock.now())
    cell, told = FakeCell(), []
    cell.q = cell.q - sag
    ports = cell.ports()
    command = ports.arms.command
    monkeypatch.setattr(ports.arms, "command", lambda q, qd: (told.append((q, qd)), command(q, qd))[1])
    work = fake_workcell(cell, ports=ports, last_command=LastCommand(np.zeros(14)))
    slide = lambda: np.full(14, 0.005 + 0.05 * cell.now)  # noqa: E731
    assert moving(work, lambda s, now, state: Outcome(1) if now > 0.5 else state, slide).ok
    q, qd = (np.array(part) for part in zip(*told, strict=True))
    assert qd[0] == pytest.approx(0.0)
    assert qd[1:] == pytest.approx(np.diff(q, axis=0) / 0.01)
