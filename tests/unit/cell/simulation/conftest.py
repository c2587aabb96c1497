"""Simulated cells that are closed at the end of a test."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import pytest

from foldcell.cell.simulation import SimulationSettings
from tests.simulated_bench import Bench


@pytest.fixture
def open_bench() -> Iterator[Callable[[SimulationSettings, int], Bench]]:
    """Opens a cell with settings and seed."""
    benches: list[Bench] = []

    def build(settings: SimulationSettings, seed: int) -> Bench:
        benches.append(Bench(settings, seed))
        return benches[-1]

    yield build
    for bench in benches:
        bench.close()
