"""The noise table: every value is typed and has its unit and its source."""

from __future__ import annotations

from dataclasses import asdict

import numpy as np
import pytest

from foldcell.cell.config.yaml_file import read_yaml
from foldcell.cell.simulation import noise


def test_the_shipped_noise_table_is_read() -> None:
    table = noise.load_noise()
    assert table.camera.depth_sigma == pytest.approx(1.4e-3)
    assert table.robot.command_timeout == pytest.approx(0.2)
    assert table.tactile.rows == 4 and table.tactile.columns == 3


def test_the_file_has_exactly_the_values_of_the_types_with_unit_and_source() -> None:
    read, typed = read_yaml(noise.PATH, "noise table").data, asdict(noise.load_noise())
    assert {name: set(section) for name, section in read.items()} == {n: set(v) for n, v in typed.items()}
    for section in read.values():
        assert all(set(entry) == {"value", "unit", "source"} for entry in section.values())


def test_values_are_drawn_from_the_whole_range() -> None:
    drawn = [noise.Range(2.0, 3.0).draw(np.random.default_rng(k)) for k in range(200)]
    assert 2.0 <= min(drawn) < 2.1 and 2.9 < max(drawn) <= 3.0
