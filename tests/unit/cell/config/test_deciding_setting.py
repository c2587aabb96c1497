"""Messages name the setting that decides: file, key and value."""

from __future__ import annotations

from pathlib import Path

import pytest
import yaml

from cell.config import cell_settings
from cell.config.cell_settings import load_settings
from cell.config.deciding_setting import DECIDING, deciding_setting
from robots.errors import FailureKind

SHIPPED = yaml.safe_load(Path(cell_settings.__file__).with_name("cell.yaml").read_text())


@pytest.mark.parametrize("kind", DECIDING)
def test_the_key_is_one_of_cell_yaml(kind: FailureKind) -> None:
    group, name = DECIDING[kind].split(".")
    assert deciding_setting(kind, load_settings()) == f"`{group}.{name}: {SHIPPED[group][name]}` in cell.yaml"


def test_the_present_value_is_named(tmp_path: Path) -> None:
    (tmp_path / "cell.yaml").write_text("inspection: {iou: 0.77}\n")
    settings = load_settings(tmp_path / "cell.yaml")
    assert deciding_setting(FailureKind.OFF_TARGET, settings) == "`inspection.iou: 0.77` in cell.yaml"
    assert deciding_setting(FailureKind.STOPPED, settings) == ""
