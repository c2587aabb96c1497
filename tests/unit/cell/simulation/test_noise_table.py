"""The noise table: every figure has a unit and a source."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import yaml

from cell.simulation import noise
from robots.errors import InternalError


@pytest.fixture
def copy(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    path = tmp_path / "noise.yaml"
    path.write_text(noise.PATH.read_text(encoding="utf-8"), encoding="utf-8")
    monkeypatch.setattr(noise, "PATH", path)
    noise.load_noise.cache_clear()
    return path


@pytest.fixture(autouse=True)
def fresh() -> None:
    noise.load_noise.cache_clear()


def test_the_shipped_noise_table_is_read() -> None:
    table = noise.load_noise()
    assert table.camera.depth_sigma == pytest.approx(1.4e-3)
    assert table.robot.command_timeout == pytest.approx(0.2)
    assert table.tactile.rows == 4 and table.tactile.columns == 3


@pytest.mark.parametrize("change", ["drop", "add", "bare"])
def test_a_noise_table_with_wrong_keys_is_refused(copy: Path, change: str) -> None:
    data = yaml.safe_load(copy.read_text(encoding="utf-8"))
    if change == "drop":
        del data["gripper"]["speed"]
    elif change == "add":
        data["gripper"]["colour"] = {"value": 1.0, "unit": "1", "source": "none"}
    else:
        del data["gripper"]["speed"]["source"]
    copy.write_text(yaml.safe_dump(data), encoding="utf-8")
    with pytest.raises(InternalError):
        noise.load_noise()


def test_values_are_drawn_from_the_whole_range() -> None:
    drawn = [noise.Range(2.0, 3.0).draw(np.random.default_rng(k)) for k in range(200)]
    assert 2.0 <= min(drawn) < 2.1 and 2.9 < max(drawn) <= 3.0
