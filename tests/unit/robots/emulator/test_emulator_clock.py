"""The time of the emulator goes on when the cell's clock is set back."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest

from foldcell.robots.baxter.emulator import emulator as serving
from foldcell.robots.baxter.emulator.emulator import Emulator
from tests.fakes import FakeCell


def test_the_emulators_time_goes_on_from_where_it_was(monkeypatch: pytest.MonkeyPatch) -> None:
    """Limbs, lines and commands compare only this time, so no arm sees a set-point from the future."""
    monkeypatch.setattr(serving, "load_messages", SimpleNamespace)
    cell, node = FakeCell(), SimpleNamespace(set_parameter=lambda name, value: None)
    times = []

    def read(now: float) -> None:
        cell.now = now
        served._read_clock()
        times.append(served._now)

    cell.now = 10.0
    served: Any = Emulator(cell.ports(), node)  # type: ignore[arg-type]
    for now in (10.01, 3.01, 3.02, 2.52, 2.53, 9.03):
        read(now)
    assert times == pytest.approx([10.01, 10.01, 10.02, 10.02, 10.03, 16.53])
