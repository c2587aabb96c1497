"""What a hand does that takes hold."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from cell.effects import gripping
from robots.errors import Failure, FailureKind
from robots.ports import Side, arm_slice
from skills.motion.follow import Follower
from skills.motion.grasp import Descent
from tests.fakes import FakeCell
from tests.workcells import fake_workcell

TOUCHED = 0.04
"""How far down its way the left hand stands [m]."""
WAY = Descent(np.linspace(0.0, 0.5, 51)[:, None] * np.ones(7), np.linspace(0.0, 0.05, 51), TOUCHED)


def pressed(monkeypatch: pytest.MonkeyPatch, newtons_a_metre: float) -> tuple[FakeCell, Failure | None, Any]:
    """The left hand presses on what pushes back so hard, from where it has touched."""
    monkeypatch.setattr(gripping, "_depth_at", lambda *_: TOUCHED)
    cell = FakeCell(q=np.r_[WAY.at(TOUCHED), np.zeros(7)])
    workcell = fake_workcell(cell)
    depth = lambda: float(np.interp(cell.q[0], WAY.q[:, 0], WAY.depth))  # noqa: E731
    pushes = SimpleNamespace(now={Side.LEFT: 0.0}, strongest=0.0)

    def look(_: Any) -> Failure | None:
        pushes.now[Side.LEFT] = newtons_a_metre * (depth() - TOUCHED)
        pushes.strongest = max(pushes.strongest, pushes.now[Side.LEFT])
        return Failure(FailureKind.STALE_STATE, "no tips") if np.isnan(newtons_a_metre) else None

    pushes.look = look
    posture = SimpleNamespace(pitch=0.1)
    context: Any = SimpleNamespace(
        motion=SimpleNamespace(postures={Side.LEFT: posture}), count=lambda adjustment: 1
    )
    failure = gripping._press(workcell, context, {Side.LEFT: WAY}, {Side.LEFT: Follower(TOUCHED)}, pushes)
    return cell, failure, pushes


def test_a_hand_presses_into_what_gives_way(monkeypatch: pytest.MonkeyPatch) -> None:
    cell, failure, _ = pressed(monkeypatch, 1000.0)
    deepest = float(np.interp(cell.q[0], WAY.q[:, 0], WAY.depth))
    assert failure is None and deepest - TOUCHED == pytest.approx(
        gripping.PRESS + gripping.DEEPER + 0.5 * gripping.PREGRASP_OPENING * np.sin(0.1), abs=2e-4
    )


def test_a_hand_goes_no_deeper_into_what_does_not(monkeypatch: pytest.MonkeyPatch) -> None:
    """It comes to rest smoothly where its tip is pushed as hard as it may be."""
    cell, failure, pushes = pressed(monkeypatch, 8_000.0)
    most = fake_workcell(FakeCell()).settings.grasp.press_force
    assert failure is None and most < pushes.strongest < 1.5 * most
    q = np.array([q for _, q in cell.commands])[:, arm_slice(Side.LEFT)]
    depth = np.interp(q[:, 0], WAY.q[:, 0], WAY.depth)
    assert abs(depth[-1] - depth[-5]) < 1e-5 and depth.max() - depth[-1] < 5e-5
    assert np.abs(np.diff(depth, n=2)).max() < 0.6 * 0.01**2 * 1.01, "within the hand's own acceleration"


def test_a_hand_whose_tips_nobody_can_read_does_not_press(monkeypatch: pytest.MonkeyPatch) -> None:
    cell, failure, _ = pressed(monkeypatch, float("nan"))
    assert failure is not None and failure.kind is FailureKind.STALE_STATE
    assert len(cell.commands) == 1
