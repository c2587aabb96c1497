"""Emulators for tests: one of a fake cell, one of a simulated cell."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack
from typing import Any

import numpy as np
import pytest
from served import Program, Serve

from foldcell.cell.simulation import SimulationSettings, open_simulated_cell
from foldcell.robots.ports import Ports
from tests.fakes import FakeCell

QUIET = SimulationSettings(
    garment="small_towel", render=False, robot_noise=False, camera_noise=False, garment_noise=False
)


@pytest.fixture
def last() -> Iterator[ExitStack]:
    """An exit stack that closes the cell after its server has ended."""
    with ExitStack() as stack:
        yield stack


@pytest.fixture
def serve(rosmaster: str, last: ExitStack) -> Iterator[Serve]:
    programs: list[Program] = []

    def begin(ports: Ports, **settings: Any) -> Program:
        programs.append(Program(ports, **settings))
        return programs[-1]

    yield begin
    for program in programs:
        program.close()


@pytest.fixture
def cell() -> FakeCell:
    return FakeCell(np.linspace(-0.6, 0.7, 14))


@pytest.fixture
def simulated(last: ExitStack) -> Ports:
    return last.enter_context(open_simulated_cell(QUIET, 1)).ports
