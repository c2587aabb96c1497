"""Waits that cost no ticks, for tests of what the cell decides."""

from __future__ import annotations

from typing import Any

import pytest


@pytest.fixture
def waits_pass_at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """The wait before another try takes its time of the cell's clock, without the ticks in which arms are held.
    test_random_runs.py performs it as it is."""

    def pass_at_once(loop: Any, seconds: float, watch: Any) -> None:
        loop.ports.clock.sleep_until(loop.ports.clock.now() + seconds)

    monkeypatch.setattr("foldcell.cell.executive.effects.recovery.deciding.wait", pass_at_once)
